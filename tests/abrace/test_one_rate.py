# SPDX-License-Identifier: Apache-2.0
"""A bag during whose recording the clock was set: every way to read it says the same rate, and why it warns."""

import numpy as np
import pytest

import abrace
from abrace.bag_command import bag_information
from abrace_bags import BagWriter, message_definition
from abrace_core.safety.wire import LOCKSTEP, Head, Responses
from abrace_sysid.recorded.test import Test

COUNT, SET = 11_000, 5000


def bag_with(path, seconds_ahead):
    """A storey of 1.5 Hz under noise at 100 Hz; all clocks are set before sample SET."""
    random, definition, packed = (
        np.random.default_rng(5),
        message_definition("abrace_interfaces/msg/Response"),
        Responses(),
    )
    state = np.zeros(2)
    with BagWriter(path, {}) as bag:
        topic = bag.add_topic("/lab/response", definition.type_name, definition.text, definition.type_hash)
        for k in range(COUNT):
            stamp = 1_700_000_000 * 10**9 + 10_000_000 * k + (k >= SET) * round(seconds_ahead * 1e9)
            ground = random.normal(0.0, 0.1)
            state[1] += 0.01 * (-ground - 0.19 * state[1] - 88.8 * state[0])
            state[0] += 0.01 * state[1]
            total = -0.19 * state[1] - 88.8 * state[0]
            arrays = [float(state[0])], [float(total)], [0.0], [0.0], [0.0]
            payload = packed.pack(stamp, Head(k, 1, 0, LOCKSTEP, 0), "", (1,), *arrays, ground, 0.0)
            bag.write(topic, payload, stamp, stamp)
    return path


@pytest.mark.parametrize(("ahead", "jump"), [(3.0, "jumps ahead by 3 s"), (-2.0, "jumps back by 2 s")])
def test_all_say_the_rate_of_the_samples_when_the_clock_was_set(tmp_path, ahead, jump):
    bag = bag_with(tmp_path / "bag", ahead)
    told = rf"the clock {jump} after sample {SET - 1}; the sample rate by all stamps is 100 Hz"
    with pytest.warns(UserWarning, match=told):
        assert abrace.read_run(bag).sample_period == 0.01
    with pytest.warns(UserWarning, match=told):
        record = abrace.load_record(bag)
    assert (record.sample_period, len(record.acceleration)) == (0.01, COUNT)
    assert Test.read(bag).sample_period == 0.01
    assert "  100.00  " in bag_information(bag, check=False)
    assert "  100.00  " in bag_information(bag, check=True)
    with pytest.warns(UserWarning, match=told):
        (frequency, *_) = abrace.identify_ambient(bag, band=(0.7, 5.0)).to_pandas().iloc[:, 0]
    # sqrt(88.8) / 2 pi = 1.4998 Hz; at 96 Hz it would be 1.44 Hz
    assert frequency == pytest.approx(1.4998, abs=0.015)


def test_a_good_clock_is_no_warning(tmp_path, recwarn):
    bag = bag_with(tmp_path / "bag", 0.0)
    assert (abrace.read_run(bag).sample_period, abrace.load_record(bag).sample_period) == (0.01, 0.01)
    assert not [str(warning.message) for warning in recwarn]


def test_dates_and_counters_are_times_of_measured_data():
    random, count = np.random.default_rng(8), 3000
    data = {name: random.normal(size=count) for name in ("w", "a1")}
    dates = np.datetime64("2026-03-01T10:00", "us") + 2000 * np.arange(count)
    test = Test.from_arrays({"when": dates, **data}, ["w"], time="when")
    assert (test.sample_period, test.names, test.warnings) == (0.002, ("a1",), ())
    assert Test.from_arrays({"when": dates, **data}, ["w"], sample_rate=500.0).names == ("a1",)
    ticks = (2**32 - 2_000_000 + 2000 * np.arange(count)) % 2**32
    told = "data, row 1001: time falls after sample 999, from 4294.97 to 0 s: a counter of 2^32 us wraps"
    test = Test.from_arrays({"time": ticks / 1e6, **data}, ["w"], time="time")
    assert (test.sample_period, test.warnings) == (pytest.approx(0.002, rel=1e-9), (told,))
    # what is wrong with the times is told also where nothing else can be
    with pytest.raises(abrace.AbraceError) as error:
        abrace.identify_data({"time": ticks / 1e6, **data}, ["w"], time="time", band=(5.0, 100.0))
    assert told in str(error.value)

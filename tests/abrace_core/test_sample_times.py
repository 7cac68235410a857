# SPDX-License-Identifier: Apache-2.0
"""The sample period of stamps, and their faults: stamps are made at a known rate, then spoiled in a known place."""

import math

import numpy as np
import pandas
import pytest

from abrace_core import AbraceError
from abrace_core.files.sample_times import sample_times
from abrace_core.files.table import array_table
from abrace_core.files.table_text import text_table

COUNT = 6000
NUMBERS = np.arange(COUNT)
EVEN = 0.01 * NUMBERS
SLOPE = 1e-6
"""Relative; three standard deviations of the slope of 6000 stamps with that jitter in two parts are 9e-7."""
JITTER = np.random.default_rng(7).normal(0.0, 2e-4, COUNT)


def changed(at, to):
    stamps = 1.7e9 + EVEN
    stamps[at] = to(stamps) if callable(to) else to
    return stamps


SPOILED = {
    "good": (EVEN, []),
    "jitter": (EVEN + JITTER, []),
    "a slow clock": (EVEN * 1.0001, []),
    "forward": (EVEN + JITTER + 3.0 * (NUMBERS >= 2800), [("step", 2800, 3.0)]),
    "back": (EVEN + JITTER - 2.0 * (NUMBERS >= 2800), [("step", 2800, 2.0)]),
    "twice": (EVEN + (NUMBERS >= 900) - 7.0 * (NUMBERS >= 5980), [("step", 900, 1.0), ("step", 5980, 7.0)]),
    "repeated": (changed(500, lambda stamps: stamps[499]), [("repeated", 500, 0.01)]),
    "late": (changed(500, lambda stamps: stamps[500] + 0.05), [("late", 500, 0.05)]),
    "early": (changed(0, lambda stamps: stamps[0] - 0.3), [("early", 0, 0.3)]),
    "zero": (changed(700, 0.0), [("impossible", 700, 1.7e9)]),
    "huge": (changed(COUNT - 1, 1e300), [("impossible", COUNT - 1, 1e300)]),
    "nan": (changed(700, math.nan), [("impossible", 700, math.inf)]),
    "zeros at the beginning": (changed(slice(0, 300), 0.0), [("impossible", 0, 1.7e9)]),
    "2^16 us": (np.mod(EVEN + 0.0601, 0.065536), [("wrap", 1, 0.065536)]),
    "2^16 ms": (np.mod(EVEN + 60.0, 65.536), [("wrap", 554, 65.536)]),
    "2^32 us": (np.mod(EVEN + JITTER + 4290.0, 4294.967296), [("wrap", 497, 4294.967296)]),
    "2^32 ns": (np.mod(EVEN + 1.0, 4.294967296), [("wrap", 330, 4.294967296)]),
    "2^32 ticks of 1/500 MHz": (np.mod(EVEN, 8.589934592), [("wrap", 859, 8.589934592)]),
}
PERIODS = {"a slow clock": 0.010001}


@pytest.mark.parametrize("numbered", [True, False])
@pytest.mark.parametrize("case", SPOILED)
def test_the_rate_is_that_of_the_samples_and_each_fault_has_its_sample(case, numbered):
    stamps, faults = SPOILED[case]
    found = sample_times(stamps, NUMBERS if numbered else None)
    assert found.period == pytest.approx(PERIODS.get(case, 0.01), rel=SLOPE)
    if case == "early" and not numbered:
        faults = [("step", 1, 0.3)]  # without numbers samples may be missing behind the first
    assert [(fault.kind, fault.sample) for fault in found.faults] == [fault[:2] for fault in faults]
    for fault, (_, _, size) in zip(found.faults, faults, strict=True):
        assert fault.size == pytest.approx(size, rel=0.02)


def test_faults_are_told_in_words():
    texts = {case: sample_times(stamps, NUMBERS).faults for case, (stamps, _) in SPOILED.items()}
    assert texts["back"][0].text == "the clock jumps back by 2 s after sample 2799"
    assert texts["repeated"][0].text == "the stamp of sample 500 is that of the sample before"
    assert texts["late"][0].text == "the stamp of sample 500 is 0.05 s too late"
    assert texts["zeros at the beginning"][0].text.endswith("sample 0 is impossible, and those of 299 more")
    assert texts["2^16 ms"][0].text == "time falls after sample 553 by 65.526 s: a counter of 2^16 ms wraps"
    (several,) = sample_times(np.mod(EVEN, 4.294967296)).faults  # 60 s are 13 ranges and a rest
    assert several.text == (
        "time falls after sample 429, from 4.29 to 0.0050327 s: a counter of 2^32 ns wraps (13 times)"
    )


def test_missing_samples_are_a_step_only_where_numbers_do_not_show_them():
    kept = np.delete(NUMBERS, [1000, *range(3000, 3300)])
    assert sample_times(EVEN[kept], kept).faults == ()
    found = sample_times(EVEN[kept])
    assert [(fault.sample, round(fault.size, 9)) for fault in found.faults] == [(1000, 0.01), (2999, 3.0)]
    assert found.period == pytest.approx(0.01, rel=1e-9)


def test_a_run_that_begins_anew_is_no_step():
    stamps, numbers = np.r_[EVEN, 100 + EVEN[:500]], np.r_[NUMBERS, NUMBERS[:500]]
    found = sample_times(stamps, numbers)
    assert (found.faults, found.whole) == ((), 0.01)


@pytest.mark.parametrize(("rate", "digits"), [(128, 3), (980.4, 3), (500, 2), (119.3, 3)])
def test_rounded_stamps_have_their_mean_rate_and_no_fault(rate, digits):
    found = sample_times(np.round(NUMBERS / rate, digits), NUMBERS, resolution=10.0**-digits)
    assert 1 / found.period == pytest.approx(rate, rel=1e-6)
    assert found.faults == ()


def test_a_clock_whose_rate_changes_is_named_beyond_a_period():
    slow = np.cumsum(np.where(NUMBERS < COUNT // 2, 0.01, 0.010001))
    assert sample_times(slow, NUMBERS).faults == ()
    drifting = np.cumsum(np.where(NUMBERS < COUNT // 2, 0.01, 0.01002))
    (fault,) = sample_times(drifting, NUMBERS).faults
    # half the samples at one slope, half at another 2e-5 s away: at most 3/32 of 6000 * 2e-5 s from one line
    assert (fault.kind, fault.size) == ("drift", pytest.approx(0.015, rel=0.5))


# Of a table -----------------------------------------------------------------------------------------------------------


def sampling(times, name="time [s]", given=None):
    table = array_table({name: times, "y": np.zeros(len(times))}, "data")
    return table.sampling(table.columns[0], given)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (
            EVEN + 3.0 * (NUMBERS >= 2000),
            "row 2001: time step 3.01 s, expected equal steps of 0.01 s, after sample 1999: samples are missing, or",
        ),
        (
            EVEN - 1.2 * (NUMBERS >= 2000),
            "row 2001: time falls after sample 1999, from 19.99 to 18.8 s: did a counter wrap, or was the clock set",
        ),
        (np.delete(EVEN, 5990), "data, row 5991: time step 0.02 s, expected equal steps of 0.01 s, after sample 5989"),
        (EVEN[::-1], "data, row 2: times that fall after sample 0, from 59.99 to 59.98 s, expected equal steps"),
        (np.full(50, 3.0), "data, row 2: times that do not increase after sample 0, from 3 to 3 s"),
        (changed(700, math.nan), "data, row 701: nan, expected a finite time"),
        (EVEN + 10 * JITTER, "expected equal steps of 0.01 s"),
        (EVEN[:20] + 0.03 * (NUMBERS[:20] == 9), "data, row 10: time step 0.04 s, expected equal steps of 0.01 s"),
    ],
)
def test_times_behind_which_a_sample_may_be_missing_are_refused_with_their_sample(times, message):
    with pytest.raises(AbraceError) as error:
        sampling(times)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("times", "name", "warning"),
    [
        (
            1e6 * np.mod(EVEN + 4290.0, 4294.967296),
            "time [us]",
            "row 498: time falls after sample 496, from 4294.96 to 0.002704 s: a counter of 2^32 us wraps",
        ),
        (SPOILED["repeated"][0], "t", "row 501: the stamp of sample 500 is that of the sample before"),
        (SPOILED["late"][0], "t", "row 501: the stamp of sample 500 is 0.05 s too late"),
        (SPOILED["zero"][0], "t", "row 701: the stamp of sample 700 is impossible"),
        (SPOILED["huge"][0], "t", "row 6000: the stamp of sample 5999 is impossible"),
        (EVEN + JITTER, "t", ": time steps depart from 0.01 s by up to"),
    ],
)
def test_a_wrong_time_behind_which_no_sample_is_missing_is_a_warning_and_of_a_record_an_error(times, name, warning):
    period, (text,) = sampling(times, name)
    assert period == pytest.approx(0.01, rel=SLOPE)
    assert text.startswith("data, row ")
    assert warning in text
    table = array_table({name: times, "y": np.zeros(len(times))}, "data")
    with pytest.raises(AbraceError) as error:
        table.step(table.columns[0])
    assert str(error.value) == text


def test_a_clock_that_drifts_less_than_a_step_is_read():
    steps = np.where(np.arange(4000) < 2000, 0.0023525, 0.0023527)
    period, warnings = sampling(np.round(np.cumsum(steps), 9))
    assert (period, warnings) == (pytest.approx(0.0023526, rel=1e-6), ())


def test_the_rate_that_is_given_decides_where_it_fits():
    assert sampling(EVEN + JITTER, given=0.01)[0] == 0.01
    for times, given in ((EVEN, 0.010002), (EVEN + JITTER, 0.010002), (EVEN, 0.011)):  # 0.010002: 1.2 steps at the end
        with pytest.raises(AbraceError, match=rf"sample period 0.01 s by its times, {given} s was given"):
            sampling(times, given=given)


DATES = pandas.Timestamp("2026-02-28 23:59:50") + pandas.to_timedelta(NUMBERS / 128, unit="s")


@pytest.mark.parametrize(
    "dates",
    [
        DATES,
        DATES.tz_localize("Asia/Taipei").astype(object),
        DATES - DATES[0],
        DATES.strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
        DATES.to_numpy().astype("datetime64[us]"),
    ],
)
def test_dates_are_times_and_no_numbers(dates):
    period, warnings = sampling(np.asarray(dates), "when")
    assert (period, warnings) == (pytest.approx(1 / 128, rel=1e-7), ())
    table = array_table({"when": np.asarray(dates)}, "data")
    with pytest.raises(AbraceError, match="data: column when holds dates, expected numbers"):
        table.values([table.columns[0]])


@pytest.mark.parametrize(("form", "warnings"), [("%Y-%m-%d %H:%M:%S.%f", 0), ("%H:%M:%S.%f", 1)])
def test_the_clock_in_a_text_goes_on_at_midnight(form, warnings):
    rows = "\n".join(f"{date},{k}" for k, date in enumerate(DATES[::64].strftime(form)))
    table = text_table(f"time,y\n{rows}\n", "data")
    period, found = table.sampling(table.columns[0])
    assert (period, len(found)) == (0.5, warnings)
    assert not found or found[0] == (
        "data, line 22: time falls after sample 19, from 86399.5 to 0 s: the time of the day wraps"
    )

# SPDX-License-Identifier: Apache-2.0
"""Which packet may follow which, and how old one is."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from abrace_plant.devices.layout import Malformed
from abrace_plant.devices.succession import DRIFT, Succession, TargetClock

PERIOD = 2_000_000


def begun(counter: int = 0, modulus: int = 2**32) -> Succession:
    """One whose last packet was `counter`."""
    order = Succession(modulus, PERIOD)
    with pytest.raises(Malformed, match=r"^not_consecutive$"):
        order.advance((counter - 1) % modulus, (counter - 1) * PERIOD, 10)
    assert order.advance(counter, counter * PERIOD, 10) == 1
    return order


@pytest.mark.parametrize(
    ("counter", "name"),
    [(100, "repeated"), (99, "old"), (0, "old"), (111, "jumping"), (2**31, "jumping"), (2**32 - 1, "old")],
)
def test_a_packet_that_cannot_follow_is_named_and_changes_nothing(counter, name):
    order = begun(100)
    with pytest.raises(Malformed, match=f"^{name}$"):
        order.advance(counter, counter * PERIOD, 10)
    assert order.advance(101, 101 * PERIOD, 10) == 1


def test_lost_packets_are_counted_up_to_as_many_as_can_have_been():
    assert begun(100).advance(110, 110 * PERIOD, 10) == 10


@pytest.mark.parametrize("jump", [2, 3, 9])
def test_a_counter_that_jumps_while_the_clock_does_not_is_found_however_little_it_jumps(jump):
    order = begun(100)
    with pytest.raises(Malformed, match=r"^wrong_time$"):
        order.advance(100 + jump, 101 * PERIOD, 10)
    assert order.advance(101, 101 * PERIOD, 10) == 1


@pytest.mark.parametrize("modulus", [2**8, 2**16, 2**32, 2**64])
def test_counters_wrap(modulus):
    order = begun(modulus - 1, modulus)
    assert order.advance(0, modulus * PERIOD, 10) == 1
    assert order.advance(2, (modulus + 2) * PERIOD, 10) == 2
    assert order.ticks == 4


@pytest.mark.parametrize("rate", [0.5, 0.9, 0.99, 0.998, 1.002, 1.01, 1.2, 2.0])
def test_a_target_that_ticks_at_another_rate_is_found(rate):
    order, used, reasons = Succession(2**32, PERIOD), 0, set()
    for counter in range(1000):
        try:
            used += order.advance(counter, round(counter * PERIOD / rate), 10)
        except Malformed as fault:
            reasons.add(str(fault))
    # counter and time may disagree by 0.4 ticks and 1/1000 of those that have passed
    assert used <= 0.4 / (abs(1 / rate - 1) - 1e-3) + 1
    assert reasons <= {"wrong_time", "not_consecutive", "jumping"}


@pytest.mark.parametrize("rate", [0.9995, 1.0005])
def test_a_target_whose_clock_is_off_by_half_a_thousandth_is_followed(rate):
    order = Succession(2**32, PERIOD)
    with pytest.raises(Malformed, match=r"^not_consecutive$"):
        order.advance(0, 0, 10)
    assert sum(order.advance(counter, round(counter * PERIOD / rate), 10) for counter in range(1, 20000)) == 19999


def test_a_target_without_a_clock_is_judged_by_its_counter_alone():
    order = Succession(256, PERIOD)
    with pytest.raises(Malformed):
        order.advance(7, None, 10)
    assert order.advance(8, None, 10) == 1
    assert order.advance(12, None, 10) == 4


def test_it_begins_between_any_number_of_packets_that_do_not_follow_each_other():
    order = Succession(2**32, PERIOD)
    for counter in (500, *range(10**6, 21 * 10**6, 10**6)):
        with pytest.raises(Malformed, match=r"^not_consecutive$"):
            order.advance(counter, counter * PERIOD, 10)
    assert order.advance(501, 501 * PERIOD, 10) == 1


@given(st.lists(st.integers(0, 2**16 - 1), max_size=60), st.integers(0, 2**16 - 1))
def test_what_is_used_is_always_newer(counters, first):
    order, last = Succession(2**16, PERIOD), None
    for counter in [first - 1 & 0xFFFF, first, *counters]:
        try:
            ticks = order.advance(counter, None, 10)
        except Malformed:
            continue
        assert 1 <= ticks <= 10
        assert last is None or (last + ticks) % 2**16 == counter
        last = counter


def test_the_age_of_a_packet_is_what_it_took_more_than_the_quickest():
    clock = TargetClock()
    for tick in range(1000):
        late = 700_000 if tick % 10 else 0
        age = clock.age(tick * PERIOD, 5 * 10**9 + tick * PERIOD + 40_000 + late)
    assert age == pytest.approx(700_000, abs=10 * PERIOD * DRIFT)


def test_a_target_whose_clock_is_slow_or_fast_does_not_grow_old():
    for error in (-0.9 * DRIFT, 0.9 * DRIFT):
        clock = TargetClock()
        ages = [clock.age(round(tick * PERIOD * (1 + error)), tick * PERIOD) for tick in range(100_000)]
        assert max(ages) < 1000, f"clock off by {error}"

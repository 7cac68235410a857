# SPDX-License-Identifier: Apache-2.0
"""A control law of one's own: what is made of its class, and what goes wrong in it."""

import sys

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.own_law import GuardedLaw, law_options, make_law

Z = (0.1, 0.2, 0.3, 0.01, 1.0, 2.0, 3.0, 500.0)
"""Three floors, one brace group."""
U = (250.0,)


class Law:
    def __init__(self, gain: float = 2.0, floors: tuple[int, ...] = (1,), answer=lambda _: [7.0]) -> None:
        self.gain, self.floors, self.answer = gain, floors, answer

    def begin(self, floors, groups, sample_period):
        self.began = floors, groups, sample_period

    def force(self, sample):
        self.sample = sample
        return self.answer(sample)


def guarded(law, ramp_time=0.0):
    found = GuardedLaw(law, 0.002, ramp_time)
    found.begin(3, 1)
    return found


def test_a_law_is_given_each_sample_by_the_quantities_names():
    law = Law()
    assert guarded(law).force(5, Z, U, 2) == [7.0]
    assert law.began == (3, 1, 0.002)
    sample = law.sample
    assert (sample.number, sample.lost) == (5, 2)
    for found, expected in (
        (sample.displacement, Z[:3]),
        (sample.stroke, Z[3:4]),
        (sample.acceleration, Z[4:7]),
        (sample.force, Z[7:]),
        (sample.applied, U),
    ):
        assert found.tolist() == list(expected)


def test_the_force_fades_in_along_half_a_cosine_whenever_it_begins_anew():
    law = guarded(Law(answer=lambda _: 8.0), ramp_time=0.008)
    for _ in range(2):
        found = [law.force(number, Z, U, 0)[0] for number in range(5)]
        assert found == pytest.approx([8 * (1 - np.cos(np.pi * j / 4)) / 2 for j in (1, 2, 3)] + [8.0, 8.0])
        law.begin(3, 1)


def test_an_argument_for_numbers_is_no_parameter_for_whole_numbers_alone():
    class Own:
        def __init__(
            self,
            damping: float = 200000,
            gains: list[float] = (1, 2),
            text: "float" = 3,
            steps: int = 4,
            name="a",
            on=True,
        ):
            pass

    options = law_options(Own)
    assert (options.pop("name"), options.pop("on")) == ("a", True)
    assert options == {"damping": 2e5, "gains": [1.0, 2.0], "text": 3.0, "steps": 4}
    assert [type(one) for one in (options["damping"], options["gains"][0], options["text"], options["steps"])] == [
        float,
        float,
        float,
        int,
    ]


def test_a_law_that_cannot_be_made_is_named():
    def own(gain):
        raise ValueError(f"no table for {gain}")

    with pytest.raises(AbraceError, match=r"own: ValueError: no table for 2\.0"):
        make_law(own, {"gain": 2.0})


@pytest.mark.parametrize("default", ["", "=None", "={}", "=()"])
def test_a_parameter_that_ros_cannot_have_is_named(default):
    scope: dict = {}
    exec(f"class Own:\n    def __init__(self, gain{default}): pass", scope)
    with pytest.raises(AbraceError, match=r"Own: gain = .*, expected a default that is a number"):
        law_options(scope["Own"])


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda _: 1 / 0, "Law.force: ZeroDivisionError: division by zero"),
        (lambda _: sys.exit(3), "Law.force: SystemExit: 3"),
        (lambda _: None, "Law.force: returned None, expected a number for each of 1 brace groups"),
        (lambda _: "push", "Law.force: returned 'push', expected a number"),
        (lambda _: 10**400, "Law.force: returned 10+, expected a number"),
        (lambda _: exec("raise ValueError('two\\nlines')"), "Law.force: ValueError: two lines"),
        (lambda _: [1.0, 2.0], r"Law.force: returned \[1.0, 2.0\], expected a number"),
    ],
)
def test_what_goes_wrong_in_a_law_is_said_with_its_name(answer, message):
    with pytest.raises(AbraceError, match=message):
        guarded(Law(answer=answer)).force(0, Z, U, 0)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (0, np.nan, r"displacement\[0\] of sample 1000 is nan, expected a finite number"),
        (3, np.inf, r"stroke\[0\] of sample 1000 is inf, expected"),
        (5, -np.inf, r"acceleration\[1\] of sample 1000 is -inf, expected"),
        (7, np.nan, r"force\[0\] of sample 1000 is nan, expected"),
        (8, np.nan, r"command of sample 1000 is \[nan\], expected finite numbers"),
    ],
)
def test_a_sample_that_is_not_finite_reaches_no_law(place, value, message):
    law = Law()
    one = guarded(law)
    one.force(999, Z, U, 0)
    given = [value if i == place else z for i, z in enumerate((*Z, *U))]
    with pytest.raises(AbraceError, match=message):
        one.force(1000, given[:8], given[8:], 0)
    assert law.sample.number == 999


def test_values_whose_sum_overflows_are_finite():
    assert guarded(Law()).force(0, [1e308] * 8, U, 0) == [7.0]

# SPDX-License-Identifier: Apache-2.0
"""Numbers in files with their unit: the value that a hand computes, or one line that says what was expected."""

from __future__ import annotations

import math
from typing import Annotated

import pydantic
import pytest

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, validated
from abrace_core.files.quantity import Quantity


def read(value: object, unit: str) -> float:
    class File(Checked):
        number: Annotated[float, pydantic.Field(gt=0), Quantity(unit)]

    return validated({"number": value}, File, "rig file x.yaml").number


@pytest.mark.parametrize(
    ("text", "unit", "expected"),
    [
        (24500, "N", 24500.0),
        ("24.5 kN", "N", 24500.0),
        ("2500 kgf", "N", 2500 * 9.80665),
        ("5.5 kip", "N", 24465.22),  # 4.4482216 kN each
        ("1.2e3 kN/mm", "N/m", 1.2e9),
        ("18 kgf s/cm", "N s/m", 18 * 980.665),
        ("1144.16 kgf s^2/m", "kg", 1144.16 * 9.80665),
        ("0.1 g", "m/s^2", 0.980665),
        ("980.665 cm/s²", "m/s^2", 9.80665),
        ("9 Hz", "rad/s", 18 * math.pi),
        ("1 rad/s", "Hz", 1 / (2 * math.pi)),
        ("0.5 kHz", "Hz", 500.0),
        ("0.8 ms", "s", 8e-4),
        ("205 GPa", "N/m^2", 205e9),
        ("1.5 %", "1", 0.015),
    ],
)
def test_a_number_with_its_unit_is_the_number_in_the_keys_unit(text, unit, expected):
    assert read(text, unit) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("24.5 kg", "'24.5 kg', expected a number in N, or one with its unit: kg is another kind of quantity"),
        ("24.5 Hz", "Hz is another kind of quantity"),
        ("24.5 kM", "expected a number in N, or one with its unit: 'kM' is no unit, expected a combination of kg, t"),
        ("24.5 N^22", r"'N\^22' is no unit"),
        ("24,5 kN", "'24,5 kN', expected a valid number"),
        ("-3 kN", "expected greater than 0"),
        ("1e400 kN", "expected a finite number"),
    ],
)
def test_what_is_no_such_number_is_refused_in_one_line(text, message):
    with pytest.raises(AbraceError, match=rf"^rig file x\.yaml: number: .*{message}") as caught:
        read(text, "N")
    assert "\n" not in str(caught.value)

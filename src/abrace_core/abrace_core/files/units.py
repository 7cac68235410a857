# SPDX-License-Identifier: Apache-2.0
"""Units of numbers in files: `24.5 kN` read as a number of another unit. Launch files use it: it needs no pydantic."""

from __future__ import annotations

import math
import re
from typing import Any, NamedTuple

GRAVITY = 9.80665
"""Standard gravity [m/s^2]."""


class Unit(NamedTuple):
    """A unit: its factor to SI units, and its exponents of kg, m, s and rad."""

    factor: float
    dimension: tuple[int, int, int, int]


_MASS, _LENGTH, _TIME, _ANGLE = (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)
_FORCE, _PRESSURE, _CYCLES, _GRAVITY, _NONE = (1, 1, -2, 0), (1, -1, -2, 0), (0, 0, -1, 1), (0, 1, -2, 0), (0, 0, 0, 0)
_POUND, _INCH = 0.45359237, 0.0254

UNITS = {
    name: Unit(factor, dimension)
    for dimension, factors in (
        (_MASS, {"kg": 1.0, "t": 1e3, "lb": _POUND}),
        (_LENGTH, {"m": 1.0, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "in": _INCH, "ft": 12 * _INCH}),
        (_TIME, {"s": 1.0, "us": 1e-6, "ms": 1e-3, "min": 60.0, "h": 3600.0}),
        (_ANGLE, {"rad": 1.0, "deg": math.pi / 180}),
        (_CYCLES, {"Hz": 2 * math.pi, "kHz": 2e3 * math.pi}),
        (_FORCE, {"N": 1.0, "kN": 1e3, "MN": 1e6, "kgf": GRAVITY, "tf": 1e3 * GRAVITY, "lbf": _POUND * GRAVITY}),
        (_FORCE, {"kip": 1e3 * _POUND * GRAVITY}),
        (_PRESSURE, {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "bar": 1e5}),
        (_GRAVITY, {"g": GRAVITY}),
        (_NONE, {"1": 1.0, "%": 1e-2}),
    )
    for name, factor in factors.items()
}
"""What a unit is made of, as in `kN s/m` or `m/s^2`. A Hz is 2 pi rad/s, and g is gravity, not the gram."""

_QUANTITY = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s.,].*|1/.*)")
_PART = re.compile(r"([A-Za-z]+|%|1)(?:\^?(-?\d))?")


def unit_of(text: str) -> Unit:
    """The unit that a `text` names: units to a power, separated by spaces, * or /.

    >>> unit_of("kN s/m")
    Unit(factor=1000.0, dimension=(1, 0, -1, 0))

    Raises
    ------
    ValueError
        If it names none.
    """
    factor, dimension = 1.0, (0, 0, 0, 0)
    plain = text.translate({ord("²"): "^2", ord("³"): "^3", ord("µ"): "u", ord("·"): "*"}).strip()
    above, *below = re.split(r"\s*/\s*", plain)
    for sign, part in [*((1, each) for each in re.split(r"\s*\*\s*|\s+", above)), *((-1, each) for each in below)]:
        found = _PART.fullmatch(part)
        if found is None or found[1] not in UNITS:
            raise ValueError(f"{text!r} is no unit, expected a combination of {', '.join(UNITS)}")
        power = sign * int(found[2] or 1)
        one = UNITS[found[1]]
        factor *= one.factor**power
        dimension = tuple(a + power * b for a, b in zip(dimension, one.dimension, strict=True))  # type: ignore[assignment]
    return Unit(factor, dimension)


_SPELT = (
    (r"\*\*", "^"),
    (r"\bcms\b", "cm"),
    (r"\b(milli|micro|m|u)?-?(?:seconds?|secs?|segundos?|seg)(?=\b|\d)", r"\1s"),
    (r"\bmillis\b", "ms"),
    (r"\bmicros\b", "us"),
    (r"\bmgals?\b", "0.00001 m/s^2"),
    (r"\bgals?\b", "cm/s^2"),
    (r"\b(?:mg|milli-?g)\b", "0.001 g"),
    (r"%\s*g\b", "0.01 g"),
    (r"\bg/10\b", "0.1 g"),
    (r"(?<=s)\^?-(?=[12]\b)|(?<=s)⁻", "^-"),
)
"""Spellings of units of time and acceleration in the headers of other people's files, in small letters."""
ACCELERATION = _GRAVITY
TIME = _TIME


def unit_in_header(text: str) -> Unit | None:
    """The unit in the `text` of a header in any usual spelling, also `CM/SEC/SEC`, `gal`, `1.00 mm/s/s`; None: none.

    >>> unit_in_header("CM/SEC/SEC"), unit_in_header("[S]"), unit_in_header("counts")
    (Unit(factor=0.01, dimension=(0, 1, -2, 0)), Unit(factor=1.0, dimension=(0, 0, 1, 0)), None)
    """
    plain = text.lower().strip(" []().,:;\"'").replace("²", "^2")
    for pattern, spelling in _SPELT:
        plain = re.sub(pattern, spelling, plain)
    number = re.match(r"(?:\d+\.?\d*|\.\d+)(?=\s*[a-z%])", plain)
    try:
        unit = unit_of(plain[number.end() :] if number else plain)
    except ValueError:
        return None
    return Unit(float(number[0]) * unit.factor, unit.dimension) if number else unit


def unit_as_stated(text: str) -> Unit | None:
    """The unit in a `text` as `unit_of` spells it, else in any usual spelling (`unit_in_header`); None: none.

    >>> unit_as_stated("kN"), unit_as_stated("gal"), unit_as_stated("V")
    (Unit(factor=1000.0, dimension=(1, 1, -2, 0)), Unit(factor=0.01, dimension=(0, 1, -2, 0)), None)
    """
    try:
        return unit_of(text)
    except ValueError:
        return unit_in_header(text)


def si_unit(dimension: tuple[int, int, int, int]) -> str:
    """The SI unit with these exponents of kg, m, s and rad.

    >>> si_unit(unit_of("kN").dimension), si_unit(unit_of("mm/s^2").dimension), si_unit(unit_of("Hz").dimension)
    ('N', 'm/s^2', 'rad/s')
    """
    for name, unit in UNITS.items():
        if unit == (1.0, dimension):
            return name
    parts = [(name, power) for name, power in zip(("kg", "m", "s", "rad"), dimension, strict=True) if power]
    above, below = (
        [name if abs(power) == 1 else f"{name}^{abs(power)}" for name, power in parts if sign * power > 0]
        for sign in (1, -1)
    )
    return "/".join([" ".join(above) or "1", *below])


def number_in(unit: str, value: Any) -> Any:
    """The number in `unit` that a `value` of a file means; what is no number with a unit stays as it is.

    >>> number_in("N", "24.5 kN")
    24500.0

    Raises
    ------
    ValueError
        If its unit is none, or one of another kind of quantity.
    """
    found = _QUANTITY.fullmatch(value.strip()) if isinstance(value, str) else None
    if found is None:
        return value
    own, given = unit_of(unit), unit_of(found[2])
    if given.dimension != own.dimension:
        raise ValueError(f"{found[2]} is another kind of quantity")
    # to the digits that are written: 0.5 kHz are 500 Hz, and 2 pi leaves no rounding error
    return float(f"{float(found[1]) * (given.factor / own.factor):.15g}")

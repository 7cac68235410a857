# SPDX-License-Identifier: Apache-2.0
"""Numbers of a rig file with their units, and the errors that name a key, what was found and what was expected.

The parts of a rig are dataclasses whose fields have these types: pydantic checks them where a file is read, and nothing
does where they are made in Python.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import pydantic

from abrace_core import AbraceError
from abrace_core.files.quantity import Quantity

if TYPE_CHECKING:
    from collections.abc import Sequence

LARGEST = 1e15
"""Largest number in SI units, and 1 over the smallest positive one: no ratio of two overflows."""


def _not_tiny(number: float) -> float:
    if 0 < number < 1 / LARGEST:
        raise ValueError(f"a number in SI units is at least {1 / LARGEST:g}")
    return number


Real = Annotated[float, pydantic.Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, pydantic.Field(ge=0, le=LARGEST), pydantic.AfterValidator(_not_tiny)]
Positive = Annotated[float, pydantic.Field(gt=0, le=LARGEST), pydantic.AfterValidator(_not_tiny)]

Mass = Annotated[Positive, Quantity("kg")]
Length = Annotated[Positive, Quantity("m")]
Force = Annotated[Positive, Quantity("N")]
ForceRate = Annotated[Positive, Quantity("N/s")]
Stiffness = Annotated[Positive, Quantity("N/m")]
Hertz = Annotated[Positive, Quantity("Hz")]
AngularFrequency = Annotated[Positive, Quantity("rad/s")]
SampleRate = Annotated[float, pydantic.Field(ge=20, le=2e4), Quantity("Hz")]
Velocity = Annotated[Positive, Quantity("m/s")]
Acceleration = Annotated[Positive, Quantity("m/s^2")]
SomeLength = Annotated[NotNegative, Quantity("m")]
SomeForce = Annotated[NotNegative, Quantity("N")]
SomeAcceleration = Annotated[NotNegative, Quantity("m/s^2")]
"""These three may be zero: there is none."""
DampingRatio = Annotated[float, pydantic.Field(ge=5e-5, le=0.4), Quantity("1")]
"""Of a mode of a building."""
Share = Annotated[float, pydantic.Field(ge=-2, le=2), Quantity("1")]
"""Of a local mode's greatest displacement."""


def expect(holds: bool, key: str, found: object, expected: str) -> None:
    """Unless something `holds`, raise an AbraceError: `key`: `found`, expected `expected`."""
    if not holds:
        raise AbraceError(f"{key}: {found}, expected {expected}")


def expect_one_each(
    values: Sequence[float] | Sequence[list[float]], key: str, count: int, of: str, what: str = "numbers"
) -> None:
    """Require one of the `values` at a `key` for each of `count` `of`; `what` describes them in the error."""
    expect(len(values) == count, key, f"{len(values)} {what}", f"one for each of {count} {of}")

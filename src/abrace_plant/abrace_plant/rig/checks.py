# SPDX-License-Identifier: Apache-2.0
"""Numbers of a rig file, and the errors that name a key, what was found and what was expected."""

from __future__ import annotations

from typing import Annotated

import pydantic

from abrace_core.errors import AbraceError

LARGEST = 1e15
"""Largest number in SI units, and 1 over the smallest positive one: no ratio of two overflows."""


def _not_tiny(number: float) -> float:
    if 0 < number < 1 / LARGEST:
        raise ValueError(f"a number in SI units is at least {1 / LARGEST:g}")
    return number


Real = Annotated[float, pydantic.Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, pydantic.Field(ge=0, le=LARGEST), pydantic.AfterValidator(_not_tiny)]
Positive = Annotated[float, pydantic.Field(gt=0, le=LARGEST), pydantic.AfterValidator(_not_tiny)]
DampingRatio = Annotated[float, pydantic.Field(gt=0, lt=1)]


def expect(holds: bool, key: str, found: object, expected: str) -> None:
    """Unless something `holds`, raise an AbraceError: `key`: `found`, expected `expected`."""
    if not holds:
        raise AbraceError(f"{key}: {found}, expected {expected}")


def expect_one_each(
    values: list[float] | list[list[float]], key: str, count: int, of: str, what: str = "numbers"
) -> None:
    """Require one of the `values` at a `key` for each of `count` `of`; `what` describes them in the error."""
    expect(len(values) == count, key, f"{len(values)} {what}", f"one for each of {count} {of}")

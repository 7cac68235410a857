# SPDX-License-Identifier: Apache-2.0
"""Frozen dataclasses that hold arrays, as values: nobody can change them, they can be compared and hashed."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Hashable

    from numpy.typing import ArrayLike, NDArray


class Value:
    """Base of a dataclass (frozen, eq=False) whose instances are equal where all fields are that count in comparisons.

    What leaves a process and comes back, or is copied, is made anew from its fields: its arrays are read-only again.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(_equal(one, two) for one, two in zip(_compared(self), _compared(other), strict=True))

    def __hash__(self) -> int:
        return hash(tuple(_hashable(value) for value in _compared(self)))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), tuple(getattr(self, field.name) for field in fields(self))  # type: ignore[arg-type]


def read_only(values: ArrayLike, shape: tuple[int, ...], what: str) -> NDArray[np.float64]:
    """A copy of `values` as an array of finite numbers of this `shape` that cannot be written to.

    Raises
    ------
    AbraceError
        If it has another shape, or an entry that is no finite number; begins with `what`.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise AbraceError(f"{what}: {error}, expected numbers of shape {shape}") from error
    if array.size == 0 and 0 in shape:
        array = np.zeros(shape)
    if array.shape != shape:
        raise AbraceError(f"{what}: shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise AbraceError(f"{what}: has a value that is not finite")
    array.flags.writeable = False
    return array


def _compared(value: Value) -> list[Any]:
    return [getattr(value, field.name) for field in fields(value) if field.compare]  # type: ignore[arg-type]


def _equal(one: Any, other: Any) -> bool:
    return np.array_equal(one, other) if isinstance(one, np.ndarray) else bool(one == other)


def _hashable(value: Any) -> Hashable:
    if isinstance(value, dict):
        return frozenset(value.items())
    return (value.shape, (value + 0.0).tobytes()) if isinstance(value, np.ndarray) else value  # -0.0 equals 0.0

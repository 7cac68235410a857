# SPDX-License-Identifier: Apache-2.0
"""Verdicts from numbers: how far a model can be trusted. A number that is none is never trusted, nor lost."""

from __future__ import annotations

from enum import IntEnum


class Verdict(IntEnum):
    """How far a model can be trusted."""

    TRUST = 0
    CARE = 1
    DONT = 2

    @property
    def words(self) -> str:
        """The verdict as text, in files and on the terminal."""
        return ("trust", "trust with care", "don't trust")[self]


def nan_first(value: float) -> tuple[bool, float]:
    """The key of a `value` by which `min` finds NaN, if there is one: without it `min` loses one that is not the first.

    >>> min([0.4, float("nan"), 0.2], key=nan_first), min([0.4, float("nan"), 0.2])
    (nan, 0.2)
    """
    return value == value, value


def nan_last(value: float) -> tuple[bool, float]:
    """The key of a `value` by which `max` finds NaN, if there is one.

    >>> max([0.4, float("nan"), 0.2], key=nan_last), max([0.4, float("nan"), 0.2])
    (nan, 0.4)
    """
    return value != value, value


def judged(value: float, care: float, dont: float | None = None) -> Verdict:
    """The verdict on a `value`: "trust with care" above `care`, and "don't trust" above `dont`, if that is given.

    A value or limit that is not a number (NaN) cannot be judged: that is "trust with care", never "trust".

    >>> [judged(value, 0.03, 0.3).words for value in (0.01, 0.1, 1.0, float("nan"))]
    ['trust', 'trust with care', "don't trust", 'trust with care']
    """
    if dont is not None and value > dont:
        return Verdict.DONT
    return Verdict.TRUST if value <= care else Verdict.CARE

# SPDX-License-Identifier: Apache-2.0
"""Loops that have to go sample by sample, compiled at their first call.

numba compiles them and caches the result next to the source (or, where that cannot be written, in the user's cache
folder), so that only the first call on a machine waits for the compiler. A new process still needs about a second to
import numba and load the result: a loop in real time calls once before it starts.
"""

from __future__ import annotations

from functools import cache, wraps
from typing import TYPE_CHECKING, ParamSpec, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator for a function of numbers, arrays and tuples of arrays that consists of loops over them.

    It is compiled for each combination of types and memory layouts of its arguments: give it contiguous arrays of
    float64 (or structured ones, for named columns), and scalars of one type. A plain tuple costs less at each call than
    a named one, which the function can make of it.

    Parameters
    ----------
    function
        What numba's nopython mode can compile; it calls no other compiled function.
    """

    @cache
    def ready() -> Callable[P, R]:
        import numba

        try:
            return cast("Callable[P, R]", numba.njit(cache=True)(function))
        except RuntimeError:  # no folder for the cache: compile in each process
            return cast("Callable[P, R]", numba.njit(function))

    @wraps(function)
    def call(*arguments: P.args, **keywords: P.kwargs) -> R:
        return ready()(*arguments, **keywords)

    return call

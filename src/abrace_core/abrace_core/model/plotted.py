# SPDX-License-Identifier: Apache-2.0
"""What methods such as `plot` of runs, models and records call: the package `abrace` registers how each is drawn.

So nothing that acts on a rig imports a figure.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

_DRAWN: dict[tuple[type, str], Callable[..., Any]] = {}


def draws(kind: type, what: str = "plot") -> Callable[[Callable[..., Figure]], Callable[..., Figure]]:
    """Register a function that draws, when the method `what` of an instance of a `kind` is called."""

    def register(function: Callable[..., Figure]) -> Callable[..., Figure]:
        _DRAWN[kind, what] = function
        return function

    return register


def figure_of(subject: object, what: str, *given: Any) -> Figure:
    """The figure of a `subject` that its method `what` gives, with what that was `given`.

    Raises
    ------
    AbraceError
        If the package `abrace` was not imported, or what was given does not fit.
    """
    if (type(subject), what) not in _DRAWN:
        raise AbraceError(
            f"figure of a {type(subject).__name__}: nothing to draw it with, expected `import abrace` before"
        )
    figure: Figure = _DRAWN[type(subject), what](subject, *given)
    return figure

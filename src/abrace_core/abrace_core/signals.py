"""Names of the rig's signals, as the paper writes them: z = [x1, x2, x3, xf, a1, a2, a3, f], U and W."""

from __future__ import annotations

from string import ascii_lowercase
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

GROUND = "w"
"""The table's acceleration W [m/s^2]."""


def numbered(letter: str, count: int) -> tuple[str, ...]:
    """`letter` alone where `count` is 1, else `letter1`, `letter2`, ...

    >>> numbered("xf", 1), numbered("xf", 2)
    (('xf',), ('xf1', 'xf2'))
    """
    return (letter,) if count == 1 else tuple(f"{letter}{i + 1}" for i in range(count))


def response_names(floors: int, groups: int) -> tuple[str, ...]:
    """Names of the recorded quantities z of a rig of `floors` floors and `groups` brace groups.

    Displacements, strokes, absolute accelerations, forces, in this order; a group's force is the mean of its braces'.

    >>> response_names(3, 1)
    ('x1', 'x2', 'x3', 'xf', 'a1', 'a2', 'a3', 'f')
    """
    x = tuple(f"x{i + 1}" for i in range(floors))
    a = tuple(f"a{i + 1}" for i in range(floors))
    return x + numbered("xf", groups) + a + numbered("f", groups)


def load_cell_names(braces: Sequence[int]) -> tuple[str, ...]:
    """Names of the load cells, one in each brace, by the number of `braces` in each group.

    >>> load_cell_names([1]), load_cell_names([2]), load_cell_names([1, 2])
    (('f',), ('fa', 'fb'), ('f1', 'f2a', 'f2b'))
    """
    return tuple(
        f"{group}{letter if count > 1 else ''}"
        for group, count in zip(numbered("f", len(braces)), braces, strict=True)
        for letter in ascii_lowercase[:count]
    )


def channel_names(floors: int, braces: Sequence[int]) -> tuple[str, ...]:
    """Names of a rig's measured channels, by its `floors` and the number of `braces` in each group.

    Displacements, strokes, absolute accelerations, load cells, the table's acceleration, in this order.

    >>> channel_names(1, [2])
    ('x1', 'xf', 'a1', 'fa', 'fb', 'w')
    """
    return (*response_names(floors, len(braces))[: -len(braces) or None], *load_cell_names(braces), GROUND)


def command_names(groups: int) -> tuple[str, ...]:
    """Names of the commands U, one for each of `groups` brace groups."""
    return numbered("U", groups)


def unit(name: str) -> str:
    """SI unit of a signal, from its name.

    >>> unit("x3"), unit("xf"), unit("a1"), unit("f"), unit("U"), unit("w")
    ('m', 'm', 'm/s^2', 'N', 'N', 'm/s^2')
    """
    return {"x": "m", "a": "m/s^2", "w": "m/s^2", "f": "N", "U": "N"}[name[0]]

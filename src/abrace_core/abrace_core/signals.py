"""Names of the rig's signals, as the paper writes them: z = [x1, x2, x3, xf, a1, a2, a3, f], U and W."""

from __future__ import annotations

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

    Displacements, strokes, absolute accelerations, forces, in this order.

    >>> response_names(3, 1)
    ('x1', 'x2', 'x3', 'xf', 'a1', 'a2', 'a3', 'f')
    """
    x = tuple(f"x{i + 1}" for i in range(floors))
    a = tuple(f"a{i + 1}" for i in range(floors))
    return x + numbered("xf", groups) + a + numbered("f", groups)


def command_names(groups: int) -> tuple[str, ...]:
    """Names of the commands U, one for each of `groups` brace groups."""
    return numbered("U", groups)


def unit(name: str) -> str:
    """SI unit of a signal, from its name.

    >>> unit("x3"), unit("xf"), unit("a1"), unit("f"), unit("U"), unit("w")
    ('m', 'm', 'm/s^2', 'N', 'N', 'm/s^2')
    """
    return {"x": "m", "a": "m/s^2", "w": "m/s^2", "f": "N", "U": "N"}[name[0]]

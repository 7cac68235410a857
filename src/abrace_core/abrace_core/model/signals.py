# SPDX-License-Identifier: Apache-2.0
"""Names of the rig's signals, as the paper writes them: z = [x1, x2, x3, xf, a1, a2, a3, f], U and W."""

from __future__ import annotations

import math
import re
from string import ascii_lowercase
from typing import TYPE_CHECKING

from abrace_core import AbraceError
from abrace_core.files.units import unit_as_stated

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

GROUND = "w"
"""The table's acceleration W [m/s^2]."""

OTHER_UNITS: dict[str, dict[str, float]] = {
    kind: {text: 1 / found.factor for text in texts if (found := unit_as_stated(text)) is not None}
    for kind, texts in (
        ("a", ("g", "mg", "cm/s^2", "mm/s^2", "in/s^2", "ft/s^2")),
        ("x", ("mm", "cm", "in", "um")),
        ("f", ("kgf", "kN", "lbf", "tf")),
    )
}
"""For each kind of channel (first letter): other usual units, as multiples of the expected unit."""

SAME_UNIT = 0.05
"""A ratio is that of a unit if it differs by less than this share."""

MOST_SHOWN = 24
"""Names that an error lists."""

_LETTERS = {"displacement": "x", "stroke": "xf", "acceleration": "a", "command": "U"}
_IN_MESSAGES = re.compile(rf"({'|'.join(_LETTERS)})(?:\[(\d+)\]|_(\d+))")
_IN_PAPER = re.compile(r"(xf|x|a|U)(\d*)")
_RECORDED = re.compile(r"x[1-9]\d*|a[1-9]\d*|xf\d*|f\d*")
_OF_RIG = re.compile(r"(xf?|a|U)\d*|f\d*[a-z]?|w")


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


def recorded_names(floors: int, braces: Sequence[int], without: Collection[str]) -> tuple[str, ...]:
    """The `response_names` of a rig of `floors` floors that has no sensor for the channels `without`.

    `braces` is their number in each group. A group's force is recorded if one of its load cells is there.

    >>> recorded_names(2, [2], ["x1", "xf", "a2", "fb"]), recorded_names(1, [1], ["f"])
    (('x2', 'a1', 'f'), ('x1', 'xf', 'a1'))
    """
    names, cells = response_names(floors, len(braces)), iter(load_cell_names(braces))
    of_group = {
        name: [next(cells) for _ in range(count)]
        for name, count in zip(numbered("f", len(braces)), braces, strict=True)
    }
    return tuple(name for name in names if not {*of_group.get(name, [name])} <= {*without})


def command_names(groups: int) -> tuple[str, ...]:
    """Names of the commands U, one for each of `groups` brace groups."""
    return numbered("U", groups)


def positions(names: Sequence[str], known: Sequence[str], missing: str) -> list[int]:
    """Positions of signals among the known ones, each in the paper's form or in that of messages.

    `x2` is also `displacement[1]`, as a bag's messages have it, and `displacement_2`, as column 2 of a matrix; likewise
    stroke (xf), acceleration (a) and command (U); `w` is `ground_acceleration`. `f` has no other form: the messages'
    `force` is that of single braces.

    >>> positions(["displacement[1]", "w"], ["x1", "x2", "w"], "no channel")
    [1, 2]

    Parameters
    ----------
    names
        Names in either form; one alone may be a text.
    known
        Names of the signals that there are, each in either form.
    missing
        How an error begins.

    Raises
    ------
    AbraceError
        `<missing> '<name>', '<name>', it has ...`, with all names that are not known.
    """
    names = [names] if isinstance(names, str) else [str(name) for name in names]
    places = {meaning(name): i for i, name in enumerate(known)} | {name: i for i, name in enumerate(known)}
    found = [places.get(name, places.get(meaning(name))) for name in names]
    unknown = [repr(name) for name, place in zip(names, found, strict=True) if place is None]
    if unknown:
        shown = known if len(known) <= MOST_SHOWN else [*known[: MOST_SHOWN - 1], f"... {known[-1]}"]
        raise AbraceError(f"{missing} {', '.join(unknown)}, it has {', '.join(shown)}")
    return [place for place in found if place is not None]


def meaning(name: str) -> tuple[str, int] | str:
    """Letter and number of the signal `name` in any of its forms; other names as they are."""
    if name in (GROUND, "ground_acceleration"):
        return GROUND, 1
    if in_message := _IN_MESSAGES.fullmatch(name):
        field, index, number = in_message.groups()
        return _LETTERS[field], int(number) if index is None else int(index) + 1
    if in_paper := _IN_PAPER.fullmatch(name):
        return in_paper[1], int(in_paper[2] or 1)
    return name


def most_telling(names: Sequence[str]) -> tuple[str, ...]:
    """The top floor's displacement and the lowest floor's acceleration, as far as `names` have them; else the first.

    >>> most_telling(["x1", "x2", "xf", "a1", "a2", "f"]), most_telling(["force"])
    (('x2', 'a1'), ('force',))
    """
    floors = [name for name in names if name[0] == "x" and name[1:].isdigit()]
    return (*floors[-1:], *[name for name in names if name[0] == "a"][:1]) or tuple(names[:1])


def unit(name: str) -> str:
    """SI unit of a signal of a rig, from its name; "-" for any other.

    >>> unit("x3"), unit("xf"), unit("a1"), unit("f"), unit("U"), unit("w"), unit("force")
    ('m', 'm', 'm/s^2', 'N', 'N', 'm/s^2', '-')
    """
    units = {"x": "m", "a": "m/s^2", "w": "m/s^2", "f": "N", "U": "N"}
    return units[name[0]] if _OF_RIG.fullmatch(name) else "-"


def field_of(name: str) -> str:
    """The element of a `LawSample` that has the recorded quantity `name`.

    >>> field_of("a2"), field_of("xf"), field_of("f3")
    ('acceleration[1]', 'stroke[0]', 'force[2]')
    """
    fields = {letter: field for field, letter in _LETTERS.items()} | {"f": "force"}
    letter = name.rstrip("0123456789")
    return f"{fields[letter]}[{int(name[len(letter) :] or 1) - 1}]"


def require_finite(number: int, values: Sequence[float], names: Sequence[str], used: Collection[str]) -> None:
    """Refuse a sample with a recorded quantity that is not finite: a control law would keep it in its state.

    Parameters
    ----------
    number
        Of the sample in its run.
    values, names
        Of the recorded quantities, in one order.
    used
        Those that are looked at.

    Raises
    ------
    AbraceError
        Naming the first of them that is not finite.
    """
    if math.isfinite(sum(values)):
        return
    for name, value in zip(names, values, strict=True):
        if name in used and not math.isfinite(value):
            raise AbraceError(f"{field_of(name)} of sample {number} is {value:g}, expected a finite number")


def unit_of_field(name: str) -> str:
    """SI unit of a signal by its `name` in any form, also of a message's field; "-" for any other.

    >>> unit_of_field("displacement[2]"), unit_of_field("force[0]"), unit_of_field("x3"), unit_of_field("force")
    ('m', 'N', 'm', 'N')
    """
    field = name.partition("[")[0]
    letter = {"force": "f", "table_displacement": "x", **_LETTERS}.get(field)
    known = meaning(name)
    return unit(letter or (name if isinstance(known, str) else known[0]))


def is_recorded(name: str) -> bool:
    """Whether `name` is one of a rig's recorded quantities (`response_names`).

    >>> [is_recorded(name) for name in ("x3", "xf", "a1", "f2", "U", "fa", "top")]
    [True, True, True, True, False, False, False]
    """
    return _RECORDED.fullmatch(name) is not None


def read_as(name: str, ratio: float) -> str:
    """The usual unit in which the signal `name` reads `ratio` times its SI value; empty: none.

    >>> read_as("a3", 0.1021), read_as("x1", -1000.0), read_as("a1", 0.6)
    ('g', 'mm', '')
    """
    units = OTHER_UNITS["a" if name == GROUND else name[0]] if name[0] in OTHER_UNITS or name == GROUND else {}
    nearest = min(units, key=lambda unit: abs(abs(ratio) / units[unit] - 1), default="")
    return nearest if nearest and abs(abs(ratio) / units[nearest] - 1) < SAME_UNIT else ""

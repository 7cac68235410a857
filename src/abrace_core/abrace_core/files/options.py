# SPDX-License-Identifier: Apache-2.0
"""The options of a verb, stated once: for Python's keywords, a node's parameters, a campaign's keys, a command.

An option has a name, a type, a default, a range and a description with its unit, as a field of a class. What is not
given has a value that ROS has as well: 0, an empty text, an empty list, the band (0, 0).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from inspect import get_annotations
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
import pydantic

from abrace_core.files.config_file import Checked, validated

KINDS: dict[str, type] = {"boolean": bool, "integer": int, "number": float, "string": str, "object": str}
"""Types by their names in a JSON schema; numbers by name are given as texts NAME=NUMBER."""
NOT_GIVEN = (0.0, 0.0)
"""Instead of a band: the one that the verb finds."""

Count = Annotated[int, pydantic.Field(ge=0)]
NonNegative = Annotated[float, pydantic.Field(ge=0)]


def _two(given: Any) -> tuple[float, float]:
    try:
        low, high = (float(each) for each in given)
    except (TypeError, ValueError) as error:
        raise ValueError("two frequencies in Hz") from error
    if not low < high and (low, high) != NOT_GIVEN:
        raise ValueError("two frequencies in Hz, the lower one first")
    return low, high


Band = Annotated[tuple[NonNegative, NonNegative], pydantic.BeforeValidator(_two)]
"""Lowest and highest frequency [Hz], or NOT_GIVEN."""


def named_numbers(texts: Any) -> dict[str, list[float]]:
    """Numbers by name from `texts` such as a1=0; what is no text is left to pydantic.

    >>> named_numbers(["a1=0", "a3=-1", "a1=1.2"])
    {'a1': [0.0, 1.2], 'a3': [-1.0]}
    """
    found: dict[str, list[float]] = {}
    for text in texts:
        name, _, value = str(text).partition("=")
        try:
            number = float(value)
        except ValueError:
            number = np.nan
        if not name or not np.isfinite(number):
            raise ValueError("NAME=NUMBER, such as a1=0")
        found.setdefault(name, []).append(number)
    return found


def _by_name(given: Any) -> Any:
    if not isinstance(given, Mapping):
        return named_numbers(given) if isinstance(given, (list, tuple)) else given
    return {name: np.ravel(value).tolist() for name, value in given.items()}


NamedNumbers = Annotated[dict[str, tuple[float, ...]], pydantic.BeforeValidator(_by_name)]
"""Numbers by name, several of a name: a mapping, or texts NAME=NUMBER."""


Names = tuple[str, ...]


class Option(NamedTuple):
    """An option; of a list, `kind`, range and choices are those of each entry, and `length` is set if it is fixed."""

    name: str
    kind: type
    default: Any
    description: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]
    many: bool
    length: int | None
    required: bool

    def text(self) -> str:
        """Description, and the valid values."""
        valid = f"one of {', '.join(self.choices)}" if self.choices else ""
        if self.low is not None:
            valid = f"{self.low:g} or more" if self.high is None else f"{self.low:g} to {self.high:g}"
        return f"{self.description} ({valid})" if valid else self.description


class Options(Checked):
    """Base of the options of every verb."""

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """The options `given` by name.

        Raises
        ------
        AbraceError
            `<who>: <name>: <value>, expected ...`, with every mistake found.
        """
        return validated(given, cls, cls.who)

    @classmethod
    def of_values(cls, values: object) -> Self:
        """The options in the attributes of `values`, such as a node's parameters."""
        return cls.of({name: getattr(values, name) for name in cls.model_fields})

    @classmethod
    @cache
    def listed(cls) -> dict[str, Option]:
        """Every option by name."""
        schema = cls.model_json_schema()
        own_first = dict.fromkeys(name for each in cls.__mro__ for name in get_annotations(each))
        names = [name for name in own_first if name in schema["properties"]]
        return {name: _option(name, schema["properties"][name], schema.get("required", ())) for name in names}

    @pydantic.field_validator("*", mode="before")
    @classmethod
    def _as_meant(cls, given: Any, info: pydantic.ValidationInfo) -> Any:
        """Arrays as lists, a single value of a list as a list; a text is no number, though pydantic would read one."""
        given = given.tolist() if isinstance(given, (np.ndarray, np.generic)) else given
        option = cls.listed()[str(info.field_name)]
        if option.many and option.length is None and isinstance(given, (str, int, float)):
            given = [given]
        if option.kind is str and not option.choices:
            return [_text(each) for each in given] if option.many and isinstance(given, (list, tuple)) else _text(given)
        if option.kind in (int, float):
            for each in given if isinstance(given, (list, tuple)) else [given]:
                if isinstance(each, (str, bool)):
                    raise ValueError("a whole number" if option.kind is int else "a number")
        return given


def _text(given: Any) -> Any:
    """A number as its text: a channel may be 2, a file 1940."""
    return str(given) if isinstance(given, (int, float)) and not isinstance(given, bool) else given


def _option(name: str, content: Mapping[str, Any], required: Any) -> Option:
    many = content.get("type") in ("array", "object")
    each = content.get("items") or (content.get("prefixItems") or [content])[0]
    kind = KINDS.get(each.get("type", ""), str)
    default = content.get("default", [] if many else kind())
    low, high = (None if each.get(key) is None else kind(each[key]) for key in ("minimum", "maximum"))
    return Option(
        name,
        kind,
        list(default) if many else default,
        content.get("description", ""),
        low,
        high,
        tuple(each.get("enum", ())),
        many,
        len(content["prefixItems"]) if "prefixItems" in content else None,
        name in required,
    )

# SPDX-License-Identifier: Apache-2.0
"""Readable errors for files that people write: pydantic's findings in abrace's wording."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, get_args

import pydantic

from abrace_core.suggestion import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence


LONGEST_VALUE = 60
"""Characters of a wrong value that are shown."""

_KINDS = (
    ("float", "a number"),
    ("int", "a whole number"),
    ("bool", "true or false"),
    ("string_type", "a text"),
    ("list", "a list"),
    ("tuple", "a list"),
    ("dict", "keys and values"),
    ("model", "keys and values"),
    ("finite_number", "a finite number"),
    ("string_too_short", "a text of at least 1 letter"),
)
_BOUNDS = {
    "greater_than": ("gt", "a number greater than {}"),
    "greater_than_equal": ("ge", "a number greater than or equal to {}"),
    "less_than": ("lt", "a number less than {}"),
    "less_than_equal": ("le", "a number less than or equal to {}"),
    "literal_error": ("expected", "{}"),
    "union_tag_invalid": ("expected_tags", "one of {}"),
    "too_short": ("min_length", "a list of at least {}"),
    "too_long": ("max_length", "a list of at most {}"),
}
_UNIT = re.compile(r"[-+]?[\d.]+(?:[eE][-+]?\d+)?\s*[A-Za-z%/]+[\w/^%* ]*")


def mistakes(
    error: pydantic.ValidationError, schema: type[pydantic.BaseModel], tagged: Collection[str] = ()
) -> list[str]:
    """A text for each mistake, unknown keys first.

    Parameters
    ----------
    error
        What pydantic has found.
    schema
        What was expected; its keys are suggested.
    tagged
        Keys of which there are several kinds; the name of the kind, which follows in pydantic's place, is left out.
    """
    found: list[dict[str, Any]] = [{**each, "loc": _untagged(each["loc"], tagged)} for each in error.errors()]
    missing = {_place(each): str(each["loc"][-1]) for each in found if each["type"] == "missing"}
    unknown = []
    for each in found:
        if each["type"] == "extra_forbidden":
            wrong, folder = str(each["loc"][-1]), _folder(_place(each))
            siblings = {name: place for place, name in missing.items() if _folder(place) == folder}
            near = did_you_mean(wrong, siblings)
            for name, place in siblings.items():
                if near == f", did you mean {name}?":
                    del missing[place]  # a misspelt key is both unknown and missing
            unknown.append(f"{_place(each)}: unknown key{near or did_you_mean(wrong, keys_of(schema))}")
    values = [wrong_value(each) for each in found if each["type"] not in ("extra_forbidden", "missing")]
    return [*unknown, *(f"{place}: key is missing" for place in missing), *values]


def _untagged(place: Sequence[str | int], tagged: Collection[str]) -> tuple[str | int, ...]:
    return tuple(part for i, part in enumerate(place) if not (i and place[i - 1] in tagged))


def _folder(place: str) -> str:
    return place.rpartition(".")[0]


def wrong_value(found: Mapping[str, Any]) -> str:
    """`key: value, expected ...` of one thing that pydantic has `found`."""
    value: Any = found["input"]
    if found["type"] == "union_tag_invalid":
        value = found["ctx"]["tag"]
    shown = "nothing" if value is None else repr(value)
    shown = shown if len(shown) <= LONGEST_VALUE else f"{shown[:LONGEST_VALUE]}..."
    what = f"{shown}, expected {expected(found, value)}" if found["loc"] else f"expected {expected(found, value)}"
    return f"{_place(found) or 'as a whole'}: {what}"


def expected(found: Mapping[str, Any], value: Any) -> str:
    """What was expected in the place of a `value` that pydantic has `found` wrong."""
    kind, context = found["type"], found.get("ctx", {})
    if kind in _BOUNDS:
        name, words = _BOUNDS[kind]
        bound = context[name]
        text = words.format(f"{bound:g}" if isinstance(bound, float) else bound)
        return text + (did_you_mean(value, re.findall(r"'([^']+)'", text)) if isinstance(value, str) else "")
    words = next((words for start, words in _KINDS if kind.startswith(start)), "")
    if not words:
        message = found["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
        return message[:1].lower() + message[1:] if message[1:2].islower() else message
    return words + (_numbers_mistake(value) if "number" in words and isinstance(value, str) else "")


def _numbers_mistake(text: str) -> str:
    """A hint why a text is not a number."""
    try:
        float(text)
    except ValueError:
        pass
    else:
        return " without quotation marks"
    if re.fullmatch(r"[-+]?\d+,\d+", text):
        return " with a decimal point"
    return " without its unit" if _UNIT.fullmatch(text) else ""


def _place(found: Mapping[str, Any]) -> str:
    return ".".join(str(part) for part in found["loc"])


def keys_of(schema: Any) -> set[str]:
    """The keys that a `schema`, or a type with schemas in it, has at any depth."""
    seen: dict[type, Mapping[str, Any]] = {}

    def walk(annotation: Any) -> None:
        is_schema = isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel)
        if is_schema and annotation not in seen:
            seen[annotation] = annotation.model_fields
            for field in annotation.model_fields.values():
                walk(field.annotation)
        for inner in get_args(annotation):
            walk(inner)

    walk(schema)
    return {name for fields in seen.values() for name in fields}

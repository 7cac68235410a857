# SPDX-License-Identifier: Apache-2.0
"""What pydantic finds in files that people write, with key and value, and the keys that may have been meant."""

from __future__ import annotations

import re
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import pydantic

from abrace_core.files.suggestion import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence


LONGEST_VALUE = 60
"""Characters of a wrong value that are shown."""

LEAST = 1e-9
"""A least value so small stands for more than 0."""
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
"""What pydantic calls an unknown key of a model, and of a dataclass."""
_IN_WORDS = {
    "model_type": "keys and values",
    "dataclass_type": "keys and values",
    "dict_type": "keys and values",
    "tuple_type": "a list",
}
"""What pydantic says in words of Python."""


def mistakes(error: pydantic.ValidationError, schema: type, tagged: Collection[str] = ()) -> list[str]:
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
        if each["type"] in _UNKNOWN:
            wrong, folder = str(each["loc"][-1]), _folder(_place(each))
            siblings = {name: place for place, name in missing.items() if _folder(place) == folder}
            near = did_you_mean(wrong, siblings)
            for name, place in siblings.items():
                if near == f", did you mean {name}?":
                    del missing[place]  # a misspelt key is both unknown and missing
            unknown.append(f"{_place(each)}: unknown key{near or did_you_mean(wrong, _keys_of(schema))}")
    values = [_wrong_value(each) for each in found if each["type"] not in (*_UNKNOWN, "missing")]
    return [*unknown, *(f"{place}: key is missing" for place in missing), *values]


def _untagged(place: Sequence[str | int], tagged: Collection[str]) -> tuple[str | int, ...]:
    return tuple(part for i, part in enumerate(place) if not (i and place[i - 1] in tagged))


def _folder(place: str) -> str:
    return place.rpartition(".")[0]


def _wrong_value(found: Mapping[str, Any]) -> str:
    """`key: value, expected ...` of one thing that pydantic has `found`."""
    value: Any = found["ctx"]["tag"] if found["type"] == "union_tag_invalid" else found["input"]
    shown = "nothing" if value is None else repr(value)
    shown = shown if len(shown) <= LONGEST_VALUE else f"{shown[:LONGEST_VALUE]}..."
    message = _IN_WORDS.get(found["type"], found["msg"])
    message = message.removeprefix("Value error, ").removeprefix("Input should be ")
    if found["type"] == "greater_than_equal" and 0 < found["ctx"]["ge"] <= LEAST:
        message = "a number above 0"
    if found["type"] == "union_tag_invalid":
        message = f"one of {found['ctx']['expected_tags']}"
    expected = message[:1].lower() + message[1:] if message[1:2].islower() else message
    near = did_you_mean(value, re.findall(r"'([^']+)'", expected)) if isinstance(value, str) else ""
    where = f"{_place(found)}: {shown}," if found["loc"] else "as a whole:"
    return f"{where} expected {expected}{near}"


def _place(found: Mapping[str, Any]) -> str:
    return ".".join(str(part) for part in found["loc"])


def _keys_of(schema: Any) -> set[str]:
    """The keys that a `schema`, or a type with schemas in it, has at any depth."""
    seen: dict[type, Mapping[str, Any]] = {}

    def walk(annotation: Any) -> None:
        if isinstance(annotation, type) and annotation not in seen:
            if issubclass(annotation, pydantic.BaseModel):
                seen[annotation] = {name: each.annotation for name, each in annotation.model_fields.items()}
            elif is_dataclass(annotation):
                seen[annotation] = get_type_hints(annotation)
            for inner in seen.get(annotation, {}).values():
                walk(inner)
        for inner in get_args(annotation):
            walk(inner)

    walk(schema)
    return {name for fields in seen.values() for name in fields}

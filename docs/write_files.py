# SPDX-License-Identifier: Apache-2.0
"""Write docs/files.md from the schemas that check every file: `python docs/write_files.py`."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import pages
import pydantic
import yaml

from abrace.campaign import file
from abrace_core import AbraceError
from abrace_core.model.linear_model import _File as ModelFile
from abrace_lqg.weights import Weights
from abrace_plant.devices.calibration import CalibrationFile
from abrace_plant.devices.layout import Layout
from abrace_plant.devices.udp import UdpFile
from abrace_plant.rig.file import _Rig
from abrace_studies.benchmark.definition import Definition, RigDefinition
from abrace_studies.frames.file import _File as FrameFile

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

MEANINGS = pages.DOCS / "key_meanings.yaml"
UNBOUNDED = 1e15
"""Bounds as large as this only keep numbers finite."""

INTRODUCTION = """# Files, key by key

A file that people write is YAML. An unknown key, a value of another type or one out of its range is refused, in one
line that names the file, the key, the value and what was expected.

`a.b` is the key `b` in `a`, `a[].b` is `b` of each entry of the list `a`. In `a.*.b` the star is one of the names in
the line `a.*`, or a name that you choose. A key without a default is required; one with the default "none" may be left
out. Numbers are in SI units unless the meaning gives another; a *quantity* is a number that may carry its own unit
([units](rig.md#units)).

*Made from the schemas that check the files by `docs/write_files.py`.*
"""


class Described(NamedTuple):
    """A file: its heading, the schemas of its keys by their place in it, and what it is."""

    title: str
    schemas: Mapping[str, type]
    about: str


WRITTEN_BY_PEOPLE = (
    Described("Rig file", {"": _Rig}, "Building, braces, table, sensors: [the rig and its file](rig.md)."),
    Described(
        "Campaign file",
        {"": file._Campaign, "steps[].": file._Step},
        "The steps of a test day: [campaigns](campaigns.md).",
    ),
    Described("Weights file", {"": Weights}, "What an LQG design weighs and measures: [choose weights](weights.md)."),
    Described("Frame file", {"": FrameFile}, "A building of plane frames: [compare controllers](compare.md)."),
    Described(
        "Benchmark file of a frame",
        {"": Definition},
        "Devices, sensors, earthquakes on a frame file's building: [benchmarks](compare.md).",
    ),
    Described(
        "Benchmark file of a rig",
        {"": RigDefinition},
        "Earthquakes and reference controllers on a rig: [benchmarks](compare.md).",
    ),
    Described(
        "Device file, kind udp", {"": UdpFile}, "A target that sends and takes UDP packets: [real hardware](bridge.md)."
    ),
    Described(
        "Layout file",
        {"": Layout},
        "The packets of a `udp` device: [real hardware](bridge.md#packets-of-another-target).",
    ),
    Described(
        "Calibration file",
        {"": CalibrationFile},
        "Gain, offset, range and delay of each channel: [calibration](bridge.md#calibration). The star is a "
        "signal's name: x1, xf, a1, fa, w; for commands U and w.",
    ),
)
MODEL_FILE = Described(
    "Model file", {"": ModelFile}, "Written by `identify` (JSON): [identification](identification.md)."
)
CONTROLLER_FILE = """### Controller file

What `design` writes and the node `controller` takes: a ROS parameter file with [its parameters](nodes.md#controller).
"""


class Row(NamedTuple):
    """A key: its place, type, default and range, in words; its meaning, where its schema states it."""

    key: str
    kind: str
    default: str
    allowed: str
    meaning: str = ""


def rows(schema: type, place: str = "") -> Iterator[Row]:
    """Every key of a `schema` whose keys stand at a `place` of its file."""
    content = pydantic.TypeAdapter(schema).json_schema(by_alias=True)
    yield from _object(content, content.get("$defs", {}), place)


def _object(content: Mapping[str, Any], known: Mapping[str, Any], place: str) -> Iterator[Row]:
    required = content.get("required", [])
    groups: dict[str, list[str]] = {}
    for name, inner in content.get("properties", {}).items():
        keys = [key for each in _alternatives(inner, known) for key in each.get("properties", ())]
        groups.setdefault(str(keys) if keys else name, []).append(name)
    for names in groups.values():
        inner = content["properties"][names[0]]
        default = "" if set(names) & set(required) else _default(inner)
        if len(names) > 2:
            yield Row(f"{place}*", f"`*`: {', '.join(names)}", "", "")
            each = [_value(f"{place}*", content["properties"][name], known, default) for name in names]
            for first, *others in zip(*each, strict=True):
                same = all(other.kind == first.kind for other in others)
                yield first if same else first._replace(kind="quantity")
            continue
        for name in names:
            yield from _value(f"{place}{name}", content["properties"][name], known, default)


def _value(key: str, content: Mapping[str, Any], known: Mapping[str, Any], default: str) -> Iterator[Row]:
    """The rows of a key: itself, or the keys inside it."""
    found: dict[str, list[Row]] = {}
    for each in _alternatives(content, known):
        for row in _one(key, each, known, default):
            found.setdefault(row.key, []).append(row)
    if key not in found and default:
        yield Row(key, "keys and values", default, "")
    for place, alike in found.items():
        columns = zip(*(row[1:4] for row in alike), strict=True)
        kinds, defaults, ranges = (" or ".join(dict.fromkeys(filter(None, texts))) for texts in columns)
        free = any(row.kind == "text" and not row.allowed for row in alike)
        allowed = f"{ranges}, or any other" if ranges and free else ranges
        yield Row(place, kinds, defaults, allowed, alike[0].meaning)


def _one(key: str, content: Mapping[str, Any], known: Mapping[str, Any], default: str) -> Iterator[Row]:
    if "properties" in content:
        yield from _object(content, known, f"{key}.")
    elif content.get("type") == "object" and isinstance(content.get("additionalProperties"), dict):
        yield from _value(f"{key}.*", content["additionalProperties"], known, "")
    elif any("properties" in each for each in _alternatives(content.get("items", {}), known)):
        yield from _value(f"{key}[]", content["items"], known, "")
    else:
        yield Row(key, _kind(content, known), default, _allowed(content, known), content.get("description", ""))


def _alternatives(content: Mapping[str, Any], known: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """What a value may be, null left out: its default says it."""
    if "$ref" in content:
        content = known[content["$ref"].rpartition("/")[2]]
    several = content.get("anyOf") or content.get("oneOf")
    if not several:
        return [] if content.get("type") == "null" else [content]
    return [found for each in several for found in _alternatives(each, known)]


def _kind(content: Mapping[str, Any], known: Mapping[str, Any]) -> str:
    kind = content.get("type", "")
    if kind == "array":
        inner = content.get("items") or (content.get("prefixItems") or [{}])[0]
        of = " or ".join(dict.fromkeys(_kind(each, known) for each in _alternatives(inner, known)))
        return f"list of {of}" if of else "list"
    if content.get("unit") == "1":
        return "number or %"
    if "unit" in content:
        return "quantity"
    names = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}
    return names.get(kind, "keys and values" if kind == "object" else "any")


def _allowed(content: Mapping[str, Any], known: Mapping[str, Any]) -> str:
    """The range, or the choices."""
    if content.get("type") == "array":
        inner = content.get("items") or (content.get("prefixItems") or [{}])[0]
        each = " or ".join(filter(None, (_allowed(one, known) for one in _alternatives(inner, known))))
        least, most = content.get("minItems"), content.get("maxItems")
        count = "" if least is None else f"{least} entries" if least == most else f"at least {least} of them"
        return "; each ".join(filter(None, (count, each))) if count else each
    choices = content.get("enum") or ([content["const"]] if "const" in content else [])
    if choices:
        return ", ".join(f"`{choice}`" for choice in choices)
    words = {"exclusiveMinimum": "above", "minimum": "at least", "exclusiveMaximum": "below", "maximum": "at most"}
    if {"minimum", "maximum"} <= content.keys() and content["maximum"] < UNBOUNDED:
        return f"{content['minimum']:g} to {content['maximum']:g}"
    bounds = [(word, content[name]) for name, word in words.items() if abs(content.get(name, UNBOUNDED)) < UNBOUNDED]
    return ", ".join(f"{word} {bound:g}" for word, bound in bounds)


def _default(content: Mapping[str, Any]) -> str:
    default = content.get("default")
    if default is None:
        return "none"
    if isinstance(default, dict):
        return "`{}`" if not default else "that of its keys"
    return f"`{str(default).lower() if isinstance(default, bool) else default}`" if default != "" else "empty"


@cache
def meanings() -> dict[str, dict[str, str]]:
    """The meanings of keys, by the heading of their file."""
    found: dict[str, dict[str, str]] = yaml.safe_load(MEANINGS.read_text(encoding="utf-8"))
    return found


def entry(title: str, key: str) -> tuple[str, str]:
    """Where MEANINGS has the meaning of a `key` of the file with this `title`: heading, and the key's last parts.

    Raises
    ------
    AbraceError
        If it has none.
    """
    parts = key.split(".")
    for start in range(len(parts)):
        ending = ".".join(parts[start:])
        if ending in meanings().get(title, {}):
            return title, ending
    raise AbraceError(f"{MEANINGS.name}: {title}: {key}: no meaning, expected one phrase")


def section(described: Described) -> str:
    """A file's heading, what it is, and the table of its keys."""
    found = [row for place, schema in described.schemas.items() for row in rows(schema, place)]
    cells = alike([_cells(described.title, row) for row in found if not row.meaning]) + options(found)
    head = f"### {described.title}\n\n{pages.paragraph(described.about)}\n"
    return head + pages.table(["key", "what it is", "value, default"], cells)


def _cells(title: str, row: Row) -> tuple[str, str, str]:
    """A key, its meaning, and its value; the names that a star stands for are part of the meaning."""
    if not row.kind.startswith("`*`"):
        return f"`{row.key}`", meaning(title, row.key), _value_words(row)
    names, _, kind = row.kind.partition(" or ")
    return f"`{row.key}`", f"{meaning(title, row.key)}; {names}", _value_words(row._replace(kind=kind))


def alike(cells: list[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    """The rows of a table; keys that a place has in common with one above it, two or more, are named in one row."""
    places: dict[str, dict[str, tuple[str, str]]] = {}
    shown = []
    for key, about, value in cells:
        place, _, name = key.strip("`").rpartition(".")
        places.setdefault(place, {})[name] = about, value
    for key, about, value in cells:
        place, _, name = key.strip("`").rpartition(".")
        before = [each for each in list(places)[: list(places).index(place)] if each]
        common = {
            each: [one for one in places[place] if places[place][one] == places[each].get(one)] for each in before
        }
        first = next((each for each in before if len(common[each]) > 1), "")
        if not first or name not in common[first]:
            shown.append((key, about, value))
        elif name == common[first][0]:
            shown.append((f"`{place}.*`", f"as in `{first}`; `*`: {', '.join(common[first])}", ""))
    return shown


def options(found: list[Row]) -> list[tuple[str, str, str]]:
    """Rows of keys that are the parameters of a node, whose page has their meaning: one for each place."""
    places: dict[str, list[str]] = {}
    for row in found:
        if row.meaning:
            place, _, name = row.key.rpartition(".")
            places.setdefault(place, []).append(name)
    return [
        (f"`{place}.*`", f"as the parameters of {_node(place)}; `*`: {', '.join(names)}", "")
        for place, names in places.items()
    ]


def _node(place: str) -> str:
    """A link to the node that has the options at a place, which is named for it."""
    name = place.rpartition(".")[2]
    return f"[{name}](nodes.md#{name})"


def meaning(title: str, key: str) -> str:
    """What MEANINGS says of a key."""
    heading, ending = entry(title, key)
    return meanings()[heading][ending]


def _value_words(row: Row) -> str:
    """Type, range and default of a key; the type is left out where the choices or the keys below tell it."""
    kind = "" if (row.kind == "text" and "`" in row.allowed) or row.kind == "keys and values" else row.kind
    range_ = f"{kind}, {row.allowed}" if kind and row.allowed else kind or row.allowed
    return "; ".join(filter(None, (range_, row.default)))


def page() -> str:
    """The whole page."""
    parts = [INTRODUCTION, "## Files that people write\n", *map(section, WRITTEN_BY_PEOPLE)]
    return "\n".join([*parts, "## Files that abrace writes\n", CONTROLLER_FILE, section(MODEL_FILE)])


if __name__ == "__main__":
    pages.write(__file__, page)

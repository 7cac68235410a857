# SPDX-License-Identifier: Apache-2.0
"""Write docs/files.md from the schemas that check every file: `python docs/write_files.py`."""

from __future__ import annotations

import textwrap
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from abrace.benchmark.definition import Definition, RigDefinition
from abrace.campaign import done, file
from abrace.report import results
from abrace_core.config_file import Checked
from abrace_core.controller_file import _File as ControllerFile
from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_lqg.weights import Weights
from abrace_plant.devices.calibration import CalibrationFile
from abrace_plant.devices.layout import Layout
from abrace_plant.devices.modbus import ModbusFile
from abrace_plant.devices.registers import RegisterMap
from abrace_plant.devices.udp import UdpFile
from abrace_plant.frames.file import _File as FrameFile
from abrace_plant.rig.file import _Rig

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

PAGE = Path(__file__).parent / "files.md"
MEANINGS = Path(__file__).parent / "key_meanings.yaml"
UNBOUNDED = 1e15
"""Bounds as large as this only keep numbers finite."""

INTRODUCTION = """# Files, key by key

Written by `python docs/write_files.py` from the schemas that check the files, with the meanings of the keys from
`docs/key_meanings.yaml`. A file that people write is YAML. An
unknown key, a value of another type or one out of its range is refused, in one line that names the file, the key, the
value and what was expected.

`a.b` is the key `b` in `a`. `a[].b` is `b` of each entry of the list `a`. In `a.*.b` the star is one of the names in
the line `a.*`, or a name that you choose. A key without a default is required; one with the default "none" may be
left out. Units are those of the SI unless the meaning gives another. More on the keys is on the page that is linked
above each table.
"""


class Described(NamedTuple):
    """A file: its heading, the schemas of its keys by their place in it, and what it is."""

    title: str
    schemas: Mapping[str, type[Checked]]
    about: str


WRITTEN_BY_PEOPLE = (
    Described("Rig file", {"": _Rig}, "Building, braces, table, sensors: [the rig and its file](rig.md)."),
    Described(
        "Campaign file",
        {"": file._Campaign, "steps[].": file._Step},
        "The steps of a test day: [campaigns](campaigns.md). `matrix` with `steps` may take the place of a step: these "
        "are made for every combination of its values.",
    ),
    Described("Weights file", {"": Weights}, "What an LQG design weighs and measures: [controllers](lqg.md#design)."),
    Described(
        "Frame file", {"": FrameFile}, "A building of plane frames: [benchmarks](benchmarks.md#frames-of-your-own)."
    ),
    Described(
        "Benchmark file of a frame",
        {"": Definition},
        "Devices, sensors, earthquakes on a frame file's building: [benchmarks](benchmarks.md#benchmarks-of-your-own).",
    ),
    Described(
        "Benchmark file of a rig",
        {"": RigDefinition},
        "Earthquakes and reference controllers on a rig: [benchmarks](benchmarks.md#benchmarks-of-your-own).",
    ),
    Described(
        "Device file, kind udp", {"": UdpFile}, "A target that sends and takes UDP packets: [real hardware](bridge.md)."
    ),
    Described("Device file, kind modbus", {"": ModbusFile}, "A Modbus-TCP device: [real hardware](bridge.md)."),
    Described("Layout file", {"": Layout}, "The packets of a `udp` device: [real hardware](bridge.md#packets)."),
    Described(
        "Register map", {"": RegisterMap}, "The registers of a `modbus` device: [real hardware](bridge.md#labjacks-t7)."
    ),
    Described(
        "Calibration file",
        {"": CalibrationFile},
        "Gain, offset, range and delay of each channel: [calibration](bridge.md#calibration). The star is a "
        "signal's name: x1, xf, a1, fa, w; for commands U and w.",
    ),
)
WRITTEN_BY_ABRACE = (
    Described(
        "Controller file",
        {"": ControllerFile},
        "What `design` writes and the node `controller` takes, a ROS parameter file: [controllers](lqg.md).",
    ),
    Described(
        "steps.json",
        {"": done._File},
        "In a campaign's results: which steps are complete, with checksums of their inputs and outputs.",
    ),
    *(
        Described(f"Results: {title}", {"": schema}, "What the report reads of a step's results ([report](report.md)).")
        for title, schema in vars(results).items()
        if isinstance(schema, type) and issubclass(schema, Checked) and schema.__module__ == results.__name__
    ),
)


class Row(NamedTuple):
    """A key: its place, type, default and range, in words."""

    key: str
    kind: str
    default: str
    allowed: str


def rows(schema: type[Checked], place: str = "") -> Iterator[Row]:
    """Every key of a `schema` whose keys stand at a `place` of its file."""
    content = schema.model_json_schema(by_alias=True)
    yield from _object(content, content.get("$defs", {}), place)


def _object(content: Mapping[str, Any], known: Mapping[str, Any], place: str) -> Iterator[Row]:
    required = content.get("required", [])
    groups: dict[str, list[str]] = {}
    for name, inner in content.get("properties", {}).items():
        has_keys = any("properties" in each for each in _alternatives(inner, known))
        groups.setdefault(str(inner) if has_keys else name, []).append(name)
    for names in groups.values():
        inner = content["properties"][names[0]]
        alike = len(names) > 2
        if alike:
            yield Row(f"{place}*", f"`*`: {', '.join(names)}", "", "")
        for name in ["*"] if alike else names:
            default = "" if set(names) & set(required) else _default(inner)
            yield from _value(f"{place}{name}", content["properties"].get(name, inner), known, default)


def _value(key: str, content: Mapping[str, Any], known: Mapping[str, Any], default: str) -> Iterator[Row]:
    """The rows of a key: itself, or the keys inside it."""
    found: dict[str, list[Row]] = {}
    for each in _alternatives(content, known):
        for row in _one(key, each, known, default):
            found.setdefault(row.key, []).append(row)
    if key not in found and default:
        yield Row(key, "keys and values", default, "")
    for place, alike in found.items():
        columns = zip(*(row[1:] for row in alike), strict=True)
        kinds, defaults, ranges = (" or ".join(dict.fromkeys(filter(None, texts))) for texts in columns)
        free = any(row.kind == "text" and not row.allowed for row in alike)
        yield Row(place, kinds, defaults, f"{ranges}, or any other" if ranges and free else ranges)


def _one(key: str, content: Mapping[str, Any], known: Mapping[str, Any], default: str) -> Iterator[Row]:
    if "properties" in content:
        yield from _object(content, known, f"{key}.")
    elif content.get("type") == "object" and isinstance(content.get("additionalProperties"), dict):
        yield from _value(f"{key}.*", content["additionalProperties"], known, "")
    elif any("properties" in each for each in _alternatives(content.get("items", {}), known)):
        yield from _value(f"{key}[]", content["items"], known, "")
    else:
        yield Row(key, _kind(content, known), default, _allowed(content, known))


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
    """The meanings of keys, by the heading of their file; those of `Results` are for all results."""
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
    for heading in (title, title.partition(": ")[0]):
        for start in range(len(parts)):
            ending = ".".join(parts[start:])
            if ending in meanings().get(heading, {}):
                return heading, ending
    raise AbraceError(f"{MEANINGS.name}: {title}: {key}: no meaning, expected one phrase")


def section(described: Described) -> str:
    """A file's heading, what it is, and the table of its keys."""
    found = [row for place, schema in described.schemas.items() for row in rows(schema, place)]
    lines = ["| key | what it is | type | default | allowed |", "|---|---|---|---|---|"]
    for row in found:
        heading, ending = entry(described.title, row.key)
        meaning = meanings()[heading][ending]
        lines.append(f"| `{row.key}` | {meaning} | {row.kind} | {row.default} | {row.allowed} |")
    about = "\n".join(textwrap.wrap(described.about, 120))
    return f"### {described.title}\n\n{about}\n\n" + "\n".join(lines) + "\n"


def page() -> str:
    """The whole page."""
    parts = [INTRODUCTION, "## Files that people write\n", *map(section, WRITTEN_BY_PEOPLE)]
    return "\n".join([*parts, "## Files that abrace writes\n", *map(section, WRITTEN_BY_ABRACE)])


if __name__ == "__main__":
    write_text(PAGE, page())

# SPDX-License-Identifier: Apache-2.0
"""Write docs/measured.md from measured.yaml and the results in measured.json: `python docs/write_measured.py`.

`python docs/write_measured.py results/verify.json results/bench.json` first takes what the page shows from new results.
A number is written as `{lqg.table1_error:.3f}`: its keys, with dots (or `[key]`), and its format. Numbers with a name
stand on other pages, too, as `{{ name }}`.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from string import Formatter
from typing import Any

import pages
import yaml

RESULTS = pages.DOCS / "measured.json"
CONTENT = pages.DOCS / "measured.yaml"

INTRODUCTION = """# Measured

What was measured, with the command that does it on your machine. `make verify` measures accuracy, `make bench` speed,
`make soak` endurance; each prints its tables and writes `results`. Numbers are of the simulated paper's rig unless
another one is named; symbols are in the [glossary](glossary.md#symbols).

*Made by `docs/write_measured.py` from `docs/measured.yaml`, and `docs/measured.json`: what it needs of `results`.*
"""


class Results(dict[str, Any]):
    """Results, whose values are attributes as well: so a format finds them."""

    def __getattr__(self, name: str) -> Any:
        return self[name]


def read(path: Path) -> Results:
    """The results in a file of JSON."""
    return json.loads(path.read_text(encoding="utf-8"), object_hook=Results)  # type: ignore[no-any-return]


def shown(text: str, results: Results) -> str:
    """A text with its numbers; % stands apart from a number."""
    return re.sub(r"(\d)%", r"\1 %", Formatter().vformat(text, (), results))


def content() -> dict[str, Any]:
    """The numbers with a name, and the sections."""
    return yaml.safe_load(CONTENT.read_text(encoding="utf-8"))  # type: ignore[no-any-return]


def numbers() -> dict[str, str]:
    """The numbers that stand on several pages, by name."""
    results = read(RESULTS)
    return {name: shown(text, results) for name, text in content()["names"].items()}


def fields(given: Any) -> list[str]:
    """The keys of every number in all texts of what is `given`, with dots; numbers with a name are not among them."""
    if isinstance(given, str):
        return [field for _, field, _, _ in Formatter().parse(given) if field and re.search(r"[.[]", field)]
    inside = given.values() if isinstance(given, dict) else given
    return [field for each in inside for field in fields(each)]


def updated(given: Any, known: dict[str, Any], *results: dict[str, Any]) -> dict[str, Any]:
    """The values that the texts `given` show, each of the first of `results` that has it, else as `known`."""
    found: dict[str, Any] = {}
    for field in fields(given):
        keys = ["".join(key) for key in re.findall(r"\[([^]]*)]|([^.[]+)", field)]
        for source in (*results, known):
            value: Any = source
            for key in keys:
                value = value.get(key) if isinstance(value, dict) else None
            if value is not None:
                break
        else:
            raise SystemExit(f"{field}: neither in the results nor in {RESULTS.name}")
        inside = found
        for key in keys[:-1]:
            inside = inside.setdefault(key, {})
        inside[keys[-1]] = value
    return found


def section(given: dict[str, Any], results: Results) -> str:
    """A heading, what was measured and how, the table, remarks."""
    parts = [f"## {given['title']}\n", f"*`{'`; `'.join(given['made by'].split(', '))}`*\n"]
    if "text" in given:
        parts.append(pages.paragraph(shown(given["text"], results)))
    if "columns" in given:
        rows = [[shown(str(cell), results) for cell in row] for row in given["rows"]]
        parts.append(pages.table(given["columns"], rows))
    if "after" in given:
        parts.append(pages.paragraph(shown(given["after"], results)))
    return "\n".join(parts)


def page() -> str:
    """The whole page."""
    results, given = read(RESULTS), content()
    names = Results(results | {name: shown(text, results) for name, text in given["names"].items()})
    return "\n".join([INTRODUCTION, *(section(each, names) for each in given["sections"])])


if __name__ == "__main__":
    if sys.argv[1:]:
        values = updated(content(), read(RESULTS), *(read(Path(name)) for name in sys.argv[1:]))
        RESULTS.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    pages.write(__file__, page)

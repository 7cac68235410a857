# SPDX-License-Identifier: Apache-2.0
"""Steps for every combination of some values: an entry with `matrix: {law: [a, b], seed: [1, 2]}` and `steps`.

In these steps `<law>` alone is replaced by the value itself, within a longer text by the value's label. The label is
the name if the values are given as `name: value`, otherwise the value with _ for a point. Equal steps are made once.
"""

from __future__ import annotations

import itertools
import re
from typing import TYPE_CHECKING, Any

from abrace.campaign.names import is_step_name

if TYPE_CHECKING:
    from collections.abc import Mapping

PLACE = re.compile(r"<([A-Za-z_]\w*)>")

Values = dict[str, Any]
"""The values of one axis, by label."""


def expanded(steps: Any) -> tuple[list[tuple[int, Any]], list[str]]:
    """The `steps` of a file with every matrix expanded, each with its number in the file, and the mistakes."""
    listed: list[tuple[int, Any]] = []
    wrong: list[str] = []
    for number, entry in enumerate(steps if isinstance(steps, list) else [], 1):
        if not (isinstance(entry, dict) and "matrix" in entry):
            listed.append((number, entry))
            continue
        made, mistakes = _combinations(entry)
        listed += [(number, step) for step in made]
        wrong += [f"step {number}: {mistake}" for mistake in mistakes]
    return listed, wrong


def _combinations(entry: Mapping[str, Any]) -> tuple[list[Any], list[str]]:
    wrong = [f"{key}: unknown key, expected matrix and steps" for key in entry if key not in ("matrix", "steps")]
    steps, given = entry.get("steps"), entry["matrix"]
    if not isinstance(steps, list) or not steps:
        wrong.append(f"steps: {steps!r}, expected the steps that are made with each value of the matrix")
        steps = []
    if not isinstance(given, dict) or not given:
        wrong.append(f"matrix: {given!r}, expected lists of values, such as {{seed: [1, 2]}}")
        return [], wrong
    axes: dict[str, Values] = {}
    for key, values in given.items():
        try:
            axes[key] = _named(values)
        except ValueError as error:
            wrong.append(f"matrix.{key}: {values!r}, expected {error}")
    places = {place for step in steps for place in PLACE.findall(str(step))}
    wrong += [f"<{place}>, expected one of {_shown(given)}" for place in sorted(places - set(given))]
    wrong += [f"matrix.{key}: no step has <{key}>" for key in given if key not in places]
    made: list[Any] = []
    if not wrong:
        for labels in itertools.product(*axes.values()):
            chosen = {key: (label, axes[key][label]) for key, label in zip(axes, labels, strict=True)}
            for step in steps:
                one = _filled(step, chosen)
                if one not in made:
                    made.append(one)
    return made, wrong


def _named(values: Any) -> Values:
    """The values of an axis, by label."""
    if isinstance(values, dict) and values:
        named = {str(key): value for key, value in values.items()}
    elif isinstance(values, list) and values:
        named = {str(value).replace(".", "_"): value for value in values}
    else:
        raise ValueError("a list of values, or of `name: value`")
    if not all(map(is_step_name, named)):
        raise ValueError("names or numbers, or `name: value` for other values")
    return named


def _shown(keys: Mapping[str, Any]) -> str:
    return ", ".join(f"<{key}>" for key in keys)


def _filled(content: Any, chosen: Mapping[str, tuple[str, Any]], is_name: bool = False) -> Any:
    """A step with the `chosen` values, (label, value) by axis, filled in."""
    if isinstance(content, dict):
        return {key: _filled(value, chosen, key == "name") for key, value in content.items()}
    if isinstance(content, list):
        return [_filled(value, chosen) for value in content]
    if not isinstance(content, str):
        return content
    whole = PLACE.fullmatch(content)
    if whole and not is_name:
        return chosen[whole[1]][1]
    return PLACE.sub(lambda place: chosen[place[1]][0], content)

# SPDX-License-Identifier: Apache-2.0
"""Benchmarks by their name or file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_studies.benchmark.definition import Case, RigCase, RigDefinition, is_benchmark, load_definition
from abrace_studies.benchmark.frame_benchmark import FrameBenchmark
from abrace_studies.benchmark.rig_benchmark import RigBenchmark

if TYPE_CHECKING:
    from collections.abc import Iterable

    from abrace_studies.benchmark.laws import AnyBenchmark

RIG_PEAK = 0.980665
"""Peak of a record given for a rig, or for a rig without a benchmark file: 0.1 g [m/s^2]."""


def open_benchmark(name: str, records: Iterable[str] = ()) -> AnyBenchmark:
    """A benchmark, or a rig as one, by the `name` of its file; with `records` instead of its own.

    Raises
    ------
    AbraceError
        If there is none of that name, or its file is wrong.
    """
    records = list(records)
    if is_benchmark(name):
        definition = load_definition(name)
    else:
        case = RigCase(record="el_centro", peak_acceleration=RIG_PEAK)
        plain = re.sub(r"[^A-Za-z0-9]+", "_", Path(name).stem).strip("_") or "rig"
        definition = RigDefinition(name=plain[:64], rig=name, duration=100.0, cases=[case])
    if isinstance(definition, RigDefinition):
        if records:
            cases = [RigCase(record=record, peak_acceleration=RIG_PEAK) for record in records]
            definition = definition.model_copy(update={"cases": cases})
        return RigBenchmark(definition)
    if records:
        own = [Case(record=record, intensity=1.0) for record in records]
        definition = definition.model_copy(update={"cases": own})
    return FrameBenchmark(definition)

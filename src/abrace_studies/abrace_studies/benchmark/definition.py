# SPDX-License-Identifier: Apache-2.0
"""The benchmark file: YAML that names a building, its devices and sensors, and the earthquakes, checked key by key."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated

import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, read_config, read_mapping
from abrace_core.files.installed import find_file
from abrace_core.files.suggestion import did_you_mean

DATA = "BENCHMARK_DATA"
"""Environment variable: the folder that holds `records/`, the ground motions that abrace does not ship."""

SMALLEST = "sac_la_3"
"""A benchmark that there is."""
A_RIG = "ncree_three_storey"
"""A rig that there is."""
_FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
OWN_KEYS = {"cases", "frame", "rig"}
"""Keys of a benchmark file; a rig file has none of them."""


def _file_name(name: str) -> str:
    if not _FILE_NAME.fullmatch(name):
        raise ValueError("up to 64 letters, digits, _ and -, a letter or digit first")
    return name


Name = Annotated[str, pydantic.AfterValidator(_file_name)]
Positive = Annotated[float, pydantic.Field(gt=0)]
Count = Annotated[int, pydantic.Field(ge=0)]


class Devices(Checked):
    """Ideal force devices between the levels."""

    per_storey: Annotated[list[Count], pydantic.Field(min_length=1)]
    capacity: Positive


class Sensors(Checked):
    """Accelerometers, and the converters of sensors and devices."""

    range: Positive
    bits: Annotated[int, pydantic.Field(ge=2, le=32)]


class Case(Checked):
    """One run."""

    record: str
    intensity: Positive
    uncontrolled: dict[str, Positive] | None = None

    @property
    def name(self) -> str:
        """Record and intensity in short."""
        return f"{Path(self.record).stem} x {self.intensity:g}"


class Definition(Checked):
    """A benchmark of a building of plane frames."""

    name: Name
    frame: str
    sample_period: Positive
    duration: Positive
    devices: Devices
    sensors: Sensors
    weights: str
    measured: Annotated[list[str], pydantic.Field(min_length=1)]
    design_states: Annotated[int, pydantic.Field(ge=2)]
    cases: Annotated[list[Case], pydantic.Field(min_length=1)]


class RigCase(Checked):
    """One run of a rig."""

    record: str
    peak_acceleration: Positive

    @property
    def name(self) -> str:
        """Record and peak in short."""
        return f"{Path(self.record).stem} {self.peak_acceleration:.3g} m/s²"


class RigDefinition(Checked):
    """A benchmark of a rig."""

    name: Name
    rig: str
    duration: Positive
    weights: list[str] = []
    cases: Annotated[list[RigCase], pydantic.Field(min_length=1)]


def check_case_names(definition: Definition | RigDefinition) -> None:
    """Refuse a `definition` with two cases of one name: results and reference values are stored by that name.

    Raises
    ------
    AbraceError
        Naming the benchmark and both records.
    """
    records: dict[str, str] = {}
    for case in definition.cases:
        if case.name in records:
            raise AbraceError(
                f"benchmark {definition.name}: records {records[case.name]} and {case.record}: both cases are named "
                f"{case.name}, expected a different file name or intensity for each"
            )
        records[case.name] = case.record


def is_benchmark(name: str) -> bool:
    """Whether a `name` is that of a benchmark file; False: of a rig.

    Raises
    ------
    AbraceError
        If it is neither, or a path of no file.
    """
    if name.endswith(".yaml") or "/" in name:
        keys = read_mapping(find_file(name, "abrace_studies", "benchmarks", ".yaml", "benchmark"), "benchmark")
        return not OWN_KEYS.isdisjoint(keys)
    benchmarks = benchmark_names()
    rigs = _stems(find_file(A_RIG, "abrace_plant", "config", ".yaml", "rig"))
    if name not in (*benchmarks, *rigs):
        raise AbraceError(
            f"benchmark {name!r}: unknown, expected a file ending in .yaml, a benchmark ({', '.join(benchmarks)}) or a "
            f"rig ({', '.join(rigs)}){did_you_mean(name, [*benchmarks, *rigs])}"
        )
    return name in benchmarks


def benchmark_names() -> list[str]:
    """Names of the benchmarks that abrace has."""
    return _stems(find_file(SMALLEST, "abrace_studies", "benchmarks", ".yaml", "benchmark"))


def _stems(file: Path) -> list[str]:
    """Names of the YAML files in the folder of a `file`."""
    return sorted(path.stem for path in file.parent.glob("*.yaml"))


def load_definition(name: str) -> Definition | RigDefinition:
    """Read a benchmark file, by its path or by the name of one of abrace's; it names a `frame` or a `rig`.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    path = find_file(name, "abrace_studies", "benchmarks", ".yaml", "benchmark")
    if "rig" in read_mapping(path, "benchmark"):
        return read_config(path, RigDefinition, "benchmark")
    return read_config(path, Definition, "benchmark")


def record_path(name: str) -> str:
    """Where the record of a case is: a known name unchanged, else a file in the folder of the benchmarks' data.

    Raises
    ------
    AbraceError
        If it is neither there nor a file by itself.
    """
    if not Path(name).suffix or Path(name).is_file():
        return name
    folder = os.environ.get(DATA)
    if not folder:
        raise AbraceError(f"benchmark record {name}: not shipped, expected {DATA} to name the folder of records/{name}")
    path = Path(folder) / "records" / name
    if not path.is_file():
        raise AbraceError(f"benchmark record {path}: no such file, expected it in the folder that {DATA} names")
    return str(path)

# SPDX-License-Identifier: Apache-2.0
"""The benchmark file: YAML that names a building, its devices and sensors, and the earthquakes, checked key by key."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import pydantic

from abrace.campaign.names import Name
from abrace_core.config_file import Checked, read_config, read_mapping
from abrace_core.errors import AbraceError
from abrace_core.installed import find_file
from abrace_core.suggestion import did_you_mean

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

DATA = "BENCHMARK_DATA"
"""Environment variable: the folder that holds `records/`, the ground motions that abrace does not ship."""

SMALLEST = "sac_la_3"
"""A benchmark that there is."""
A_RIG = "ncree_three_storey"
"""A rig that there is."""
OWN_KEYS = {"cases", "frame", "rig"}
"""Of a benchmark file; a rig file has none of them."""

Positive = Annotated[float, pydantic.Field(gt=0)]
Count = Annotated[int, pydantic.Field(ge=0)]


class Devices(Checked):
    """Ideal force devices between the levels.

    Parameters
    ----------
    per_storey
        (storeys,) equal devices with one command each storey, the lowest first.
    capacity
        Of one device [N], at the end of the converter's range.
    """

    per_storey: Annotated[list[Count], pydantic.Field(min_length=1)]
    capacity: Positive


class Sensors(Checked):
    """Accelerometers, and the converters of sensors and devices.

    Parameters
    ----------
    range
        [m/s^2] at the end of the converter's range.
    noise
        Standard deviation [m/s^2].
    bits
        Of the converters, to both sides of zero.
    """

    range: Positive
    noise: Annotated[float, pydantic.Field(ge=0)]
    bits: Annotated[int, pydantic.Field(ge=2, le=32)]


class Case(Checked):
    """One run.

    Parameters
    ----------
    record
        A known record, or a file below `records/` of the folder that BENCHMARK_DATA names.
    intensity
        Factor on it.
    uncontrolled
        What criteria are divided by, as `criteria.peaks` names it; None: what an own run without control gives.
    """

    record: str
    intensity: Positive
    uncontrolled: dict[str, Positive] | None = None

    @property
    def name(self) -> str:
        """Record and intensity in short."""
        return f"{Path(self.record).stem} x {self.intensity:g}"


class Live(Checked):
    """The building in the live graph, for controllers that are nodes, and recorded tests.

    Parameters
    ----------
    rig
        Rig file, by name or path: the frame condensed to its levels, the same devices and sensors.
    low_cut
        Of the table's motion [Hz]: a table is at rest at its end, in the middle; 0: the unchanged record.
    """

    rig: str
    low_cut: Annotated[float, pydantic.Field(ge=0)] = 0.0


class Definition(Checked):
    """A benchmark of a building of plane frames.

    Parameters
    ----------
    name
        Of the benchmark.
    frame
        Frame file, by name or path.
    sample_period, duration
        Of controllers and criteria, and of each run [s].
    devices, sensors
        As built in.
    weights
        Of abrace's own controller: a weights file of `abrace_lqg`, by name or path.
    measured
        What the sample controller measures, such as `a4`.
    design_states
        Of the model that they are designed on.
    cases
        The runs.
    live
        Its rig; None: it has none.
    """

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
    live: Live | None = None


class RigCase(Checked):
    """One run of a rig.

    Parameters
    ----------
    record
        A known record, or a file.
    peak_acceleration
        To which it is scaled [m/s^2].
    """

    record: str
    peak_acceleration: Positive

    @property
    def name(self) -> str:
        """Record and peak in short."""
        return f"{Path(self.record).stem} {self.peak_acceleration:.3g} m/s²"


class RigDefinition(Checked):
    """A benchmark of a rig.

    Parameters
    ----------
    name
        Of the benchmark.
    rig
        Rig file, by name or path.
    duration
        Of each run [s].
    weights
        Of the reference controllers, which are designed on the rig's own model.
    cases
        The runs.
    """

    name: Name
    rig: str
    duration: Positive
    weights: list[str] = []
    cases: Annotated[list[RigCase], pydantic.Field(min_length=1)]


@dataclass(frozen=True)
class RecordedCase:
    """One run under the motion of a recorded test.

    Parameters
    ----------
    name
        Of the test.
    ground
        (samples,) acceleration of its table, sample by sample [m/s^2].
    """

    name: str
    ground: NDArray[np.float64]


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
        keys = read_mapping(find_file(name, "abrace", "benchmarks", ".yaml", "benchmark"), "benchmark")
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
    return _stems(find_file(SMALLEST, "abrace", "benchmarks", ".yaml", "benchmark"))


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
    path = find_file(name, "abrace", "benchmarks", ".yaml", "benchmark")
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

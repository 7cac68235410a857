# SPDX-License-Identifier: Apache-2.0
"""The node `record`: intensity measures and response spectra of a record, as read and as played, and the table's share.

abrace run abrace_plant record --ros-args -p record:=quake.csv -p unit:=g -p output:=results/quake

It also prints whether `ground_motion` would refuse the record.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from abrace_core import AbraceError
from abrace_core.figures.saving import save_figure
from abrace_core.files.writing import write_text
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter
from abrace_node.process import run
from abrace_plant.nodes.record_parameters import RECORD_PARAMETERS, read_as_given, rig_as_given
from abrace_plant.records.figure import Motion, record_figure
from abrace_plant.records.measures import STANDARD_GRAVITY, Intensity, intensity, response_spectrum
from abrace_plant.records.options import Treatment
from abrace_plant.records.record import Record
from abrace_plant.records.table_motion import RECORD_REMEDIES, Demand, table_demands
from abrace_plant.records.treatment import prepare

FOLDER = Path("results/records")

PARAMETERS = [
    Parameter("record", "", "a known name or a file", required=True),
    *RECORD_PARAMETERS,
    Parameter("output", "", f"folder for record.svg and record.json; empty: {FOLDER}/NAME"),
]


class ShowRecord(AbraceNode):
    """Measures and draws one record and ends."""

    def __init__(self) -> None:
        super().__init__("record", PARAMETERS)

    def work(self) -> None:
        """Read, treat, measure, print, draw, write."""
        given = self.parameters
        rig = rig_as_given(given)
        rate = rig.sample_rate
        record = read_as_given(given.record, given)
        for warning in record.warnings:
            self.get_logger().warning(warning)
        treatment = Treatment.of_values(given)
        motion = Record(record.name, 1 / rate, prepare(record, rate, treatment))
        if len(motion.acceleration) < 2:
            raise AbraceError(f"parameter duration: {given.duration}, expected two samples or more")
        recorded, played = ((each, intensity(each), response_spectrum(each)) for each in (record, motion))
        demands = table_demands(motion.acceleration, rate, rig.table.table())
        print(_table(recorded, played))
        if not record.acceleration.any():
            raise AbraceError(f"ground motion {record.name}: zero throughout, expected a motion")
        print(f"read: {record.chosen}\n{_demands(given.rig, demands)}")
        output = Path(given.output) if given.output else FOLDER / record.name
        facts = {
            "record": record.name,
            "treatment": {"sample_rate": rate, **treatment.model_dump()},
            "recorded": _facts(recorded),
            "played": _facts(played),
            "table": {demand.name: asdict(demand) | {"exceeded": demand.exceeded} for demand in demands},
        }
        write_text(output / "record.json", json.dumps(facts, indent=1))
        save_figure(record_figure(recorded, played, demands), output / "record.svg")
        print(f"wrote {output}")


def _table(recorded: Motion, played: Motion) -> str:
    """The measures of both motions, a row each."""
    columns = [_rows(record, measures) for record, measures, _ in (recorded, played)]
    lines = [f"{recorded[0].name:<24}{'as read':>12}{'as played':>12}"]
    lines += [f"{name:<24}{value:12.4f}{columns[1][name]:12.4f}" for name, value in columns[0].items()]
    return "\n".join(lines)


def _demands(rig: str, demands: list[Demand]) -> str:
    """The played motion's demands on the table, the table's limits, and whether the motion would be refused."""
    lines = [f"\n{'table of ' + rig:<32}{'demand':>12}{'at [s]':>10}{'limit':>12}"]
    for demand in demands:
        lines.append(
            f"{demand.name + ' [' + demand.unit + ']':<32}{demand.value:12.4g}{demand.time:10.3f}{demand.limit:12.4g}"
        )
    beyond = [demand for demand in demands if demand.exceeded]
    lines += [f"refused for its {demand.name}: expected {RECORD_REMEDIES[demand.name]}" for demand in beyond]
    return "\n".join(lines if beyond else [*lines, "the table can play it"])


def _rows(record: Record, measures: Intensity) -> dict[str, float]:
    return {
        "PGA [m/s^2]": measures.peak_acceleration,
        "PGA [g]": measures.peak_acceleration / STANDARD_GRAVITY,
        "PGV [m/s]": measures.peak_velocity,
        "PGD [m]": measures.peak_displacement,
        "Arias intensity [m/s]": measures.arias_intensity,
        "CAV [m/s]": measures.cumulative_absolute_velocity,
        "D5-95 [s]": measures.significant_duration,
        "sample period [s]": record.sample_period,
        "duration [s]": len(record.acceleration) * record.sample_period,
    }


def _facts(motion: Motion) -> dict[str, Any]:
    """A motion's measures and spectra for the JSON file, in SI units."""
    record, measures, spectrum = motion
    curves = {**asdict(spectrum), "pseudo_acceleration": spectrum.pseudo_acceleration}
    return {
        "sample_period": record.sample_period,
        "samples": len(record.acceleration),
        "duration": len(record.acceleration) * record.sample_period,
        **asdict(measures),
        "significant_duration": measures.significant_duration,
        "spectra": {name: values.tolist() for name, values in curves.items()},
    }


def main() -> int:
    """Entry point."""
    return run(ShowRecord)

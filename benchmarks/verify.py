# SPDX-License-Identifier: Apache-2.0
"""Accuracy claims, measured: `make verify`; some parts alone by `make verify PARTS="safety bags"`.

Writes results/verify.json as each part ends, prints tables, ends with 1 if a claim is missed or a part has failed.
What an earlier run found of other parts stays. One more ground motion is taken by RECORD=FILE, the flexible
structure's data by MEASURED=FILE.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import time
import traceback
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import lqg_accuracy
from ambient_accuracy import verify_ambient
from bag_accuracy import verify_bags, verify_conformance, verify_cuts
from battery import verify_battery
from benchmark_buildings import verify_benchmark20
from bridge_claims import verify_bridge
from buildings import verify_buildings
from claims import Claim, claim_table
from docs_alone import verify_docs
from documented_values import verify_documented
from export_accuracy import verify_export
from faultless_rigs import verify_faultless
from identification_claims import verify_identification
from interlock_margins import verify_interlocks
from interval_coverage import verify_coverage
from killed_nodes import verify_killed_nodes
from measured_structure import verify_measured
from operator_page import verify_operator
from other_files import verify_files
from paper_method import verify_paper_method
from planted_everywhere import verify_bounds, verify_exceptions
from record_accuracy import verify_records
from rig_accuracy import verify_rig
from rig_as_it_is import verify_as_a_rig
from safety import verify_safety, verify_state_table
from sparse_rig import verify_sparse_rig
from target_stops import verify_target
from validity import verify_validity

from abrace_core.files.writing import write_text
from abrace_core.model.one_thread import one_thread

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace.report.table import Table

RESULTS = Path("results/verify.json")


class Part(NamedTuple):
    """A part: where its values go in verify.json, what it is, and what measures it (values, claims, and tables)."""

    place: tuple[str, ...]
    about: str
    measure: Callable[[], tuple[Any, ...]]


def parts(record: Path | None, measured: Path | None, robot_arm: Path | None) -> dict[str, Part]:
    """Every part by name, in the order in which they are measured."""
    buildings = "buildings"
    return {
        "rig": Part(("rig",), "the paper's rig against what the paper prints; limited motion", verify_rig),
        "records": Part(("records",), "resampling of records, spectra against eqsig", verify_records),
        "files": Part(("files",), "records as other people write them: read exactly, or refused", verify_files),
        "identification": Part(
            ("identification",), "poles, intervals, prediction against the simulated rig", verify_identification
        ),
        "battery": Part(
            ("battery",), "320 random structures by the names alone, beside N4SID of the true order", verify_battery
        ),
        "paper_method": Part(
            ("paper_method",), "the paper's own method on the demo's tests, beside ours", verify_paper_method
        ),
        "documented": Part(
            ("documented",), "every documented value of every verb's options, run to a result", verify_documented
        ),
        "measured": Part(
            (buildings, "measured"), "measured data of another structure", partial(verify_measured, measured, robot_arm)
        ),
        "ambient": Part(("ambient",), "modes without any drive, and changes found", verify_ambient),
        "lqg": Part(("lqg",), "the five controllers on the lockstep graph", partial(lqg_accuracy.verify_lqg, record)),
        "export": Part(("export",), "exported controllers against the node", verify_export),
        "buildings": Part((buildings,), "several brace groups, from tests to a controller", verify_buildings),
        "as_a_rig": Part((buildings, "as_a_rig"), "the demo on a rig with friction and all else", verify_as_a_rig),
        "validity": Part((buildings, "validity"), "planted faults named, false alarms", verify_validity),
        "faultless_rigs": Part(("faultless_rigs",), "rigs without a fault that are accused", verify_faultless),
        "coverage": Part((buildings, "coverage"), "true values within intervals, also with friction", verify_coverage),
        "interlocks": Part(("interlocks",), "margins in the paper's tests, and what trips them", verify_interlocks),
        "docs": Part(("docs",), "a building, a record and a law from the docs alone, to a report", verify_docs),
        "benchmark20": Part(
            ("benchmark20",), "the 20-storey benchmark building, and our LQG on it", verify_benchmark20
        ),
        "bags": Part(("bags",), "killed loggers, power losses", verify_bags),
        "conformance": Part(("conformance",), "every form of an MCAP file, through every door", verify_conformance),
        "bag_cuts": Part(("bag_cuts",), "bags cut off or damaged, through every door", verify_cuts),
        "bridge": Part(("bridge",), "malformed packets; the demo through emulator and bridge", verify_bridge),
        "target": Part(("target",), "stops of the target, cut cables, a sticking valve", verify_target),
        "state_table": Part(("state_table",), "every wrong cell of the table of states", verify_state_table),
        "safety": Part(("safety",), "every state with every event; what may go wrong, on running nodes", verify_safety),
        "killed_nodes": Part(
            ("killed_nodes",), "nodes that command nothing, killed while a force acts", verify_killed_nodes
        ),
        "sparse_rig": Part(
            ("sparse_rig",), "six floors, accelerometers on three: lockstep, UDP target, simulation", verify_sparse_rig
        ),
        "exceptions": Part(
            ("exceptions",), "an exception in every callback and task of every live node", verify_exceptions
        ),
        "bounds": Part(("bounds",), "values beyond their bounds on every topic and service", verify_bounds),
        "operator": Part(("operator",), "from a click on STOP in a browser to zero command", verify_operator),
    }


def _within(place: tuple[str, ...]) -> set[str]:
    """Keys at a part's `place` that are the places of other parts."""
    places = (part.place for part in parts(None, None, None).values())
    return {other[len(place)] for other in places if len(other) > len(place) and other[: len(place)] == place}


def store(place: tuple[str, ...], values: Any) -> None:
    """Put the `values` of a part into the results, beside those of others that are there."""
    found = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.is_file() else {}
    inside = found
    for key in place[:-1]:
        inside = inside.setdefault(key, {})
    beside = inside.get(place[-1])
    # what other parts have put into this one's place stays
    kept = {key: value for key, value in beside.items() if key in _within(place)} if isinstance(beside, dict) else {}
    inside[place[-1]] = {**kept, **values} if kept else values
    write_text(RESULTS, json.dumps(found, indent=1) + "\n")


def main() -> int:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(description="Accuracy claims, measured.")
    parser.add_argument("--record", type=Path, help="a ground motion in addition to El Centro and noise, such as Kobe")
    parser.add_argument("--measured", type=Path, help="the flexible structure's .mat file")
    parser.add_argument("--robot-arm", type=Path, help="the robot arm's .mat file")
    known = parts(None, None, None)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(known)}; all without any")
    given = parser.parse_args()
    if unknown := [name for name in given.parts if name not in known]:
        parser.error(f"{', '.join(unknown)}: expected {', '.join(known)}")
    if importlib.util.find_spec("ctrlsys") is None:
        parser.error("N4SID needs ctrlsys, which needs NumPy 2: make verify runs where no ROS 2 is sourced")
    claims: list[Claim] = []
    tables: list[Table] = []
    failed = []
    for name, part in parts(given.record, given.measured, given.robot_arm).items():
        if given.parts and name not in given.parts:
            continue
        print(f"{name}: {part.about}", flush=True)
        begin = time.monotonic()
        try:
            with one_thread():  # as nodes and functions in Python do
                values, of_part, *further = part.measure()
        except Exception:
            traceback.print_exc()
            failed.append(name)
            continue
        store(part.place, values)
        claims += of_part
        tables += further[0] if further else []
        missed = sum(not claim.holds for claim in of_part)
        took = time.monotonic() - begin
        print(f"{name}: {len(of_part) - missed} of {len(of_part)} claims hold, {took:.0f} s", flush=True)
    print("\n\n".join(table.text() for table in (claim_table(claims), *tables)))
    print(f"wrote {RESULTS}")
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 0 if not failed and all(claim.holds for claim in claims) else 1


if __name__ == "__main__":
    sys.exit(main())

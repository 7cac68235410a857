# SPDX-License-Identifier: Apache-2.0
"""The tests of a campaign, read from their bags: what the report shows of each, compared or not."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace_bags import Bag
from abrace_core import AbraceError
from abrace_core.files.reading import read_yaml
from abrace_plant.rig.file import recorded_rig

if TYPE_CHECKING:
    from collections.abc import Iterable

    from abrace.report.units import Units
    from abrace_core.model.run import Run
    from abrace_plant.rig.model import Rig


@dataclass(frozen=True)
class RecordedTest:
    """A test of a campaign: its step, and what its bag has; None: it cannot be read, and why."""

    step: str
    bag: Path
    run: Run | None
    missing: str = ""

    @property
    def facts(self) -> dict[str, Any]:
        """The facts of the bag."""
        return self.run.facts if self.run else {}

    @property
    def lost(self) -> int:
        """Samples between the first and the last that are not in the bag."""
        if self.run is None:
            return 0
        return int(self.run.sequence[-1] - self.run.sequence[0]) + 1 - len(self.run.sequence)

    @property
    def motion(self) -> dict[str, Any]:
        """The table's motion in the campaign file; empty: none."""
        return _given(self.facts, "ground_motion")

    @property
    def excitation(self) -> dict[str, Any]:
        """The braces' excitation, likewise."""
        return _given(self.facts, "excitation")

    def drive(self, units: Units) -> str:
        """What drove the test: a record with its peak in these `units`, noise with its rms and band."""
        parts = []
        if self.motion:
            motion = units.motion(str(self.motion.get("record", "")), self.motion.get("peak_acceleration"))
            parts.append(motion + _noise(self.motion, "m/s²"))
        if self.excitation:
            parts.append(f"commands: {self.excitation.get('signal', 'white_noise')}{_noise(self.excitation, 'N')}")
        return ", ".join(parts) or "none"


def _given(facts: dict[str, Any], key: str) -> dict[str, Any]:
    try:
        found = json.loads(facts.get(key, "{}"))
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _noise(given: dict[str, Any], unit: str) -> str:
    if "rms" not in given or "band" not in given:
        return ""
    low, high = given["band"]
    each = given["rms"] if isinstance(given["rms"], list) else [given["rms"]]
    return f", rms {', '.join(f'{rms:g}' for rms in each)} {unit}, {low:g} to {high:g} Hz"


def recorded_tests(directory: Path, steps: Iterable[str]) -> list[RecordedTest]:
    """The tests among the `steps` of which the results in a campaign's `directory` are."""
    folder = directory / "nodes"
    return [_test(directory, step, path) for step in steps if (path := folder / f"{step}_logger.yaml").exists()]


def last_bag(directory: Path, steps: Iterable[str]) -> Path | None:
    """The bag of the last test among the `steps` of the campaign in a `directory` of results; None: there is none."""
    logged = [path for step in steps if (path := directory / "nodes" / f"{step}_logger.yaml").exists()]
    return _bag(directory, logged[-1]) if logged else None


def _bag(directory: Path, parameters: Path) -> Path:
    """The bag that a logger of these parameters wrote."""
    bag = Path(read_yaml(parameters, "parameter")["/**"]["ros__parameters"]["output"])
    if not bag.is_absolute() and not bag.exists():
        # the report is made in another folder than the campaign: results/NAME and bags have the same parent
        bag = directory.resolve().parent.parent / bag
    return bag


def _test(directory: Path, step: str, parameters: Path) -> RecordedTest:
    bag = _bag(directory, parameters)
    try:
        return RecordedTest(step, bag, Bag(bag).tests()[0])
    except AbraceError as error:
        return RecordedTest(step, bag, None, str(error))


def rigs_of(tests: list[RecordedTest]) -> list[Rig]:
    """The rigs of the `tests`, each once, as their files in the bags have them."""
    facts = {test.facts.get("rig_file"): test.facts for test in tests}
    return [rig for each in facts.values() if (rig := recorded_rig(each)) is not None]

"""Runs a campaign: the live tests of the rig, and the offline steps between them, each node a process of its own.

Bags go to `bags/NAME/TIME/STEP`, never over an earlier one; results go to `results/NAME`, which is made anew.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from dataclasses import dataclass, field
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace.campaign.file import (
    CONTROLLER_FILE,
    Campaign,
    Design,
    Identify,
    Record,
    RigTest,
    Validate,
    load_campaign,
)
from abrace.nodes.graph_monitor import GraphMonitor, expected_matches
from abrace.processes.group import ProcessGroup, find_executable
from abrace.processes.parameter_file import parameter_file
from abrace_core.controller_file import load_controller
from abrace_core.drawing import save_figure
from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_core.linear_model import pole_table, save_model
from abrace_core.node import DIAGNOSTICS, find_file
from abrace_core.progress import Progress
from abrace_plant.nodes.record_parameters import MOTION_PARAMETERS, motion_as_given
from abrace_plant.records.files import record_file
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.published import PAPER_POLES
from abrace_sysid.figures.identification import pole_chart

if TYPE_CHECKING:
    import pydantic
    from numpy.typing import NDArray

    from abrace_core.progress import Step as ShownStep
    from abrace_plant.rig.model import Rig

PATIENCE = 30.0
"""Seconds in which the nodes of a test have to start and find each other."""
STUCK = 30.0
"""Seconds without a new sample that end a test."""
CHECKS = ("model.json", "superposed.json")
"""Identified models with which a controller has to be stable; the rig's own is another."""
SEED = 7
"""Seed of the first test's sensor noise; each later test takes the next one."""
PAPER_RIG = "ncree_three_storey"
LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
"""Campaigns on the simulated rig stay on this machine, unless the environment says otherwise."""


@dataclass
class _Runner:
    """A campaign that is being run."""

    campaign: Campaign
    rig: Rig
    rig_file: Path
    results: Path
    bags: Path
    timing: list[dict[str, Any]] = field(default_factory=list)

    @property
    def environment(self) -> dict[str, str]:
        """Variables that the nodes get in addition to ours."""
        single = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        return {**{key: value for key, value in LOCAL.items() if key not in os.environ}, **single}

    def start(self, group: ProcessGroup, step: str, package: str, executable: str, parameters: dict[str, Any]) -> None:
        """Start a node with these parameters."""
        folder = self.results / "nodes"
        parameters_path = parameter_file(folder / f"{step}_{executable}.yaml", parameters)
        command: list[str | Path] = [
            find_executable(package, executable),
            "--ros-args",
            "--params-file",
            parameters_path,
        ]
        command += ["-r", f"__ns:=/{self.campaign.name}"]
        if executable == "controller":
            command += ["--params-file", self.controller_file(parameters["name"])]
        group.start(executable, command, folder / f"{step}_{executable}.log", self.environment)

    def controller_file(self, controller: str) -> Path:
        """A controller's file: given as one, or where the design step of that name puts it."""
        if controller.endswith(CONTROLLER_FILE):
            return Path(controller)
        return self.results / controller / f"{controller}{CONTROLLER_FILE}"

    def run_test(self, name: str, test: RigTest, seed: int, shown: ShownStep) -> dict[str, Any]:
        """Run the live graph and record it; returns the step's timing."""
        lockstep = self.campaign.lockstep
        inputs: dict[str, str] = {}
        nodes: list[tuple[str, str, dict[str, Any]]] = []
        rate, duration = self.rig.sample_rate, test.duration
        if test.excitation:
            inputs["brace_command"] = "excitation"
            drive = {**_given(test.excitation), "duration": duration, "sample_rate": rate}
            nodes.append(("abrace_sysid", "excitation", {**drive, "force_limit": self.rig.capacity.tolist()}))
        if test.controller:
            inputs["brace_command"] = "controller"
            nodes.append(("abrace_lqg", "controller", {"name": test.controller}))
        if test.ground_motion:
            inputs["ground_motion"] = "ground_motion"
            motion = _given(test.ground_motion)
            drive = {**motion, "rig": str(self.rig_file), "duration": duration, "sample_rate": rate}
            nodes.append(("abrace_plant", "ground_motion", drive))
        if lockstep and not inputs:
            raise AbraceError(f"step {name}: a lockstep test without any input, expected ground motion or commands")
        topics = ["response", *inputs, DIAGNOSTICS]
        bag = self.bags / name
        facts = self.facts(name, test, seed)
        logger = {
            "output": str(bag),
            "topics": topics,
            "lockstep": lockstep,
            "facts": [f"{key}={value}" for key, value in facts.items()],
            "attachments": [str(path) for path in self.attachments(test)],
        }
        plant = {
            "rig": str(self.rig_file),
            "seed": seed,
            "duration": duration,
            "lockstep": lockstep,
            "wait_for": list(inputs) or ["brace_command"],
            "autostart": False,
        }
        samples = round(duration * rate)
        with ProcessGroup() as group, GraphMonitor(f"/{self.campaign.name}", ("plant",)) as monitor:
            self.start(group, name, "abrace_bags", "logger", logger)
            self.start(group, name, "abrace_plant", "plant", plant)
            for package, executable, parameters in nodes:
                self.start(group, name, package, executable, parameters)
            monitor.configure("plant", PATIENCE, group.raise_if_died)
            monitor.wait_until_matched(expected_matches(inputs), PATIENCE, group.raise_if_died)
            monitor.activate("plant", PATIENCE, group.raise_if_died)
            run_seconds = self.watch(group, monitor, samples, shown)
            group.stop_all([*inputs.values(), "plant", "logger"])
        return {"samples": samples, "run_seconds": run_seconds}

    def watch(self, group: ProcessGroup, monitor: GraphMonitor, samples: int, shown: ShownStep) -> float:
        """Show a test's progress until the plant ends; returns the duration that it reports [s]."""
        begin = last_news = time.monotonic()
        last_sequence = -1
        while (ended := group.poll()) is None:
            monitor.spin_once()
            for node, fault in monitor.faults.items():
                raise AbraceError(f"{node}: {fault}")
            now = time.monotonic()
            sequence = int(monitor.values.get("plant", {}).get("sequence", -1))
            if sequence > last_sequence:
                last_sequence, last_news = sequence, now
                speed = (sequence + 1) / self.rig.sample_rate / max(now - begin, 1e-9)
                shown.update((sequence + 1) / samples, f"{speed:.1f} x real time")
            elif now - last_news > STUCK:
                raise AbraceError(f"no new sample for {STUCK:g} s, the last one was {last_sequence}")
        group.raise_if_died(may_finish=["plant"])
        if ended.name != "plant":
            raise ended.died()
        reported = re.search(r"samples in ([0-9.]+) s", "\n".join(ended.last_lines()))
        seconds = float(reported[1]) if reported else time.monotonic() - begin
        shown.update(1.0, f"{samples / self.rig.sample_rate / seconds:.1f} x real time")
        return seconds

    def run_offline(self, name: str, package: str, executable: str, parameters: dict[str, Any]) -> None:
        """Run an offline node to its end."""
        with ProcessGroup() as group:
            self.start(group, name, package, executable, parameters)
            while group.poll() is None:
                time.sleep(0.05)
            group.raise_if_died(may_finish=[executable])

    def run_step(self, number: int, name: str, task: object, shown: ShownStep) -> dict[str, Any]:
        """Run one step; returns further entries for its timing."""
        output = self.results / name
        limit = self.rig.capacity.tolist()
        match task:
            case RigTest():
                return self.run_test(name, task, SEED + number, shown)
            case Identify(table=table, command=command):
                lag = self.rig.braces[0].actuator.lag
                self.run_offline(
                    name,
                    "abrace_sysid",
                    "identify",
                    {
                        "table": [str(self.bags / name) for name in table],
                        "command": [str(self.bags / name) for name in command],
                        "output": str(output),
                        "servo_lag": lag,
                    },
                )
                self.show_poles(name)
            case Design(model=model, weights=weights):
                self.run_offline(
                    name,
                    "abrace_lqg",
                    "design",
                    {
                        "model": str(self.design_model(task)),
                        "check_models": [*(str(self.results / model / name) for name in CHECKS), str(self.rig_model())],
                        "weights": weights,
                        "sample_period": 1 / self.rig.sample_rate,
                        "force_limit": limit,
                        "output": str(self.controller_file(name)),
                    },
                )
            case Validate(test=test, uncontrolled=uncontrolled, model=model, controller=controller):
                models = self.results / model
                parameters = {
                    "bag": str(self.bags / test),
                    "model": str(models / "model.json"),
                    "other_models": [str(models / f"{other}.json") for other in ("superposed", "reduced")],
                    "output": str(output),
                }
                if uncontrolled is not None:
                    parameters["uncontrolled"] = str(self.bags / uncontrolled)
                if controller is not None:
                    parameters["controller"] = str(self.controller_file(controller))
                self.run_offline(name, "abrace_sysid", "validate", parameters)
        return {}

    def rig_model(self) -> Path:
        """The rig's own model, which a simulated rig has, as a file."""
        path = self.results / "rig.json"
        save_model(self.rig.model, path)
        return path

    def show_poles(self, step: str) -> None:
        """Compare the identified poles with the rig's own and the paper's: poles.json and a chart."""
        found = json.loads((self.results / step / "poles.json").read_text(encoding="utf-8"))
        identified = {
            test: [{key: pair[key] for key in ("frequency", "damping_ratio")} for pair in found[test]]
            for test in ("table", "command")
        }
        own = self.rig.model.poles()
        pairs = [{"frequency": w, "damping_ratio": damping} for w, damping in pole_table(own)]
        poles = {test: {"identified": found, "true": pairs[: len(found)]} for test, found in identified.items()}
        write_text(self.results / "poles.json", json.dumps(poles, indent=1))
        reference = {"rig": own[np.abs(own) < 1.2 * max(pair["frequency"] for pair in identified["command"])]}
        if self.rig.name == PAPER_RIG:
            reference["paper, A1 and A2"] = np.concatenate([PAPER_POLES["table"], PAPER_POLES["command"]])
        chart = pole_chart({f"{test} test": _complex(found) for test, found in identified.items()}, reference)
        save_figure(chart, self.results / step / "poles.png")

    def facts(self, name: str, test: RigTest, seed: int) -> dict[str, str]:
        """What a test's bag says of its run."""
        facts = {
            "campaign": self.campaign.name,
            "step": name,
            "abrace": version("abrace"),
            "rig": self.rig.name,
            "rig_file": self.rig_file.read_text(encoding="utf-8"),
            "sample_period": repr(1 / self.rig.sample_rate),
            "lockstep": str(self.campaign.lockstep).lower(),
            "sensor_seed": str(seed),
            "controller": Path(test.controller).stem if test.controller else "",
        }
        if test.controller:
            path = self.controller_file(test.controller)
            load_controller(path)
            facts["controller_file"] = path.read_text(encoding="utf-8")
        for key in ("ground_motion", "excitation"):
            given = getattr(test, key)
            if given is not None:
                facts[key] = json.dumps(given.model_dump())
        if test.ground_motion is not None:
            facts["record"] = test.ground_motion.record
        if isinstance(test.ground_motion, Record):
            facts["peak_acceleration"] = repr(test.ground_motion.peak_acceleration)
        return facts

    def attachments(self, test: RigTest) -> list[Path]:
        """The files that a test is made of, which go into its bag: rig, controller, its model, record."""
        paths = [self.rig_file]
        if test.controller:
            paths.append(self.controller_file(test.controller))
            for step in self.campaign.steps:
                if step.name == test.controller and isinstance(step.task, Design):
                    paths.append(self.design_model(step.task))
        if isinstance(test.ground_motion, Record):
            record = record_file(test.ground_motion.record)
            paths += [record] if record.is_file() else []
        return paths

    def design_model(self, design: Design) -> Path:
        """The file of the model that a controller is designed on."""
        return self.results / design.model / "reduced.json"

    def write_timing(self) -> None:
        """Write the campaign's timing.json."""
        timing = {"lockstep": self.campaign.lockstep, "sample_rate": self.rig.sample_rate, "steps": self.timing}
        write_text(self.results / "timing.json", json.dumps(timing, indent=1))


def _complex(pairs: list[dict[str, float]]) -> NDArray[np.complex128]:
    frequency, damping = (np.array([pair[key] for pair in pairs]) for key in ("frequency", "damping_ratio"))
    return frequency * (-damping + 1j * np.sqrt(1 - damping**2))


def _given(drive: pydantic.BaseModel) -> dict[str, Any]:
    """A signal or record of the campaign file as parameters of its node, whose names are the same."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in drive.model_dump().items()}


def _check_motions(campaign: Campaign, rig: Rig) -> None:
    """Refuse a campaign with a ground motion that the table cannot play, before its first test."""
    checked: list[tuple[object, float]] = []
    for step in campaign.steps:
        test = step.task
        if not isinstance(test, RigTest) or test.ground_motion is None:
            continue
        if (test.ground_motion, test.duration) in checked:
            continue
        given = {row.name: row.default for row in MOTION_PARAMETERS} | _given(test.ground_motion)
        values = SimpleNamespace(**given | {"sample_rate": rig.sample_rate})
        try:
            motion_as_given(values, rig.table, values.record, values.peak_acceleration, test.duration)
        except AbraceError as error:
            raise AbraceError(f"step {step.name}: {error}") from error
        checked.append((test.ground_motion, test.duration))


def run_campaign(path: Path) -> Path:
    """Run every step of a campaign file; returns the folder of its results.

    Raises
    ------
    AbraceError
        If the file is wrong, a ground motion is more than the table has, a node dies or refuses, or a step fails.
    """
    campaign = load_campaign(path)
    rig_file = find_file(campaign.rig, "abrace_plant", "config", ".yaml", "rig").resolve()
    rig = load_rig(rig_file)
    _check_motions(campaign, rig)
    results = Path("results") / campaign.name
    bags = Path("bags") / campaign.name / datetime.now().strftime("%Y%m%d-%H%M%S")
    shutil.rmtree(results, ignore_errors=True)
    results.mkdir(parents=True)
    runner = _Runner(campaign, rig, rig_file, results, bags)
    progress = Progress(len(campaign.steps))
    for number, step in enumerate(campaign.steps):
        with progress.step(step.name) as shown:
            begin = time.monotonic()
            more = runner.run_step(number, step.name, step.task, shown)
            runner.timing.append({"name": step.name, "wall_seconds": time.monotonic() - begin, **more})
            runner.write_timing()
    return results

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
from typing import TYPE_CHECKING, Any

from abrace.campaign.file import (
    CONTROLLER_FILE,
    Ambient,
    Campaign,
    Design,
    Identify,
    Record,
    RigTest,
    Validate,
    load_campaign,
)
from abrace.campaign.motions import as_given, check_braces, check_motions
from abrace.campaign.offline import check_offline_steps
from abrace.campaign.poles import compare_poles
from abrace.nodes.graph_monitor import GraphMonitor, expected_matches
from abrace.processes.group import ProcessGroup, find_executable
from abrace.processes.parameter_file import parameter_file
from abrace_bags import read_topics
from abrace_core.controller_file import load_controller
from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_core.linear_model import save_model
from abrace_core.node import DIAGNOSTICS, find_file
from abrace_core.node.transport import lockstep_environment
from abrace_core.progress import Progress
from abrace_plant.devices.file import calibration_of, load_device
from abrace_plant.records.files import record_file
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from collections.abc import Sequence

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
    device_file: Path | None = None
    timing: list[dict[str, Any]] = field(default_factory=list)

    @property
    def environment(self) -> dict[str, str]:
        """Variables that the nodes get in addition to ours."""
        single = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        own = {key: value for key, value in LOCAL.items() if key not in os.environ}
        if self.campaign.lockstep:
            own |= lockstep_environment()
        return {**own, **single}

    def start(
        self, group: ProcessGroup, step: str, package: str, executable: str, parameters: dict[str, Any], name: str = ""
    ) -> None:
        """Start a node with these parameters; `name` where it is to be called otherwise."""
        folder, name = self.results / "nodes", name or executable
        parameters_path = parameter_file(folder / f"{step}_{name}.yaml", parameters)
        command: list[str | Path] = [
            find_executable(package, executable),
            "--ros-args",
            "--params-file",
            parameters_path,
        ]
        command += ["-r", f"__ns:=/{self.campaign.name}", *(["-r", f"__node:={name}"] if name != executable else [])]
        if executable == "controller":
            command += ["--params-file", self.controller_file(parameters["name"])]
        group.start(name, command, folder / f"{step}_{name}.log", self.environment)

    def start_rig(self, group: ProcessGroup, step: str, seed: int, parameters: dict[str, Any]) -> None:
        """Start the rig, whose node is called `plant` whatever it is, and the emulator behind it."""
        if self.device_file is None:
            self.start(group, step, "abrace_plant", "plant", {"seed": seed, **parameters})
            return
        if self.campaign.emulator:
            folder = self.results / "nodes"
            program = find_executable("abrace_plant", "emulator")
            command: list[str | Path] = [program, "--rig", self.rig_file, "--device", self.device_file]
            command += ["--seed", str(seed), "--priority", str(self.campaign.thread_priority)]
            command += ["--log", folder / f"{step}_emulator.json"]
            emulator = group.start("emulator", command, folder / f"{step}_emulator.log", self.environment)
            while "emulator: ticking" not in emulator.last_lines():
                time.sleep(0.05)
                group.raise_if_died()
        self.start(
            group, step, "abrace_plant", "sensor_bridge", {"device": str(self.device_file), **parameters}, "plant"
        )

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
            drive = {**as_given(test.excitation), "duration": duration, "sample_rate": rate}
            nodes.append(("abrace_sysid", "excitation", {**drive, "force_limit": self.rig.capacity.tolist()}))
        if test.controller:
            inputs["brace_command"] = "controller"
            nodes.append(("abrace_lqg", "controller", {"name": test.controller}))
        if test.ground_motion:
            inputs["ground_motion"] = "ground_motion"
            motion = as_given(test.ground_motion)
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
        rig: dict[str, Any] = {"rig": str(self.rig_file), "duration": duration, "autostart": False}
        if test.disconnected_braces:
            rig["disconnected_braces"] = list(test.disconnected_braces)
        if lockstep:
            rig |= {"lockstep": True, "wait_for": list(inputs)}
        samples = round(duration * rate)
        with ProcessGroup() as group, GraphMonitor(f"/{self.campaign.name}", ("plant",)) as monitor:
            self.start(group, name, "abrace_bags", "logger", logger)
            self.start_rig(group, name, seed, rig | self.loop_parameters(0))
            for number, (package, executable, parameters) in enumerate(nodes, 1):
                self.start(group, name, package, executable, parameters | self.loop_parameters(number))
            monitor.configure("plant", PATIENCE, group.raise_if_died)
            monitor.wait_until_matched(expected_matches(inputs), PATIENCE, group.raise_if_died)
            monitor.activate("plant", PATIENCE, group.raise_if_died)
            run_seconds, done = self.watch(group, monitor, samples, shown)
            group.stop_all([*inputs.values(), "plant", "logger"])
        counts = {"samples": samples, "run_seconds": run_seconds}
        return counts if lockstep else {**counts, **self.losses(bag, done)}

    def loop_parameters(self, number: int) -> dict[str, Any]:
        """What the loop of a test's node asks the kernel for; number 0 is the rig.

        In lockstep each keeps to one processor, in turn from one on that is not that of every campaign.
        """
        given: dict[str, Any] = {}
        if self.campaign.thread_priority:
            given["thread_priority"] = self.campaign.thread_priority
        if self.campaign.lockstep:
            processors = sorted(os.sched_getaffinity(0))
            given["cpu_affinity"] = [processors[(os.getpid() + number) % len(processors)]]
        return given

    def losses(self, bag: Path, done: str) -> dict[str, int]:
        """Samples of a run by the clock that are not in the bag, and answers that did not act from the next sample on.

        `done` is what the rig has printed at the end.
        """
        found = re.search(r"done: ([0-9]+) samples, ([0-9]+) late answers", done)
        if found is None:
            raise AbraceError(f"the rig ended with {done!r}, expected its counts")
        topic = f"/{self.campaign.name}/response"
        recorded = read_topics(bag, [topic])[topic].log_time.size
        return {"lost_samples": int(found[1]) - int(recorded), "missed_deadlines": int(found[2])}

    def watch(self, group: ProcessGroup, monitor: GraphMonitor, samples: int, shown: ShownStep) -> tuple[float, str]:
        """Show a test's progress until the plant ends; returns its duration [s] and its last lines."""
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
        done = "\n".join(ended.last_lines())
        reported = re.search(r"samples in ([0-9.]+) s", done)
        seconds = float(reported[1]) if reported else time.monotonic() - begin
        shown.update(1.0, f"{samples / self.rig.sample_rate / seconds:.1f} x real time")
        return seconds, done

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
                kinds = {"table": self.tests(table), "command": self.tests(command)}
                bands = {f"{key}_band": task.band_of(key, tests) for key, tests in kinds.items()}
                self.run_offline(
                    name,
                    "abrace_sysid",
                    "identify",
                    {
                        "table": [str(self.bags / name) for name in table],
                        "command": [str(self.bags / name) for name in command],
                        "output": str(output),
                        **{key: list(band) for key, band in bands.items() if band},
                        **task.options,
                    },
                )
                compare_poles(self.results, name, self.rig_of(table[0]), self.campaign.simulated)
            case Design(model=model, weights=weights):
                self.run_offline(
                    name,
                    "abrace_lqg",
                    "design",
                    {
                        "model": str(self.design_model(task)),
                        "check_models": [
                            *(str(self.results / model / name) for name in CHECKS),
                            *([str(self.rig_model(model))] if self.campaign.simulated else []),
                        ],
                        "weights": weights,
                        "sample_period": 1 / self.rig.sample_rate,
                        "force_limit": limit,
                        **task.refusal,
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
            case Ambient(test=tests, before=before, band=band):
                given: dict[str, Any] = {"bag": [str(self.bags / test) for test in tests], "band": list(band)}
                if before is not None:
                    given["before"] = [str(self.bags / test) for test in before]
                self.run_offline(name, "abrace_sysid", "ambient", {**given, "output": str(output)})
        return {}

    def tests(self, names: Sequence[str]) -> list[RigTest]:
        """The tests of these names."""
        steps = {step.name: step.task for step in self.campaign.steps}
        return [test for test in map(steps.get, names) if isinstance(test, RigTest)]

    def rig_of(self, test: str) -> Rig:
        """The rig as it was in a test."""
        (task,) = self.tests([test])
        return self.rig.disconnect(task.disconnected_braces)

    def rig_model(self, model: str) -> Path:
        """The model that a simulated rig itself had in the tests of an identify step, as a file."""
        (task,) = (step.task for step in self.campaign.steps if step.name == model)
        assert isinstance(task, Identify)
        path = self.results / f"rig_{model}.json"
        save_model(self.rig_of(task.table[0]).model, path)
        return path

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
            "controller": Path(test.controller).stem if test.controller else "",
        }
        if self.campaign.simulated:
            facts["sensor_seed"] = str(seed)
        if test.disconnected_braces:
            facts["disconnected_braces"] = json.dumps(test.disconnected_braces)
        if self.device_file is not None:
            facts["device"] = str(self.device_file)
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
        """The files that a test is made of, which go into its bag: rig, device, controller, its model, record."""
        paths = [self.rig_file]
        if self.device_file is not None:
            paths += [path for path in (self.device_file, calibration_of(self.device_file)) if path is not None]
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
    device_file = None
    if campaign.device is not None:
        device_file = find_file(campaign.device, "abrace_plant", "config/devices", ".yaml", "device").resolve()
        load_device(device_file, rig)
    check_motions(campaign, rig)
    check_braces(campaign, rig)
    check_offline_steps(campaign, rig)
    results = Path("results") / campaign.name
    bags = Path("bags") / campaign.name / datetime.now().strftime("%Y%m%d-%H%M%S")
    shutil.rmtree(results, ignore_errors=True)
    results.mkdir(parents=True)
    runner = _Runner(campaign, rig, rig_file, results, bags, device_file)
    progress = Progress(len(campaign.steps))
    for number, step in enumerate(campaign.steps):
        with progress.step(step.name) as shown:
            begin = time.monotonic()
            more = runner.run_step(number, step.name, step.task, shown)
            runner.timing.append({"name": step.name, "wall_seconds": time.monotonic() - begin, **more})
            runner.write_timing()
    return results

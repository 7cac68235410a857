# SPDX-License-Identifier: Apache-2.0
"""Runs the steps of a campaign: live tests of the rig and offline steps, each node in a process of its own."""

from __future__ import annotations

import contextlib
import json
import os
import re
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace.campaign.drivers import SIGNALS, START, NodeStart, abrace_node, drivers, rig_node, seconds_of_run
from abrace.campaign.drives import RecordMotion
from abrace.campaign.examination import examine
from abrace.campaign.names import CONTROLLER_FILE, MODEL_FILE, is_path
from abrace.campaign.poles import compare_poles
from abrace.campaign.tasks import (
    Ambient,
    Compare,
    Design,
    Identify,
    OwnController,
    OwnNode,
    RigTest,
    Validate,
    given_options,
)
from abrace.nodes.graph_monitor import GraphMonitor, expected_matches, repeat_as_stop_button
from abrace.processes.group import NodeDied, NodeProcess, ProcessGroup, find_executable
from abrace.processes.parameter_file import parameter_file
from abrace.report.node_table import count_of
from abrace_core import RunFailed, __version__
from abrace_core.model.controller_file import load_controller
from abrace_core.model.linear_model import save_model
from abrace_lqg.proof.limits import DesignOptions
from abrace_node.node import DIAGNOSTICS
from abrace_node.transport import lockstep_environment
from abrace_plant.devices.file import calibration_of
from abrace_plant.records.files import record_file, record_name
from abrace_sysid.ambient.modes import AmbientOptions
from abrace_sysid.fitting.options import IdentificationOptions

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from abrace.campaign.display import DisplayedStep
    from abrace.campaign.done import DoneSteps
    from abrace.campaign.file import Campaign
    from abrace.campaign.laboratory import Laboratories, Laboratory
    from abrace.campaign.tasks import Task
    from abrace_core.files.progress import Step as ShownStep
    from abrace_plant.rig.model import Rig

PATIENCE = 30.0
"""Seconds within which the nodes of a test have to start and discover each other."""
CONFIGURE_PATIENCE = 180.0
"""Seconds within which the rig has to configure. Its first time on a machine compiles: 6 s of processor time."""
SILENCE = 3.0
"""Seconds after which a user's node without diagnostics is assumed not to publish any."""
STUCK = 30.0
"""Seconds without a new sample that end a test."""
SEED = 7
"""Seed of the first test's sensor noise; each later test takes the next one."""
LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
"""Restricts the discovery of campaigns to this machine, unless the environment variable is set."""


@contextlib.contextmanager
def unless_over(node: str) -> Iterator[None]:
    """Accept that a `node` ends with exit code 0 before it answers a request, as in a short test."""
    try:
        yield
    except NodeDied as died:
        if died.name != node or died.returncode:
            raise


@contextlib.contextmanager
def explained_by(node: NodeProcess) -> Iterator[None]:
    """Add the last line of a `node` to the error of a request that it refuses or does not answer."""
    try:
        yield
    except NodeDied:
        raise
    except RunFailed as error:
        said = "".join(node.last_lines(1)) or "nothing"
        raise RunFailed(f"{error}; the last line of {node.log_file}: {said}") from error


@dataclass
class Runner:
    """Runs the steps of a campaign; `lock`: an open file that every node inherits."""

    campaign: Campaign
    laboratories: Laboratories
    results: Path
    bags: Path
    lock: int
    seen: Callable[[GraphMonitor, Laboratory], None] = lambda _monitor, _lab: None
    """Called repeatedly while a test runs, to show the reports of its nodes."""
    done: DoneSteps = field(init=False)
    """Set before the first step is run."""

    def environment(self, lockstep: bool) -> dict[str, str]:
        """Environment variables that a test's nodes get in addition to this process's; `lockstep` or real time."""
        single = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        own = {key: value for key, value in LOCAL.items() if key not in os.environ}
        if lockstep:
            own |= lockstep_environment()
        return {**own, **single}

    def start(
        self, group: ProcessGroup, step: str, node: NodeStart, lockstep: bool = False, offline: bool = False
    ) -> NodeProcess:
        """Start a `node` of a `step` in a `group`; whether the test runs in `lockstep`, or the node is `offline`."""
        folder = self.results / "nodes"
        command: list[str | Path] = [*node.program, "--ros-args"]
        for file in (*node.files, parameter_file(folder / f"{step}_{node.name}.yaml", node.parameters)):
            command += ["--params-file", file]
        command += ["-r", f"__ns:=/{self.campaign.name}", "-r", f"__node:={node.name}"]
        log = folder / f"{step}_{node.name}.log"
        return group.start(node.name, command, log, self.environment(lockstep), offline)

    def start_emulator(self, group: ProcessGroup, step: str, lab: Laboratory, seed: int) -> None:
        """Start the emulator of a `lab` with a `seed`, and wait until it samples; `group` and `step` as in `start`."""
        assert lab.device_file is not None
        folder = self.results / "nodes"
        program = find_executable("abrace_plant", "emulator")
        command: list[str | Path] = [program, "--rig", lab.rig_file, "--device", lab.device_file]
        command += ["--seed", str(seed), "--priority", str(self.campaign.thread_priority)]
        command += ["--log", folder / f"{step}_emulator.json"]
        emulator = group.start("emulator", command, folder / f"{step}_emulator.log", self.environment(False))
        while "emulator: ticking" not in emulator.last_lines():
            time.sleep(0.05)
            group.raise_if_died()

    def controller_file(self, controller: str) -> Path:
        """The file of a `controller`: its path, or the output of the design step of that name."""
        if controller.endswith(CONTROLLER_FILE):
            return Path(controller)
        return self.results / controller / f"{controller}{CONTROLLER_FILE}"

    def run_test(self, name: str, test: RigTest, number: int, shown: ShownStep | DisplayedStep) -> dict[str, Any]:
        """Run the live graph and record it; as in `run_step`."""
        lockstep, lab = self.campaign.in_lockstep(test), self.laboratories.of(test)
        seed = SEED + number if test.sensor_seed is None else test.sensor_seed
        inputs = drivers(test, lab, self.controller_file)
        bag = self.bags / name
        facts = self.facts(name, test, lab, seed)
        logger = {
            "output": str(bag),
            "topics": ["response", *inputs, DIAGNOSTICS],
            "lockstep": lockstep,
            "facts": [f"{key}={value}" for key, value in facts.items()],
            "attachments": [str(path) for path in self.attachments(test, lab)],
        }
        loops = [rig_node(test, lab, seed, list(inputs) if lockstep else []), *inputs.values()]
        nodes = {topic: one.name for topic, one in inputs.items()}
        signals = [one.name for one in inputs.values() if one.name in SIGNALS]
        samples = round(seconds_of_run(test, lockstep) * lab.rig.sample_rate)
        monitoring = GraphMonitor(f"/{self.campaign.name}", ("plant",), signals)
        with ProcessGroup(held=[self.lock]) as group, monitoring as monitor:
            self.start(group, name, abrace_node("abrace_bags", "logger", logger), lockstep)
            if lab.setup.emulator:
                repeat_as_stop_button(monitor)
                self.start_emulator(group, name, lab, seed)
            rig, *_ = [
                self.start(
                    group,
                    name,
                    replace(one, parameters=one.parameters | self.loop_parameters(place, lockstep)),
                    lockstep,
                )
                for place, one in enumerate(loops)
            ]
            with explained_by(rig):
                monitor.change_state("plant", "configure", CONFIGURE_PATIENCE, group.raise_if_died)
            expected = expected_matches(nodes)
            for own in ["plant"] * (lab.setup.node is not None) + ["controller"] * isinstance(test.controller, OwnNode):
                if not monitor.tells_partners(own, SILENCE, group.raise_if_died):
                    del expected[own]
            monitor.wait_until_matched(expected, PATIENCE, group.raise_if_died)
            with unless_over("plant"):
                with explained_by(rig):
                    monitor.change_state("plant", "activate", PATIENCE, group.raise_if_died)
                monitor.play(PATIENCE if lockstep else START, group.raise_if_died)
            run_seconds, done = self.watch(group, monitor, samples, lab, shown)
            group.stop_together([*nodes.values(), "plant"])
            group.stop_all()
        happened: dict[str, Any] = {"samples": samples, "run_seconds": run_seconds}
        published = samples if lockstep else None  # None: a user's rig does not report it
        if done and not lockstep:
            published, happened["missed_deadlines"] = self.counts(done)
        return happened | examine(bag, f"/{self.campaign.name}/response", published)

    def loop_parameters(self, number: int, lockstep: bool) -> dict[str, Any]:
        """Real-time priority and processor of the loop of a test's node; `number` 0 is the rig.

        In `lockstep` each loop is bound to one processor, the next node to the next one. The first processor depends on
        the process number, so that campaigns at the same time do not all begin with the same one.
        """
        given: dict[str, Any] = {}
        if self.campaign.thread_priority:
            given["thread_priority"] = self.campaign.thread_priority
        if lockstep:
            processors = sorted(os.sched_getaffinity(0))
            given["cpu_affinity"] = [processors[(os.getpid() + number) % len(processors)]]
        return given

    def counts(self, done: str) -> tuple[int, int]:
        """Samples of a run in real time, and late answers, which did not act from the next sample on.

        `done`: the rig's last lines of output.
        """
        found = re.search(r"done: ([0-9]+) samples, ([0-9]+) late answers", done)
        if found is None:
            raise RunFailed(f"the rig ended with {done!r}, expected its counts")
        return int(found[1]), int(found[2])

    def watch(
        self,
        group: ProcessGroup,
        monitor: GraphMonitor,
        samples: int,
        lab: Laboratory,
        shown: ShownStep | DisplayedStep,
    ) -> tuple[float, str]:
        """Show a test's progress until the plant ends; returns its duration [s] and its last lines; as in `run_test`.

        A user's rig is deactivated once all samples are recorded, unless it ends by itself.
        """
        rate, own_rig = lab.rig.sample_rate, lab.setup.node is not None
        begin = last_news = time.monotonic()
        last_sequence = -1
        while (ended := group.poll()) is None:
            monitor.spin_once()
            self.seen(monitor, lab)
            for node, fault in monitor.faults.items():
                raise RunFailed(f"{node}: {fault}")
            now = time.monotonic()
            recorded = count_of(monitor.values.get("logger", {}).get("messages of response", "")) or 0
            sampled = count_of(monitor.values.get("plant", {}).get("sequence", ""))
            sequence = recorded - 1 if own_rig else -1 if sampled is None else sampled
            if own_rig and recorded >= samples:
                with unless_over("plant"):
                    monitor.change_state("plant", "deactivate", PATIENCE, group.raise_if_died)
                shown.update(1.0, f"{samples / rate / (now - begin):.1f} x real time")
                return now - begin, ""
            if sequence > last_sequence:
                last_sequence, last_news = sequence, now
                speed = (sequence + 1) / rate / max(now - begin, 1e-9)
                shown.update((sequence + 1) / samples, f"{speed:.1f} x real time")
            elif now - last_news > STUCK:
                raise RunFailed(f"no new sample for {STUCK:g} s, the last one was {last_sequence}")
        group.raise_if_died(may_finish=["plant"])
        if ended.name != "plant":
            raise ended.died()
        done = "" if own_rig else "\n".join(ended.last_lines())
        reported = re.search(r"samples in ([0-9.]+) s", done)
        seconds = float(reported[1]) if reported else time.monotonic() - begin
        shown.update(1.0, f"{samples / rate / seconds:.1f} x real time")
        return seconds, done

    def run_offline(self, name: str, package: str, executable: str, parameters: dict[str, Any]) -> None:
        """Run an offline node of the step `name` until it ends; as in `abrace_node`."""
        with ProcessGroup(held=[self.lock]) as group:
            self.start(group, name, abrace_node(package, executable, parameters), offline=True)
            while group.poll() is None:
                time.sleep(0.05)
            group.raise_if_died(may_finish=[executable])

    def run_step(self, number: int, name: str, task: object, shown: ShownStep | DisplayedStep) -> dict[str, Any]:
        """Run the step `name`, of this `number`, 0 the first, and `task`; `shown`: the display of its progress.

        Returns further entries for its timing.
        """
        output = self.results / name
        match task:
            case RigTest():
                return self.run_test(name, task, number, shown)
            case Identify(table=table, command=command):
                self.run_offline(
                    name,
                    "abrace_sysid",
                    "identify",
                    {
                        "table": self.bags_of(table),
                        "command": self.bags_of(command),
                        "output": str(output),
                        **given_options(task, IdentificationOptions),
                    },
                )
                compare_poles(self.results, name, *self.rig_behind(task))
            case Design(model=model, weights=weights):
                design_model, *checks = self.models(model, "reduced", "model", "superposed")
                rig, known = self.rig_model(task)
                parameters = {
                    "model": design_model,
                    "weights": weights,
                    "sample_period": 1 / rig.sample_rate,
                    "force_limit": rig.capacity.tolist(),
                    **given_options(task, DesignOptions),
                    "output": str(self.controller_file(name)),
                }
                if check_models := [*checks, *known]:
                    parameters["check_models"] = check_models
                self.run_offline(name, "abrace_lqg", "design", parameters)
            case Compare(test=test, uncontrolled=without):
                bags = {"test": self.bag_of(test), "uncontrolled": self.bag_of(without)}
                self.run_offline(name, "abrace_sysid", "validate", {**bags, "output": str(output)})
            case Validate(test=test, uncontrolled=uncontrolled, model=model):
                first, *others = self.models(model, "model", "superposed", "reduced")
                parameters = {"test": self.bag_of(test), "model": first, "output": str(output)}
                if others:
                    parameters["other_models"] = others
                if uncontrolled is not None:
                    parameters["uncontrolled"] = self.bag_of(uncontrolled)
                if controller := self.loop_of(task):
                    parameters["controller"] = str(self.controller_file(controller))
                self.run_offline(name, "abrace_sysid", "validate", parameters)
            case Ambient(test=quiet, before=before):
                given = {"test": self.bags_of(quiet), **given_options(task, AmbientOptions)}
                if before is not None:
                    given["before"] = self.bags_of(before)
                self.run_offline(name, "abrace_sysid", "ambient", {**given, "output": str(output)})
        return {}

    def bag_of(self, test: str) -> str:
        """The bag of a `test`: a path, the bag of an earlier run that is continued, or that of this run."""
        if is_path(test):
            return test
        done = self.done.steps.get(test)
        return str(self.bags / test) if done is None or done.bag is None else done.bag

    def bags_of(self, tests: Sequence[str]) -> list[str]:
        """The bags of several `tests`."""
        return [self.bag_of(test) for test in tests]

    def models(self, model: str, *names: str) -> list[str]:
        """The files `names` of a `model`: an identify step or its folder; of a model file only that file."""
        if model.endswith(MODEL_FILE):
            return [model]
        folder = Path(model) if is_path(model) else self.results / model
        return [str(folder / f"{name}{MODEL_FILE}") for name in names]

    def rig_behind(self, task: Task) -> tuple[Rig, bool]:
        """The rig of the tests that a `task` uses, with its braces as connected there; whether it is simulated."""
        lab, test = self.laboratories.behind(task)
        return lab.rig.disconnect(test.disconnected_braces if test else ()), test is not None and lab.setup.simulated

    def rig_model(self, design: Design) -> tuple[Rig, list[str]]:
        """The rig of a design's tests, and the file of its own model; only a simulated rig has one."""
        rig, simulated = self.rig_behind(design)
        if not simulated:
            return rig, []
        path = self.results / f"rig_{design.model}.json"
        save_model(rig.model, path)
        return rig, [str(path)]

    def loop_of(self, task: Validate) -> str | None:
        """The controller with which a `task` simulates its test; None: no controller, or a user's node."""
        test = self.campaign.tests.get(task.test)
        controller = task.controller if test is None else test.controller
        return None if isinstance(controller, OwnController) else controller

    def facts(self, name: str, test: RigTest, lab: Laboratory, seed: int) -> dict[str, str]:
        """The facts of a test for its bag: campaign, step, rig, controller, motions and seeds; as in `run_test`."""
        facts = {
            "campaign": self.campaign.name,
            "step": name,
            "abrace": __version__,
            "rig": lab.rig.name,
            "rig_file": lab.rig_file.read_text(encoding="utf-8"),
            "sample_period": repr(1 / lab.rig.sample_rate),
            "capacity": json.dumps(lab.rig.capacity.tolist()),
            "lockstep": str(self.campaign.in_lockstep(test)).lower(),
            "controller": test.controller_name,
        }
        if lab.setup.simulated:
            facts["sensor_seed"] = str(seed)
        for key in ("disconnected_braces", "sensor_faults", "force_limit"):
            if given := getattr(test, key):
                facts[key] = json.dumps(given)
        if lab.device_file is not None:
            facts["device"] = str(lab.device_file)
        for key, own in (("rig_node", lab.setup.node), ("controller_node", test.controller)):
            if isinstance(own, OwnNode):
                facts[key] = json.dumps({"run": own.run, "parameters": own.parameters})
        if isinstance(test.controller, str):
            path = self.controller_file(test.controller)
            load_controller(path)
            facts["controller_file"] = path.read_text(encoding="utf-8")
        for key in ("ground_motion", "excitation"):
            if (drive := getattr(test, key)) is not None:
                facts[key] = json.dumps(drive.parameters)
        if test.ground_motion is not None:
            facts["record"] = record_name(test.ground_motion.record)
        if isinstance(test.ground_motion, RecordMotion):
            facts["peak_acceleration"] = repr(test.ground_motion.peak_acceleration)
        return facts

    def attachments(self, test: RigTest, lab: Laboratory) -> list[Path]:
        """The files of a `test` in a `lab` that its bag contains: rig, device, controller, its model, record."""
        paths = [lab.rig_file]
        if lab.device_file is not None:
            paths += [path for path in (lab.device_file, calibration_of(lab.device_file)) if path is not None]
        if isinstance(test.controller, str):
            paths.append(self.controller_file(test.controller))
            for step in self.campaign.steps:
                if step.name == test.controller and isinstance(step.task, Design):
                    paths.append(Path(self.models(step.task.model, "reduced")[0]))
        elif test.controller is not None and len(test.controller.run) == 1:
            paths.append(Path(test.controller.run[0]))
        if isinstance(test.ground_motion, RecordMotion):
            record = record_file(test.ground_motion.record)
            paths += [record] if record.is_file() else []
        return paths

# SPDX-License-Identifier: Apache-2.0
"""The course of a campaign: the check, each step that is not complete yet, the report, and the swap of the results.

Bags are written to `bags/NAME/TIME/STEP`, never over an earlier one. Results are written to `results/_unfinished/NAME`,
which replaces `results/NAME` when it is complete.
"""

from __future__ import annotations

import contextlib
import math
import os
import platform
import shlex
import sys
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from abrace.campaign.done import DoneSteps, copy_results
from abrace.campaign.folders import Folders
from abrace.campaign.inputs import Inputs
from abrace.campaign.plan import check_campaign
from abrace.campaign.runner import Runner
from abrace.campaign.tasks import RigTest
from abrace.nodes.graph_monitor import GraphMonitor
from abrace.report.events import warnings_of
from abrace.report.results import read_results
from abrace.report.writer import make_report
from abrace_core import AbraceError, RunFailed
from abrace_core.files.checksum import file_checksum
from abrace_core.files.progress import Progress
from abrace_core.files.writing import make_folder, write_json

if TYPE_CHECKING:
    from collections.abc import Iterator

    from abrace.campaign.display import Display, DisplayedStep
    from abrace.campaign.file import Step
    from abrace.campaign.laboratory import Laboratory
    from abrace_core.files.progress import Step as ShownStep

LOOK = 1.5
"""Seconds in which a rig is found that runs in the campaign's namespace: abrace's within 0.2 s, campaigns within 0.6 s.

A rig with Fast DDS's own profile, which repeats every 3 s what a new node has missed, may take 2.5 s; one that is found
later has a publisher too many when the nodes find each other.
"""


PACKAGES = ("abrace", "numpy", "scipy", "numba", "matplotlib", "pydantic", "mcap")
"""Packages whose versions are written."""


class Outcome(NamedTuple):
    """The outcome of a campaign: the folders of its results and bags, its tables, and reasons not to trust tests."""

    results: Path
    bags: list[Path]
    tables: str
    warnings: list[str]


class _Course:
    """Runs a campaign from its first step that is not complete; `start`: as for `run_campaign`; `seconds` of steps."""

    def __init__(self, runner: Runner, folders: Folders, start: str | None, seconds: list[float]) -> None:
        self._runner, self._folders, self._seconds = runner, folders, seconds
        self._campaign = runner.campaign
        self._names = [step.name for step in self._campaign.steps]
        self._start = start
        self._inputs = Inputs(runner.campaign, runner.laboratories)
        make_folder(folders.unfinished)
        self._done = DoneSteps(folders.unfinished, self._names)
        if start is None:
            self._done.keep(self._names)
        else:
            self._begin_from(start)

    def _begin_from(self, start: str) -> None:
        """Take the steps before `start` from the interrupted run, or from the last results."""
        if start not in self._names:
            raise AbraceError(f"--from {start}: no such step, expected {' or '.join(self._names)}")
        earlier = self._names[: self._names.index(start)]
        results, unfinished = self._folders.results, self._folders.unfinished
        last = DoneSteps(results, self._names)
        missing = {folder: self._missing(done, earlier) for folder, done in ((unfinished, self._done), (results, last))}
        if missing[unfinished] and not missing[results]:
            copy_results(results, unfinished)
            self._done = DoneSteps(unfinished, self._names)
        elif missing[unfinished]:
            why = missing[results if last.steps else unfinished]
            raise AbraceError(f"--from {start}: {why}, expected all earlier steps to be complete: begin with that one")
        self._done.keep(earlier)

    def _missing(self, done: DoneSteps, names: list[str]) -> str:
        """The first of the steps with these `names` that is not complete, and the reason; empty: all are complete."""
        for number, name in enumerate(names):
            if changed := done.changed(name, self._inputs_of(number, done)):
                return f"step {name}: {changed}"
        return ""

    def _inputs_of(self, number: int, done: DoneSteps) -> dict[str, str]:
        return self._inputs.of(number, {name: one.made for name, one in done.steps.items()})

    def run(self) -> Outcome:
        """Run every step that is not complete, write the report, and replace the last results."""
        self._runner.done = self._done
        write_origin(self._folders.unfinished, self._campaign.path)
        with self._present(), self._display() as progress:
            self._run_steps(progress)
        try:
            self._write_timing()
            tables = make_report(self._folders.unfinished)
            self._folders.settle_report()
            warnings = warnings_of(read_results(self._folders.unfinished).timing)
            self._folders.swap_in()
        except BaseException:
            self._print_how_to_continue("the report")
            raise
        bags = {Path(self._runner.bag_of(name)).parent: None for name in self._campaign.tests}
        return Outcome(self._folders.results, list(bags), tables, warnings)

    @contextlib.contextmanager
    def _present(self) -> Iterator[None]:
        """Expect no other rig in the campaign's namespace; meanwhile another campaign finds this one there."""
        if not self._campaign.tests:
            yield
            return
        with GraphMonitor(f"/{self._campaign.name}", (), name="campaign") as monitor:
            monitor.expect_no_rig(LOOK)
            yield

    @contextlib.contextmanager
    def _display(self) -> Iterator[Progress | Display]:
        """The display of progress: live on a terminal, plain lines elsewhere."""
        if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
            yield Progress(len(self._names))
            return
        from abrace.campaign.display import Display, Graph, peaks_of

        with Display(self._campaign.name, self._seconds) as display:

            def seen(monitor: GraphMonitor, lab: Laboratory) -> None:
                peaks = peaks_of(monitor.values.get("plant", {}))
                display.see(Graph(dict(monitor.reports), peaks, float(min(lab.rig.capacity, default=math.inf))))

            self._runner.seen = seen
            yield display

    def _run_steps(self, progress: Progress | Display) -> None:
        for number, step in enumerate(self._campaign.steps):
            inputs = self._inputs_of(number, self._done)
            changed = self._done.changed(step.name, inputs)
            if not changed:
                progress.kept(step.name)
                continue
            if step.name in self._done.steps:
                print(f"{step.name}: {changed}, it is run again", file=sys.stderr, flush=True)
                self._done.forget(step.name)
            try:
                with progress.step(step.name) as shown:
                    self._run_step(number, step, inputs, shown)
            except BaseException as error:
                self._leave(step.name, error)
                raise

    def _run_step(self, number: int, step: Step, inputs: dict[str, str], shown: ShownStep | DisplayedStep) -> None:
        self._done.begin()
        begin = time.monotonic()
        more = self._runner.run_step(number, step.name, step.task, shown)
        timing = {"name": step.name, "wall_seconds": time.monotonic() - begin, **more}
        self._folders.settle(step.name)
        bag = Path(self._runner.bag_of(step.name)) if isinstance(step.task, RigTest) else None
        self._done.end(step.name, inputs, bag, timing)
        self._write_timing()

    def _write_timing(self, failed: dict[str, str] | None = None) -> None:
        """Write timing.json: the steps that are done, and the one that `failed` with its cause."""
        timing: dict[str, Any] = {
            "lockstep": self._campaign.lockstep,
            "sample_rate": self._runner.laboratories.of().rig.sample_rate,
            "steps": [self._done.steps[name].timing for name in self._names if name in self._done.steps],
        }
        if failed is not None:
            timing["failed"] = failed
        write_json(self._folders.unfinished / "timing.json", timing)

    def _leave(self, step: str, error: BaseException) -> None:
        """Report the steps done before the one that failed; print where the results are."""
        if isinstance(error, RunFailed):
            with contextlib.suppress(AbraceError):  # the first error is the one that is reported
                self._write_timing({"step": step, "cause": str(error)})
                make_report(self._folders.unfinished)
        self._print_how_to_continue(step)

    def _print_how_to_continue(self, what: str) -> None:
        """Print where the results of an interrupted campaign are, and what it continues with."""
        count = f"{len(self._done.steps)} of {len(self._names)} steps are complete"
        again = "the same command" if self._start is None else f"abrace campaign {self._campaign.path}, without --from,"
        where = f"in {self._folders.unfinished}; {again} continues with {what}"
        print(f"abrace: {count}, {where}", file=sys.stderr, flush=True)


def write_origin(results: Path, campaign_file: Path) -> None:
    """Write origin.json into the folder of `results`, before the campaign of `campaign_file` runs."""
    middleware = os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    origin = {
        "command": f"abrace campaign {shlex.quote(str(campaign_file))}",
        "begun": datetime.now(UTC).isoformat(timespec="seconds"),
        "campaign_file": {
            "path": str(campaign_file),
            "sha256": file_checksum(campaign_file),
            "text": campaign_file.read_bytes().decode(),
        },
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in PACKAGES},
            "middleware": middleware,
            "system": platform.platform(),
        },
    }
    write_json(results / "origin.json", origin)


def run_campaign(path: Path, start: str | None = None) -> Outcome:
    """Run the steps of a campaign file that are not complete, write the report, and replace the last results.

    Parameters
    ----------
    path
        The campaign file.
    start
        Name of a step: it and those after it are run again.

    Raises
    ------
    AbraceError
        If the file is wrong, a ground motion exceeds the table's limits, or a step before `start` is not complete.
    RunFailed
        If a rig runs in the campaign's namespace, a node dies or refuses a transition, a fault occurs, or a step fails.
    """
    plan = check_campaign(path)
    for care in plan.cares:
        print(f"abrace: care: {care}", file=sys.stderr)
    campaign, laboratories = plan.checked.campaign, plan.checked.laboratories
    folders = Folders(campaign.name)
    with folders.locked() as lock:
        runner = Runner(campaign, laboratories, folders.unfinished, folders.new_bags(), lock)
        seconds = [plan.seconds(step.name, step.task) for step in campaign.steps]
        return _Course(runner, folders, start, seconds).run()

# SPDX-License-Identifier: Apache-2.0
"""What the runner of a campaign does beside the live graph: how a node is started, and which files belong to a step."""

from __future__ import annotations

import json
import sys
import time
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from campaign_file import day

from abrace.campaign.done import DoneSteps
from abrace.campaign.drivers import NodeStart
from abrace.campaign.file import load_campaign
from abrace.campaign.laboratory import Laboratories
from abrace.campaign.runner import Runner, explained_by, unless_over
from abrace.processes.group import NodeDied, ProcessGroup
from abrace_core import AbraceError, RunFailed

if TYPE_CHECKING:
    from pathlib import Path

RANGE, PROFILE = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"
SHOWN = f"""import json, os, sys
names = ["OMP_NUM_THREADS", "{RANGE}", "{PROFILE}"]
print(json.dumps([sys.argv[1:], {{name: os.environ.get(name) for name in names}}]))
"""


@pytest.fixture
def runner(tmp_path: Path) -> Runner:
    """Of a campaign of two tests."""
    (tmp_path / "own.yaml").touch()
    (tmp_path / "own.csv").touch()
    noise = "{rms: 1800.0, band: [0.2, 30.0], seed: 1}"
    steps = (
        f"{{name: noise, test: {{duration: 9.0, sensor_faults: [a1=noise], excitation: {noise}}}}}",
        "{name: quake, test: {duration: 9.0, controller: own.yaml, ground_motion: {record: own.csv}}}",
    )
    read = load_campaign(day(tmp_path, *steps))
    made = Runner(read, Laboratories(read), tmp_path / "results", tmp_path / "bags", -1)
    (tmp_path / "results").mkdir()
    made.done = DoneSteps(made.results, [step.name for step in read.steps])
    return made


@pytest.mark.parametrize("lockstep", [True, False])
@pytest.mark.parametrize("reach", [None, "SUBNET"])
def test_a_node_gets_its_files_parameters_namespace_and_environment(runner, tmp_path, monkeypatch, lockstep, reach):
    monkeypatch.delenv(RANGE, raising=False)
    monkeypatch.delenv(PROFILE, raising=False)
    if reach:
        monkeypatch.setenv(RANGE, reach)
    with ProcessGroup() as group:
        node = NodeStart("controller", [sys.executable, "-c", SHOWN], {"gain": 2.0}, (tmp_path / "own.yaml",))
        runner.start(group, "quake", node, lockstep)
        while (ended := group.poll()) is None:
            pass
    assert ended.returncode == 0, ended.last_lines()
    folder = tmp_path / "results/nodes"
    given, environment = json.loads((folder / "quake_controller.log").read_text())
    files = [str(tmp_path / "own.yaml"), str(folder / "quake_controller.yaml")]
    assert [value for option, value in pairwise(given) if option == "--params-file"] == files
    assert (folder / "quake_controller.yaml").read_text() == '/**:\n  ros__parameters:\n    "gain": 2.0\n'
    assert given[-4:] == ["-r", "__ns:=/day", "-r", "__node:=controller"]
    assert environment[RANGE] == (reach or "LOCALHOST")
    assert environment["OMP_NUM_THREADS"] == "1"
    assert bool(environment[PROFILE]) is lockstep, "shared memory delays what must not be delayed"


def test_a_step_takes_the_bags_and_models_of_this_run_unless_they_are_paths(runner, tmp_path):
    assert runner.bags_of(["noise", "/bags/old"]) == [str(tmp_path / "bags/noise"), "/bags/old"]
    (tmp_path / "bags_of_before/noise").mkdir(parents=True)
    runner.done.begin()
    runner.done.end("noise", {}, tmp_path / "bags_of_before/noise", {})
    assert runner.bag_of("noise") == str(tmp_path / "bags_of_before/noise"), "a run that is continued"
    assert runner.models("model", "reduced", "model") == [
        str(tmp_path / "results/model/reduced.json"),
        str(tmp_path / "results/model/model.json"),
    ]
    assert runner.models("./others", "model") == ["others/model.json"]
    assert runner.models("others/one.json", "reduced", "model") == ["others/one.json"]
    assert runner.controller_file("lqg") == tmp_path / "results/lqg/lqg.yaml"
    assert str(runner.controller_file("/laws/own.yaml")) == "/laws/own.yaml"


def test_the_bag_of_a_test_has_the_facts_and_files_that_made_it(runner, tmp_path):
    noise, quake = (runner.campaign.tests[name] for name in ("noise", "quake"))
    lab = runner.laboratories.of(noise)
    facts = runner.facts("noise", noise, lab, 8)
    assert (
        facts.items()
        >= {
            "campaign": "day",
            "step": "noise",
            "rig": "ncree_three_storey",
            "sample_period": "0.002",
            "lockstep": "true",
            "sensor_seed": "8",
            "sensor_faults": '["a1=noise"]',
        }.items()
    )
    assert "excitation" in facts
    assert "ground_motion" not in facts
    assert facts["rig_file"] == lab.rig_file.read_text()
    files = [lab.rig_file, tmp_path / "own.yaml", tmp_path / "own.csv"]
    assert runner.attachments(quake, runner.laboratories.of(quake)) == files
    with pytest.raises(AbraceError, match=r"own\.yaml"):
        runner.facts("quake", quake, lab, 8)


def test_the_counts_of_a_run_are_those_that_the_rig_prints(runner):
    assert runner.counts("plant: done: 4500 samples, 3 late answers") == (4500, 3)
    with pytest.raises(RunFailed, match="the rig ended with 'stopped', expected its counts"):
        runner.counts("stopped")


def test_a_rig_that_has_finished_before_it_answers_is_no_failure_and_any_other_end_is_one(tmp_path):
    def ended(node: str, code: int) -> None:
        with unless_over("plant"):
            raise NodeDied(node, code, tmp_path / "log", [])

    ended("plant", 0)
    for node, code in (("plant", 1), ("logger", 0)):
        with pytest.raises(NodeDied, match=node):
            ended(node, code)


def test_a_request_that_a_node_refuses_is_explained_by_its_last_line(tmp_path):
    with ProcessGroup() as group:
        node = group.start("plant", ["echo", "configure refused: no rig"], tmp_path / "plant.log")
        while group.poll() is None:
            time.sleep(0.01)
        expected = r"^plant refused to configure; the last line of .*plant\.log: configure refused: no rig$"
        with pytest.raises(RunFailed, match=expected), explained_by(node):
            raise RunFailed("plant refused to configure")

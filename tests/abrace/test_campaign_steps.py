# SPDX-License-Identifier: Apache-2.0
"""What a step of a campaign can say: own nodes, treated records, several rigs, steps for all combinations."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from campaign_file import TOP, day, mistakes_of

from abrace.campaign.drivers import drivers, rig_node
from abrace.campaign.drives import RecordMotion
from abrace.campaign.file import Campaign, RigSetup, load_campaign
from abrace.campaign.laboratory import Laboratories
from abrace.campaign.runner import Runner
from abrace.campaign.tasks import Compare, OwnController, OwnRig, Validate
from abrace_plant.nodes.record_parameters import RECORD_PARAMETERS

MOTION = "{record: el_centro, peak_acceleration: 0.5}"


def campaign(folder: Path, *steps: str, top: str = TOP) -> Campaign:
    return load_campaign(day(folder, *steps, top=top))


def mistakes(folder: Path, *steps: str, top: str = TOP) -> list[str]:
    return mistakes_of(day(folder, *steps, top=top), load_campaign)


def test_a_record_takes_every_treatment_of_the_node_that_plays_it(tmp_path: Path) -> None:
    known = {row.name for row in RECORD_PARAMETERS} - {"rig", "duration"}
    assert set(RecordMotion.model_fields) == {"record", *known}
    given = "record: records/own.csv, unit: g, channel: x, baseline: linear, time_scale: 0.5, taper: 2.0, low_cut: 0.1"
    read = campaign(tmp_path, f"{{name: shaken, test: {{duration: 9.0, ground_motion: {{{given}}}}}}}")
    motion = read.tests["shaken"].ground_motion
    assert motion is not None
    assert motion.parameters == {
        "record": str(tmp_path / "records/own.csv"),
        "peak_acceleration": 0.0,
        "unit": "g",
        "channel": "x",
        "baseline": "linear",
        "time_scale": 0.5,
        "taper": 2.0,
        "low_cut": 0.1,
    }
    assert read.tests["shaken"].ground_motion == motion, "what is not given is left to the node"


def test_a_node_of_the_users_commands_the_braces_with_the_rigs_rate_and_limits(tmp_path: Path) -> None:
    law = "{run: laws/mine.py, parameters: {gain: 2.0, floors: [1, 2]}, name: mine_2}"
    (tmp_path / "laws").mkdir()
    (tmp_path / "laws/mine.py").touch()
    shaken = "{name: NAME, test: {duration: 9.0, controller: LAW, force_limit: [9000.0], rate_limit: 1e6}}"
    installed = "{run: [abrace_lqg, controller]}"
    steps = (shaken.replace("NAME", name).replace("LAW", one) for name, one in (("file", law), ("node", installed)))
    read = campaign(tmp_path, *steps)
    own = read.tests["file"].controller
    assert own == OwnController(
        run=(str(tmp_path / "laws/mine.py"),), parameters={"gain": 2.0, "floors": [1, 2]}, name="mine_2"
    )
    assert [test.controller_name for test in read.tests.values()] == ["mine_2", "controller"]
    laboratory = Laboratories(read).of()
    (node,) = drivers(read.tests["file"], laboratory, Path).values()
    assert node.program == [sys.executable, str(tmp_path / "laws/mine.py")]
    limits = {"force_limit": [9000.0], "rate_limit": 1.0e6}
    assert node.parameters == {"sample_rate": 500.0, **limits, "gain": 2.0, "floors": [1, 2]}
    assert [
        Path(str(part)).name for part in drivers(read.tests["node"], laboratory, Path)["brace_command"].program
    ] == ["controller"]


def test_limits_of_a_test_go_after_those_of_its_controllers_file(tmp_path: Path) -> None:
    read = campaign(tmp_path, "{name: a, test: {duration: 9.0, controller: lqg.yaml, force_limit: [9000.0]}}")
    (node,) = drivers(read.tests["a"], Laboratories(read).of(), Path).values()
    limits = {"force_limit": [9000.0], "rate_limit": 2.5e6}
    assert (node.parameters, node.files) == ({"rig_period": 0.002, **limits}, (tmp_path / "lqg.yaml",))


def test_a_test_may_have_a_rig_of_its_own_a_node_of_the_users_or_the_emulator(tmp_path: Path) -> None:
    (tmp_path / "rig.py").touch()
    own = "{run: rig.py, file: five_storey, parameters: {gain: 2}}"
    read = campaign(
        tmp_path,
        f"{{name: here, test: {{duration: 9.0, ground_motion: {MOTION}, sensor_faults: [a2=stuck], sensor_seed: 3}}}}",
        f"{{name: other, test: {{duration: 9.0, ground_motion: {MOTION}, rig: five_storey}}}}",
        f"{{name: own, test: {{duration: 9.0, ground_motion: {MOTION}, rig: {own}, lockstep: false}}}}",
        "{name: emulated, test: {duration: 9.0, device: emulator, emulator: true, lockstep: false}}",
    )
    tests, node = read.tests, OwnRig(run=(str(tmp_path / "rig.py"),), file="five_storey", parameters={"gain": 2})
    assert [read.setup_of(test) for test in tests.values()] == [
        RigSetup("ncree_three_storey"),
        RigSetup("five_storey"),
        RigSetup("five_storey", node),
        RigSetup("ncree_three_storey", None, "emulator", True),
    ]
    assert [read.in_lockstep(test) for test in tests.values()] == [True, True, False, False]
    laboratories = Laboratories(read)
    nodes = [rig_node(test, laboratories.of(test), 7, ["ground_motion"]) for test in tests.values()]
    assert [laboratories.of(test).rig.floors for test in tests.values()] == [3, 5, 5, 3]
    assert all(one.name == "plant" for one in nodes)
    assert nodes[0].parameters["sensor_faults"] == ["a2=stuck"]
    assert nodes[0].parameters["seed"] == 7
    assert nodes[2].program == [sys.executable, str(tmp_path / "rig.py")]
    assert nodes[2].parameters["gain"] == 2
    assert "seed" not in nodes[2].parameters
    assert Path(nodes[3].parameters["device"]).name == "emulator.yaml"
    assert nodes[3].parameters["stop_heartbeat"] == 1.0


def test_all_mistakes_of_a_file_are_told_at_once_each_with_its_step_and_key(tmp_path: Path) -> None:
    found = mistakes(
        tmp_path,
        "{name: a, test: {duration: -1.0, ground_motion: {record: el_centro, low_cat: 0.1}}}",
        "{name: b, design: {model: a, weights: lqg3}}",
        "{name: c, design: {model: nothing, weights: lqg3}, ambient: {test: a}}",
        "{name: d, test: {duration: 1.0, controller: {run: mine, parameters: {gain: [1, text]}}}}",
        "{name: a, test: {duration: 1.0, controller: none}}",
        "name",
        top="rig: {file: five_storey}\nlockstep: 1\nrigg: 2",
    )
    expected = [
        "10 mistakes, nothing was started",
        "rigg: unknown key",
        "rig.run: key is missing",
        "lockstep: 1, expected a valid boolean",
        "step a: test.ground_motion.low_cat: unknown key",
        "step a: test.duration: -1.0, expected greater than 0",
        "step c: 2 tasks, expected exactly one of test, identify, design, compare, validate, ambient",
        "step d: test.controller.run: 'mine', expected [package, executable], or a file that ends in .py",
        "step d: test.controller.parameters: {'gain': [1, 'text']}, expected",
        "step 6: as a whole: expected keys and values",
    ]
    for line in expected:
        assert any(one.startswith(line) for one in found), f"{line} in {found}"


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        (
            ("{name: a, test: {duration: 9.0, device: emulator, emulator: true}}",),
            "step a: test.lockstep: true, expected false with a device: hardware has its own sample clock",
        ),
        (
            ("{name: a, test: {duration: 9.0, lockstep: false, rig: {run: rig.py, file: x}, sensor_seed: 1}}",),
            "step a: test.sensor_seed, expected only with the simulated rig",
        ),
        (
            (
                f"{{name: a, test: {{duration: 9.0, ground_motion: {MOTION}}}}}",
                f"{{name: b, test: {{duration: 9.0, ground_motion: {MOTION}, rig: five_storey}}}}",
                "{name: c, compare: {test: b, uncontrolled: a}}",
            ),
            "step c: compare.uncontrolled: 'a', expected an earlier test without control and with the ground motion",
        ),
        (
            ("{name: a, ambient: {test: b}}",),
            "step a: ambient.test: 'b', expected an earlier test without excitation and controller (there is none)",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(tmp_path: Path, steps: tuple[str, ...], message: str) -> None:
    (found,) = mistakes(tmp_path, *steps)
    assert found.startswith(message)


def test_bags_and_models_of_other_campaigns_are_named_by_path(tmp_path: Path) -> None:
    read = campaign(
        tmp_path,
        "{name: a, validate: {test: ../bags/b, model: models/model.json, controller: lqg.yaml, uncontrolled: ./c}}",
        "{name: b, compare: {test: ./b, uncontrolled: /bags/c}}",
    )
    assert [step.task for step in read.steps] == [
        Validate(
            test=f"{tmp_path}/../bags/b",
            model=f"{tmp_path}/models/model.json",
            uncontrolled=f"{tmp_path}/./c",
            controller=f"{tmp_path}/lqg.yaml",
        ),
        Compare(test=f"{tmp_path}/./b", uncontrolled="/bags/c"),
    ]


def test_loops_in_lockstep_have_the_priority_of_the_campaign(tmp_path: Path) -> None:
    for top, expected in ((TOP, None), (f"{TOP}\nthread_priority: 1", 1)):
        read = campaign(tmp_path, "{name: shaken, test: {duration: 9.0}}", top=top)
        runner = Runner(read, Laboratories(read), tmp_path, tmp_path, -1)
        assert runner.loop_parameters(0, lockstep=True).get("thread_priority") == expected

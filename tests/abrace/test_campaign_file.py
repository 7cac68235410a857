# SPDX-License-Identifier: Apache-2.0
"""The campaign file: read as written, and refused with a line that says where the mistake is."""

import re
from pathlib import Path

import pytest

from abrace.campaign.check import CheckedCampaign
from abrace.campaign.drives import (
    ExcitationMultisine,
    MultisineMotion,
)
from abrace.campaign.file import RigSetup, load_campaign
from abrace.campaign.inputs import Inputs
from abrace.campaign.laboratory import Laboratories
from abrace.campaign.tasks import Ambient, Design, Identify, RigTest, Validate, given_options
from abrace.cli import main
from abrace_core import AbraceError
from abrace_lqg.proof.limits import DesignOptions
from abrace_sysid.ambient.modes import AmbientOptions

DEMO = Path(__file__).parents[2] / "src" / "abrace" / "campaigns" / "demo.yaml"


def test_the_demo_through_the_bridge_is_the_demo_in_real_time_with_shorter_tests():
    demo, bridge = load_campaign(DEMO), load_campaign(DEMO.with_name("demo_bridge.yaml"))
    assert bridge.setup == RigSetup("ncree_three_storey", None, "emulator", True)
    assert bridge.setup.simulated
    assert demo.setup.simulated
    assert (demo.lockstep, bridge.lockstep) == (True, False)

    def shortened(task):
        return task.model_copy(update={"duration": 0.0}) if isinstance(task, RigTest) else task

    assert [(step.name, shortened(step.task)) for step in bridge.steps] == [
        (step.name, shortened(step.task)) for step in demo.steps
    ]
    assert sum(step.task.duration for step in bridge.steps if isinstance(step.task, RigTest)) >= 160.0


def test_behind_a_device_without_the_emulator_nobody_knows_the_rig(tmp_path):
    path = tmp_path / "campaign.yaml"
    path.write_text("name: real\nrig: rig.yaml\ndevice: own.yaml\nsteps: [{name: rest, test: {duration: 5}}]")
    campaign = load_campaign(path)
    assert campaign.setup == RigSetup(str(tmp_path / "rig.yaml"), None, str(tmp_path / "own.yaml"), False)
    assert not campaign.setup.simulated
    assert campaign.thread_priority == 0


def test_a_step_hands_the_options_in_the_file_to_its_node(tmp_path):
    path = tmp_path / "campaign.yaml"
    design = "design: {model: model, weights: lqg3, gain_margin: 8.0, accept: [small_disk_margin], draws: 100}"
    path.write_text(DEMO.read_text().replace("design: {model: model, weights: lqg3}", design))
    task = next(step.task for step in load_campaign(path).steps if isinstance(step.task, Design))
    assert given_options(task, DesignOptions) == {"gain_margin": 8.0, "draws": 100, "accept": ["small_disk_margin"]}
    assert given_options(Design(model="model", weights="lqg3"), DesignOptions) == {}
    ambient = Ambient(test=("a",), band=(0.5, 9.0))
    assert given_options(ambient, AmbientOptions) == {"band": [0.5, 9.0]}


def test_a_campaign_that_nobody_has_is_named_with_those_that_there_are(capsys):
    assert main(["campaign", "six_controllers"]) == 2
    assert "campaign 'six_controllers': unknown, expected" in (said := capsys.readouterr().err)
    assert "demo, demo_bridge, five_controllers" in said


def test_multisines_on_table_and_command_at_once_repeated_are_one_identification(tmp_path):
    path = tmp_path / "campaign.yaml"
    both = """{duration: 200.0,
      ground_motion: {record: multisine, rms: 0.2, band: [0.3, 10.0], seed: SEED, lines: odd},
      excitation: {signal: multisine, rms: 900.0, band: [0.3, 30.0], seed: SEED, lines: even, period: 16.384}}"""
    steps = [f"{{name: test{seed}, test: {both.replace('SEED', str(seed))}}}" for seed in (1, 2)]
    steps.append("{name: model, identify: {table: [test1, test2], command: [test1, test2]}}")
    path.write_text("name: multisines\nrig: rig.yaml\nsteps:\n" + "\n".join(f"  - {step}" for step in steps))
    first, _, model = load_campaign(path).steps
    assert model.task == Identify(table=("test1", "test2"), command=("test1", "test2"))
    assert first.task == RigTest(
        duration=200.0,
        ground_motion=MultisineMotion(record="multisine", rms=0.2, band=(0.3, 10.0), seed=1, lines="odd"),
        excitation=ExcitationMultisine(
            signal="multisine", rms=900.0, band=(0.3, 30.0), seed=1, lines="even", period=16.384
        ),
    )


@pytest.mark.parametrize(
    ("step", "task"),
    [
        ("test: {duration: 5}", RigTest(duration=5.0)),
        ("test: {duration: 5.0, controller: own/lqg.yaml}", RigTest(duration=5.0, controller="/own/lqg.yaml")),
        ("validate: {test: uncontrolled, model: model}", Validate(test="uncontrolled", model="model")),
        (
            "ambient: {test: [table_noise, uncontrolled], before: table_noise, band: [0.5, 15.0]}",
            Ambient(test=("table_noise", "uncontrolled"), before=("table_noise",), band=(0.5, 15.0)),
        ),
    ],
)
def test_a_step_is_read_as_written(tmp_path, step, task):
    path = tmp_path / "campaign.yaml"
    path.write_text(f"{DEMO.read_text()}  - {{name: last, {step}}}\n")
    found = load_campaign(path).steps[-1].task
    if isinstance(task, RigTest) and task.controller:
        assert found.controller == str(tmp_path / "own/lqg.yaml"), "counted from the file's folder"
        found = found.model_copy(update={"controller": task.controller})
    assert found.model_dump() == task.model_dump()


def test_braces_may_be_disconnected_in_tests_that_are_used_together(tmp_path):
    path = tmp_path / "campaign.yaml"
    text = DEMO.read_text().replace("duration: 240.0", "duration: 240.0\n      disconnected_braces: [1]")
    path.write_text(text.partition("  - name: lqg3")[0])
    campaign = load_campaign(path)
    assert [step.task.disconnected_braces for step in campaign.steps[:2]] == [(1,), (1,)]
    with pytest.raises(AbraceError, match=r"command_noise: test\.disconnected_braces: commands to braces that are"):
        CheckedCampaign(campaign)
    path.write_text(text.partition("  - name: model")[0].replace("[1]", "[2]"))
    with pytest.raises(
        AbraceError, match=r"step table_noise: test\.disconnected_braces: brace group 2: expected one of the rig's"
    ):
        CheckedCampaign(load_campaign(path))


# what in the demo is replaced, by what, and what the error says after "campaign file <path>: "
MISTAKES = [
    ("lockstep: true", "emulator: true", "emulator: true, expected a device that is emulated"),
    ("name: demo", "name: ../demo", "name: '../demo', expected .*letters, digits"),
    ("name: demo", "name: day-1", "name: 'day-1', expected .*it is the ROS namespace"),
    ("rig: ncree_three_storey", "rig: ''", "rig: '', expected .*at least 1"),
    (
        "duration: 240.0",
        "duration: 240.0\n      disconnected_braces: [1, 1]",
        "disconnected_braces: .*every brace group once",
    ),
    (
        "duration: 240.0",
        "duration: 240.0\n      disconnected_braces: [1]",
        r"step model: identify: command_noise has brace groups \[\] disconnected, expected \[1\] as table_noise",
    ),
    ("[0.1, 10.0]", "[10.0, 0.1]", r"ground_motion.band: \[10.0, 0.1\], expected .*the lower one first"),
    (
        "{record: white_noise, rms: 0.25, band: [0.1",
        "{record: multisine, rms: 0.25, band: [0.0",
        "step table_noise: test.ground_motion: .*expected .*begins above 0 Hz",
    ),
    (
        "excitation: {rms: 1800.0",
        "excitation: {signal: sweep, rms: 1800.0",
        "step command_noise: test.excitation: .*expected .*'white_noise', 'multisine'",
    ),
    (
        "name: command_noise",
        "name: table_noise",
        "step table_noise: name: 'table_noise', expected a name that no earlier",
    ),
    ("name: model ", "name: a/b ", "step 3: name: 'a/b', expected .*letters, digits"),
    ("design: {model: model, weights: lqg3}", "", "step lqg3: 0 tasks, expected exactly one of test, identify, design"),
    (
        "{table: table_noise",
        "{table: table_nose",
        r"step model: identify.table: 'table_nose', expected an earlier test of the table alone \(table_noise\)",
    ),
    (
        "command: command_noise",
        "command: table_noise",
        r"step model: identify.command: 'table_noise', expected .* excitation alone \(command_noise\)",
    ),
    (
        "design: {model: model",
        "design: {model: lqg3",
        r"step lqg3: design.model: 'lqg3', expected an earlier identify step, or a path \(model\)",
    ),
    (
        "controller: lqg3\n",
        "controller: lqg4\n",
        r"step controlled: test.controller: 'lqg4', expected an earlier design step or a file",
    ),
    (
        "controller: lqg3\n",
        "controller: lqg3\n      excitation: {rms: 1.0, band: [0, 1], seed: 0}\n",
        "step controlled: test.controller: 'lqg3' and an excitation, expected one of the two",
    ),
    (
        "test: controlled,",
        "test: uncontrolled,",
        "step comparison: validate.controller: 'lqg3', expected none",
    ),
    (
        "uncontrolled: uncontrolled",
        "uncontrolled: table_noise",
        r"step comparison: validate.uncontrolled: 'table_noise', expected .* duration of controlled \(uncontrolled\)",
    ),
    (
        "model: model, controller",
        "model: lqg3, controller",
        r"step comparison: validate.model: 'lqg3', expected an earlier identify step, or a path \(model\)",
    ),
    (
        "controller: lqg3}",
        "controller: lqg4}",
        "step comparison: validate.controller: 'lqg4', expected 'lqg3', which test controlled runs",
    ),
]


@pytest.mark.parametrize(("written", "mistake", "message"), MISTAKES)
def test_a_mistake_is_named_with_file_step_key_and_value(tmp_path, written, mistake, message):
    text = DEMO.read_text()
    assert written in text
    path = tmp_path / "campaign.yaml"
    path.write_text(text.replace(written, mistake, 1))
    with pytest.raises(AbraceError) as raised:
        load_campaign(path)
    lines = str(raised.value).splitlines()
    assert any(re.match(f"campaign file {re.escape(str(path))}: .*{message}", line) for line in lines), lines
    assert len(lines) == 1 or lines[0] == f"{len(lines) - 1} mistakes, nothing was started"


def of_five_storeys(tmp_path: Path, old: str, new: str) -> Path:
    text = DEMO.with_name("five_storeys.yaml").read_text()
    assert old in text
    path = tmp_path / "five.yaml"
    path.write_text(text.replace(old, new, 1))
    return path


def test_the_campaigns_of_several_brace_groups_are_accepted():
    for name, rig in (("five_storeys", "five_storey"), ("ten_storeys", "ten_storey")):
        campaign = load_campaign(DEMO.with_name(f"{name}.yaml"))
        assert campaign.setup.file == rig
        CheckedCampaign(campaign)


SLOW_TEST = """  - name: slow
    test: {duration: 300.0, ground_motion: {record: white_noise, rms: 0.001, band: [0.05, 0.08], seed: 3}}
  - name: two_tests
    identify: {table: [table_noise, slow], command: command_noise}
  - name: model """


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("duration: 300.0", "duration: 40.0", "table_noise has 40 s, expected 60 s at least"),
        ("  - name: model ", SLOW_TEST, r"identify\.table: the bands of table_noise, slow do not overlap"),
    ],
)
def test_what_a_rig_cannot_do_is_refused_before_its_tests(tmp_path: Path, old: str, new: str, message: str):
    with pytest.raises(AbraceError, match=message):
        CheckedCampaign(load_campaign(of_five_storeys(tmp_path, old, new)))


def test_weights_of_floors_that_a_rig_has_not_are_refused_before_its_tests(tmp_path: Path):
    path = tmp_path / "campaign.yaml"
    path.write_text(DEMO.read_text().replace("rig: ncree_three_storey", "rig: single_storey"))
    with pytest.raises(AbraceError, match=r"step lqg3: design\.weights: weights: measured: a2, a3, expected some of"):
        CheckedCampaign(load_campaign(path))


def test_a_controller_is_designed_again_when_the_model_in_the_folder_has_changed(tmp_path):
    folder, path = tmp_path / "model", tmp_path / "campaign.yaml"
    folder.mkdir()
    for name in ("model", "reduced"):
        (folder / f"{name}.json").write_text("{}")
    path.write_text("name: own\nrig: ncree_three_storey\nsteps: [{name: sky, design: {model: ./model, weights: lqg3}}]")
    campaign = load_campaign(path)
    inputs = Inputs(campaign, Laboratories(campaign))
    before = inputs.of(0, {})
    (folder / "reduced.json").write_text("[]")
    after = inputs.of(0, {})
    assert [Path(name).name for name in before if before[name] != after[name]] == ["reduced.json"]

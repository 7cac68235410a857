# SPDX-License-Identifier: Apache-2.0
"""Campaigns: whole tests started, watched, stopped and reported by the `abrace` command."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from domain_coordinator import domain_id
from same_results import contents

from abrace.processes.group import find_executable
from abrace_bags import read_facts, read_run, read_topics
from abrace_plant.rig.file import load_rig, recorded_rig

SKYHOOK = Path(__file__).parents[2] / "examples/skyhook/skyhook/skyhook.py"
NOISE = "{record: white_noise, rms: 0.25, band: [0.1, 10.0], seed: 1}"
EL_CENTRO = "{record: el_centro, peak_acceleration: 0.98}"
SHORT = (
    f"{{name: shaken, test: {{duration: 4.0, ground_motion: {NOISE}}}}}",
    "{name: pushed, test: {duration: 20.0, excitation: {rms: 1000.0, band: [0.0, 30.0], seed: 2}}}",
)


@pytest.fixture
def environment():
    with domain_id() as domain:
        yield {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def campaign(folder: Path, *steps: str, lockstep: bool = True) -> Path:
    path = folder / "campaign.yaml"
    listed = "\n".join(f"  - {step}" for step in steps)
    path.write_text(f"name: short\nrig: ncree_three_storey\nlockstep: {str(lockstep).lower()}\nsteps:\n{listed}\n")
    return path


def start(folder: Path, environment: dict, *arguments: str) -> subprocess.Popen:
    command = [sys.executable, "-c", "import sys; from abrace.cli import main; sys.exit(main())", *arguments]
    return subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def nodes_of(folder: Path) -> list[int]:
    """Processes whose command line names this test's folder."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            line = (entry / "cmdline").read_bytes()
            inside = (entry / "cwd").resolve() == folder.resolve()
        except OSError:
            continue
        if inside and b"--ros-args" in line:
            found.append(int(entry.name))
    return found


def event_wake_ups(node: int) -> int:
    """How often the thread for the middleware's timed events has woken in a node, by its process."""
    try:
        for thread in Path(f"/proc/{node}/task").iterdir():
            if (thread / "comm").read_text().startswith("dds.ev"):
                return int((thread / "status").read_text().partition("\nvoluntary_ctxt_switches:")[2].split()[0])
    except OSError:
        pass  # it has just ended
    return 0


def wait_for(condition, timeout: float, what: str) -> None:
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, f"waited {timeout} s for {what}"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The folder in which the short campaign is run, by the first test."""
    return tmp_path_factory.mktemp("recorded")


def test_a_campaign_records_every_sample_shows_progress_and_reports_whoever_listens(recorded, environment):
    tmp_path = recorded
    path = campaign(tmp_path, *SHORT)
    listener = [find_executable("abrace_bags", "logger"), "--ros-args", "-p", "all:=true", "-p", "output:=listened"]
    with subprocess.Popen(listener, cwd=tmp_path, env=environment) as listening:
        try:
            wait_for((tmp_path / "listened").exists, 30.0, "the listener")
            process = start(tmp_path, environment, "campaign", str(path))
            wake_ups: dict[int, int] = {}
            deadline = time.monotonic() + 100.0
            while process.poll() is None and time.monotonic() < deadline:
                wake_ups |= {node: event_wake_ups(node) or wake_ups.get(node, 0) for node in nodes_of(tmp_path)}
                time.sleep(0.05)
            output, errors = process.communicate(timeout=1)
        finally:
            listening.send_signal(signal.SIGINT)
    assert read_topics(tmp_path / "listened", ["/short/response"])["/short/response"].log_time.size
    assert process.returncode == 0, errors
    assert "[1/2] shaken: done" in errors
    assert "[2/2] pushed: done" in errors
    assert "Timing, in lockstep" in output
    assert 0 < max(wake_ups.values()) < 10_000, "less than one for each sample of the longer test"
    nodes = tmp_path / "results/short/nodes"
    processors = [
        yaml.safe_load((nodes / f"shaken_{name}.yaml").read_text())["/**"]["ros__parameters"]["cpu_affinity"]
        for name in ("plant", "ground_motion")
    ]
    assert all(len(one) == 1 for one in processors)
    assert len(os.sched_getaffinity(0)) == 1 or processors[0] != processors[1]
    timing = json.loads((tmp_path / "results/short/summary.json").read_text())["timing"]
    assert set(timing["wall_seconds"]) == {"shaken", "pushed"}
    (bags,) = (tmp_path / "bags/short").iterdir()
    for step, moved, seconds in (("shaken", "ground_acceleration", 4), ("pushed", "command", 20)):
        run = read_run(bags / step)
        assert len(run.outputs) == 500 * seconds
        assert run.sequence[0] == 0
        assert abs(getattr(run, moved)).max() > 0.5
        facts = read_facts(bags / step)
        assert facts["rig"] == "ncree_three_storey"
        assert "masses" in facts["rig_file"]
        topics = read_topics(bags / step)
        assert topics.attachments.keys() == {"ncree_three_storey.yaml"}
        drive = {"shaken": "ground_motion", "pushed": "brace_command"}[step]
        due = list(range(0, seconds * 10**9, 2 * 10**6))
        for topic in ("response", drive):
            assert list(topics[f"/short/{topic}"].log_time) == due, "the samples' time"
        assert topics["/diagnostics"].log_time.max() < seconds * 1e9
    assert not nodes_of(tmp_path)


def test_the_bag_of_a_rig_with_a_frame_file_describes_it_alone(tmp_path, environment):
    configuration = Path(get_package_share_directory("abrace_plant")) / "config"
    rig, frame = tmp_path / "three.yaml", tmp_path / "frames/three.yaml"
    frame.parent.mkdir()
    frame.write_text((configuration / "frames/sac_la_3.yaml").read_text() + "# ours\n")
    content = yaml.safe_load((configuration / "sac_la_20.yaml").read_text())
    content |= {"building": {"frame": str(frame)}, "braces": content["braces"][:3]}
    rig.write_text(yaml.safe_dump(content))
    path = tmp_path / "frames.yaml"
    path.write_text(f"name: frames\nrig: three.yaml\nlockstep: true\nsteps: [{SHORT[0]}]\n")
    process = start(tmp_path, environment, "campaign", str(path))
    _, errors = process.communicate(timeout=100)
    assert process.returncode == 0, errors
    (bags,) = (tmp_path / "bags/frames").iterdir()
    bag, expected = bags / "shaken", load_rig(rig)
    attached = read_topics(bag).attachments
    assert attached == {"three.yaml": rig.read_bytes(), "frames/three.yaml": frame.read_bytes()}
    frame.unlink()
    found = recorded_rig(read_facts(bag))
    assert found is not None
    assert found.building.stiffness == pytest.approx(expected.building.stiffness)
    assert start(tmp_path, environment, "report", "results/frames").wait(100) == 0
    drawn = start(tmp_path, environment, "bag", "animate", str(bag), "--output", "b.gif", "--duration", "0.5")
    assert drawn.wait(100) == 0


def test_a_law_and_a_rig_of_ones_own_run_in_a_campaign_and_the_law_is_in_its_tables(tmp_path, environment):
    moved = f"duration: 4.0, ground_motion: {NOISE}, rig: {{run: [abrace_plant, plant], file: ncree_three_storey}}"
    endless = "{run: [abrace_plant, plant], file: ncree_three_storey, parameters: {duration: 0.0}}"
    path = campaign(
        tmp_path,
        f"{{name: free, test: {{{moved}}}}}",
        f"{{name: damped, test: {{{moved}, controller: {{run: {SKYHOOK}, name: sky}}, force_limit: [50.0]}}}}",
        "{name: effect, compare: {test: damped, uncontrolled: free}}",
        f"{{name: watched, test: {{duration: 1.0, lockstep: false, rig: {endless}}}}}",
    )
    process = start(tmp_path, environment, "campaign", str(path))
    output, errors = process.communicate(timeout=120)
    # by the clock of a machine that stood still samples are missing, which is said
    assert process.returncode == ("cannot be trusted: watched: " in errors), errors
    assert "Without and with sky: white_noise" in output
    (bags,) = (tmp_path / "bags/short").iterdir()
    assert abs(read_run(bags / "damped").command).max() == 50.0
    assert read_facts(bags / "damped")["controller"] == "sky"
    watched = read_topics(bags / "watched", ["/short/response"])["/short/response"]
    assert 500 <= watched.log_time.size < 3000, "a rig that does not end by itself is ended"


def test_multisines_on_table_and_two_brace_groups_at_once_give_a_model_and_a_controller_of_both(tmp_path, environment):
    both = """{duration: 73.0,
      ground_motion: {record: multisine, rms: 0.25, band: [0.3, 25.0], seed: 1, period: 16.384},
      excitation:
        {signal: multisine, rms: [3500.0, 7000.0], band: [0.3, 30.0], seed: 1, period: 16.384, lines: even}}"""
    path = campaign(
        tmp_path,
        f"{{name: both, test: {both}}}",
        "{name: model, identify: {table: both, command: both}}",
        "{name: half, design: {model: model, weights: half}}",
        f"{{name: quake, test: {{duration: 6.0, ground_motion: {EL_CENTRO}, controller: half}}}}",
        "{name: check, validate: {test: quake, model: model, controller: half}}",
    )
    path.write_text(path.read_text().replace("ncree_three_storey", "five_storey"))
    process = start(tmp_path, environment, "campaign", str(path))
    _, errors = process.communicate(timeout=200)
    assert process.returncode == 0, errors
    (bags,) = (tmp_path / "bags/short").iterdir()
    commands = read_run(bags / "both").command
    moved = np.abs(commands).max(axis=1) > 0
    assert np.sqrt(np.mean(commands[moved] ** 2, axis=0)) == pytest.approx([3500.0, 7000.0], rel=0.01)
    summary = json.loads((tmp_path / "results/short/summary.json").read_text())
    for test in ("table", "command"):
        error = summary["poles"][test]["largest_relative_error"]
        assert error["frequency"] < 0.001
        assert error["damping_ratio"] < 0.05
    assert min(row["correlation"] for row in summary["simulated_vs_measured"].values()) > 0.999
    assert set(summary["other_models"]) == {"superposed", "reduced"}


def test_modes_of_the_frame_without_braces_and_without_a_drive_are_in_the_report(tmp_path, environment):
    path = campaign(
        tmp_path,
        f"{{name: quiet, test: {{duration: 100.0, disconnected_braces: [1], ground_motion: {NOISE}}}}}",
        "{name: modes, ambient: {test: quiet, before: quiet}}",
    )
    process = start(tmp_path, environment, "campaign", str(path))
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    assert "Modes from ambient vibration: modes, 100 s of a1, a2, a3" in output
    assert "No change beyond chance." in output
    found = json.loads((tmp_path / "results/short/summary.json").read_text())["ambient"]["modes"]
    for bare in (6.673, 21.783, 37.506):
        assert any(mode["frequency"] == pytest.approx(bare, rel=0.02) for mode in found["modes"]), bare
    (bags,) = (tmp_path / "bags/short").iterdir()
    assert read_facts(bags / "quiet")["disconnected_braces"] == "[1]"


def test_a_campaign_interrupted_twice_goes_on_and_has_the_results_of_one_that_was_not(recorded, tmp_path, environment):
    command = ["campaign", str(campaign(tmp_path, *SHORT))]
    results = tmp_path / "results"

    def grown() -> list[Path]:
        bags = (tmp_path / "bags").glob("short/*/pushed/*.mcap")
        return [bag for bag in bags if bag.stat().st_size > 50_000]

    for count, number in enumerate((signal.SIGKILL, signal.SIGINT), 1):
        process = start(tmp_path, environment, *command)
        wait_for(lambda count=count: len(grown()) == count, 60, "a bag that grows")
        process.send_signal(number)
        _, errors = process.communicate(timeout=120)
        assert process.returncode == {signal.SIGINT: 130}.get(number, -number)
        assert "Traceback" not in errors
        assert ("shaken: complete, kept" in errors) == (count > 1)
        assert not (results / "short").exists()
        if number == signal.SIGKILL:
            continue  # its nodes end meanwhile; the next run waits for them
        assert not nodes_of(tmp_path)
        assert "1 of 2 steps are complete, in results/_unfinished/short; " in errors
        assert "the same command continues with pushed" in errors
        assert (grown()[-1].parent / "metadata.yaml").exists()
    process = start(tmp_path, environment, *command)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    assert "[1/2] shaken: complete, kept\n" in errors
    found, expected = contents(tmp_path, "short"), contents(recorded, "short")
    assert found == expected
    assert {"shaken /short/response", "pushed /short/brace_command", "nodes/shaken_plant.yaml"} <= found.keys()
    assert sorted(path.name for path in results.iterdir()) == [".short.lock", "short"]
    assert len(list((tmp_path / "bags/short").iterdir())) == 3, "bags are never written over"


def test_from_a_step_on_it_is_run_anew_and_what_fails_leaves_the_last_results(recorded, environment):
    before = contents(recorded, "short")
    path = recorded / "campaign.yaml"
    text = path.read_text()
    path.write_text(text.replace("rms: 0.25", "rms: 0.26"))
    refused = start(recorded, environment, "campaign", str(path), "--from", "pushed")
    assert "--from pushed: step shaken: its text has changed" in refused.communicate(timeout=60)[1]
    assert refused.returncode == 2
    path.write_text(text.replace("duration: 20.0", "duration: 600.0"))
    process = start(recorded, environment, "campaign", str(path), "--from", "pushed")
    wait_for(lambda: len(nodes_of(recorded)) == 3, 30, "three nodes")
    (victim,) = [pid for pid in nodes_of(recorded) if b"excitation\0" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(victim, signal.SIGKILL)
    _, errors = process.communicate(timeout=120)
    path.write_text(text)
    assert process.returncode == 1
    assert "[1/2] shaken: complete, kept\n" in errors
    assert "excitation died (ended by SIGKILL)" in errors
    assert "Traceback" not in errors
    assert not nodes_of(recorded)
    assert contents(recorded, "short") == before
    failed = json.loads((recorded / "results/_unfinished/short/summary.json").read_text())["failed"]
    assert failed["step"] == "pushed"
    assert "excitation died" in failed["cause"]


def test_a_test_that_is_not_to_be_trusted_sets_the_exit_code_and_a_fault_ends_the_campaign(tmp_path, environment):
    rig = Path(get_package_share_directory("abrace_plant"), "config/ncree_three_storey.yaml").read_text()
    for before, after in (
        ("ground_acceleration: {range: 1.5,", "ground_acceleration: {range: 0.55,"),
        ("clipped: {time: 0.02, action: stop, reset: person}", "clipped: {time: 0.02, action: warn}"),
        ("stuck: {time: 0.05, action: stop, reset: person}", "stuck: {time: 0.05, action: warn}"),
    ):
        assert before in rig
        rig = rig.replace(before, after)
    (tmp_path / "near.yaml").write_text(rig)
    path = campaign(tmp_path, f"{{name: shaken, test: {{duration: 4.0, rig: near.yaml, ground_motion: {NOISE}}}}}")
    process = start(tmp_path, environment, "campaign", str(path))
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "abrace: cannot be trusted: shaken: w: " in errors
    assert "What happened in the tests" in output
    summary = json.loads((tmp_path / "results/short/summary.json").read_text())
    assert summary["happened"]["shaken"]["clipped"]["w"] > 10
    path = campaign(
        tmp_path, f"{{name: shaken, test: {{duration: 4.0, sensor_faults: [a1=stuck@2.0], ground_motion: {NOISE}}}}}"
    )
    process = start(tmp_path, environment, "campaign", str(path))
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "a1: stuck at" in errors
    assert "0 of 1 steps are complete, in results/_unfinished/short" in errors
    assert "Traceback" not in errors
    assert json.loads((tmp_path / "results/short/summary.json").read_text()) == summary


def test_a_wrong_campaign_ends_with_every_mistake_and_without_a_node(tmp_path, environment):
    path = campaign(
        tmp_path,
        "{name: a, test: {duration: 4.0, ground_motion: {record: nowhere.at2}}}",
        "{name: b, test: {duration: 9.0, ground_motion: {record: el_centro, peak_acceleration: 30.0}}}",
        "{name: c, test: {duration: 4.0, controller: nowhere.yaml}}",
    )
    process = start(tmp_path, environment, "campaign", str(path))
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 2
    for message in (
        "nowhere.at2",
        "test.ground_motion: ground motion el_centro exceeds the table's limits: acceleration 30 m/s^2 at 2.178 s",
        "nowhere.yaml: No such file",
    ):
        assert message in errors
    assert "Traceback" not in errors
    assert not nodes_of(tmp_path)

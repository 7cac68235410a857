# SPDX-License-Identifier: Apache-2.0
"""Campaigns: whole tests started, watched, stopped and reported by the `abrace` command."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import rclpy
import yaml
from ament_index_python.packages import get_package_share_directory
from domain_coordinator import domain_id
from forked import run_forked
from running_graph import SLOW
from same_results import contents
from udp_target import device_file

from abrace.campaign.drivers import LOCKSTEP_START
from abrace.processes.group import find_executable
from abrace_bags import Bag, read_run
from abrace_node.transport import profile

SKYHOOK = Path(__file__).parents[2] / "examples/5_skyhook/skyhook/skyhook.py"
NOISE = "{record: white_noise, rms: 0.25, band: [0.1, 10.0], seed: 1}"
PATIENCE = 400.0
"""Seconds for a campaign: a healthy machine never comes near."""
SHORT = (
    f"{{name: shaken, test: {{duration: 2.0, ground_motion: {NOISE}}}}}",
    "{name: pushed, test: {duration: 10.0, excitation: {rms: 1000.0, band: [0.0, 30.0], seed: 2}}}",
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


def use_shared_memory(nodes: list[int]) -> bool:
    """Whether all of these processes have Fast DDS's shared memory."""
    try:
        return all("fastrtps" in Path(f"/proc/{node}/maps").read_text() for node in nodes)
    except OSError:  # one has just ended
        return False


def wait_for(condition, what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f"waited {PATIENCE} s for {what}"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The folder in which the short campaign is run, by the first test."""
    return tmp_path_factory.mktemp("recorded")


def test_a_campaign_records_every_sample_shows_progress_and_reports_whoever_listens(recorded, environment):
    tmp_path = recorded
    path = campaign(tmp_path, *SHORT)
    listener = [find_executable("abrace_bags", "logger"), "--ros-args", "-p", "output:=listened"]
    listener += ["-p", "topics:=[/short/response]"]
    with subprocess.Popen(listener, cwd=tmp_path, env=environment) as listening:
        try:
            wait_for((tmp_path / "listened").exists, "the listener")
            process = start(tmp_path, environment, "campaign", str(path))
            wait_for(lambda: len(nodes_of(tmp_path)) == 4, "the listener and three nodes")
            nodes = [node for node in nodes_of(tmp_path) if node != listening.pid]
            wait_for(lambda: use_shared_memory(nodes), "shared memory: else each message wakes them")
            output, errors = process.communicate(timeout=PATIENCE)
        finally:
            listening.send_signal(signal.SIGINT)
    assert Bag(tmp_path / "listened").arrays(["/short/response"])["/short/response"].log_time.size
    assert process.returncode == 0, errors
    assert "[1/2] shaken: done" in errors
    assert "[2/2] pushed: done" in errors
    assert "Timing, in lockstep" in output
    folder = tmp_path / "results/short/nodes"
    processors = [
        yaml.safe_load((folder / f"shaken_{name}.yaml").read_text())["/**"]["ros__parameters"]["cpu_affinity"]
        for name in ("plant", "ground_motion")
    ]
    assert all(len(one) == 1 for one in processors)
    assert len(os.sched_getaffinity(0)) == 1 or processors[0] != processors[1]
    timing = json.loads((tmp_path / "results/short/summary.json").read_text())["timing"]
    assert set(timing["wall_seconds"]) == {"shaken", "pushed"}
    (bags,) = (tmp_path / "bags/short").iterdir()
    for step, moved, signal_seconds in (("shaken", "ground_acceleration", 2), ("pushed", "command", 10)):
        run, seconds = read_run(bags / step), signal_seconds + LOCKSTEP_START
        assert len(run.outputs) == 500 * seconds
        assert run.sequence[0] == 0
        assert abs(getattr(run, moved)).max() > 0.5
        facts = Bag(bags / step).facts
        assert facts["rig"] == "ncree_three_storey"
        assert "masses" in facts["rig_file"]
        assert [one.name for one in Bag(bags / step).attachments] == ["ncree_three_storey.yaml"]
        topics = Bag(bags / step).arrays()
        drive = {"shaken": "ground_motion", "pushed": "brace_command"}[step]
        due = list(range(0, round(seconds * 1e9), 2 * 10**6))
        for topic in ("response", drive):
            assert list(topics[f"/short/{topic}"].log_time) == due, "the samples' time"
        assert topics["/diagnostics"].log_time.max() < seconds * 1e9
    assert not nodes_of(tmp_path)


def test_a_law_and_a_rig_of_ones_own_run_in_a_campaign_and_the_law_is_in_its_tables(tmp_path, environment):
    moved = f"duration: 2.0, ground_motion: {NOISE}, rig: {{run: [abrace_plant, plant], file: ncree_three_storey}}"
    endless = "{run: [abrace_plant, plant], file: ncree_three_storey, parameters: {duration: 0.0}}"
    path = campaign(
        tmp_path,
        f"{{name: free, test: {{{moved}}}}}",
        f"{{name: damped, test: {{{moved}, controller: {{run: {SKYHOOK}, name: sky}}, force_limit: [50.0]}}}}",
        "{name: effect, compare: {test: damped, uncontrolled: free}}",
        f"{{name: watched, test: {{duration: 1.0, lockstep: false, rig: {endless}}}}}",
    )
    process = start(tmp_path, environment, "campaign", str(path))
    output, errors = process.communicate(timeout=PATIENCE)
    # by the clock of a machine that stood still samples are missing, which is said
    assert process.returncode == ("cannot be trusted: watched: " in errors), errors
    assert "Without and with sky: white_noise" in output
    (bags,) = (tmp_path / "bags/short").iterdir()
    assert abs(read_run(bags / "damped").command).max() == 50.0
    assert Bag(bags / "damped").facts["controller"] == "sky"
    watched = Bag(bags / "watched").arrays(["/short/response"])["/short/response"]
    assert 500 <= watched.log_time.size < 3000, "a rig that does not end by itself is ended"


def test_a_campaign_interrupted_twice_goes_on_and_has_the_results_of_one_that_was_not(recorded, tmp_path, environment):
    command = ["campaign", str(campaign(tmp_path, *SHORT))]
    results = tmp_path / "results"

    def grown() -> list[Path]:
        bags = (tmp_path / "bags").glob("short/*/pushed/*.mcap")
        return [bag for bag in bags if bag.stat().st_size > 50_000]

    for count, number in enumerate((signal.SIGKILL, signal.SIGINT), 1):
        process = start(tmp_path, environment, *command)
        wait_for(lambda count=count: len(grown()) == count, "a bag that grows")
        process.send_signal(number)
        _, errors = process.communicate(timeout=PATIENCE)
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
    _, errors = process.communicate(timeout=PATIENCE)
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
    assert "--from pushed: step shaken: its text has changed" in refused.communicate(timeout=PATIENCE)[1]
    assert refused.returncode == 2
    path.write_text(text.replace("duration: 10.0", "duration: 600.0"))
    process = start(recorded, environment, "campaign", str(path), "--from", "pushed")
    wait_for(lambda: len(nodes_of(recorded)) == 3, "three nodes")
    (victim,) = [pid for pid in nodes_of(recorded) if b"excitation\0" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(victim, signal.SIGKILL)
    _, errors = process.communicate(timeout=PATIENCE)
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
    path = campaign(tmp_path, f"{{name: shaken, test: {{duration: 2.0, rig: near.yaml, ground_motion: {NOISE}}}}}")
    process = start(tmp_path, environment, "campaign", str(path))
    output, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "abrace: cannot be trusted: shaken: w: " in errors
    assert "What happened in the tests" in output
    summary = json.loads((tmp_path / "results/short/summary.json").read_text())
    assert summary["happened"]["shaken"]["clipped"]["w"] > 10
    path = campaign(
        tmp_path, f"{{name: shaken, test: {{duration: 2.0, sensor_faults: [a1=stuck@1.0], ground_motion: {NOISE}}}}}"
    )
    process = start(tmp_path, environment, "campaign", str(path))
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "a1: stuck at" in errors
    assert "0 of 1 steps are complete, in results/_unfinished/short" in errors
    assert "Traceback" not in errors
    assert json.loads((tmp_path / "results/short/summary.json").read_text()) == summary


def test_a_campaign_that_meets_a_rig_of_its_name_says_where_and_what_to_do(tmp_path, monkeypatch, domain):
    monkeypatch.chdir(tmp_path)
    context = rclpy.Context()
    context.init(domain_id=domain)
    with profile(streams=True):  # as rigs have it
        rig = rclpy.create_node("plant", namespace="/short", context=context)
    ended = run_forked(["abrace", "campaign", str(campaign(tmp_path, *SHORT))])
    rig.destroy_node()
    context.try_shutdown()
    assert ended.returncode == 1
    expected = (
        f"namespace /short of ROS domain {domain} has plant already, expected no rig and no campaign there: end it"
    )
    assert expected in ended.stderr
    assert not list(tmp_path.glob("results/_unfinished/short/nodes/*")), "nothing was started"


def test_a_campaign_with_an_emulated_device_ends_and_is_its_rigs_stop_button(tmp_path, environment):
    rig = Path(get_package_share_directory("abrace_plant"), "config/ncree_three_storey.yaml").read_text()
    (tmp_path / "slow.yaml").write_text(rig.replace("sample_rate: 500.0", f"sample_rate: {SLOW}"))
    device_file(tmp_path, timeout=0.1)
    pushed = "{name: pushed, test: {duration: 2.0, excitation: {rms: 1000.0, band: [0.5, 20.0], seed: 2}}}"
    path = tmp_path / "campaign.yaml"
    path.write_text(
        f"name: short\nrig: slow.yaml\ndevice: device.yaml\nemulator: true\nthread_priority: 50\nsteps:\n  - {pushed}\n"
    )
    process = start(tmp_path, environment, "campaign", str(path))
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, errors
    nodes = tmp_path / "results/short/nodes"
    assert yaml.safe_load((nodes / "pushed_plant.yaml").read_text())["/**"]["ros__parameters"]["stop_heartbeat"] == 1.0
    assert "late answers" in (nodes / "pushed_plant.log").read_text(), "no stop"
    assert json.loads((nodes / "pushed_emulator.json").read_text())["worst_force"] > 500.0

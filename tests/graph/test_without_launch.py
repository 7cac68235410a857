# SPDX-License-Identifier: Apache-2.0
"""The tests of the launch files where there is no `ros2 launch`: exit codes, what the terminal shows, whole bags."""

import subprocess
from pathlib import Path

import pytest

from abrace_bags import read_runs

RIG = Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml"
LOCKSTEP = (
    "/**/plant:\n  ros__parameters: {lockstep: true, wait_for: [brace_command, ground_motion]}\n"
    "/**/logger:\n  ros__parameters: {lockstep: true}\n"
    "/**/ground_motion:\n  ros__parameters: {period: 1.0, band: [2.0, 10.0]}\n"
    "/**/excitation:\n  ros__parameters: {period: 1.0, band: [2.0, 30.0]}\n"
)


def command(test: str, **arguments: object) -> list[str]:
    """The command that runs a test with these arguments."""
    return [*f"abrace run abrace_bringup {test}".split(), *(f"{name}:={value}" for name, value in arguments.items())]


@pytest.fixture
def launch(domain, tmp_path, monkeypatch):  # noqa: ARG001
    """Runs a test to its end with these arguments."""
    monkeypatch.chdir(tmp_path)

    def run(test: str, **arguments: object) -> subprocess.CompletedProcess:
        return subprocess.run(command(test, **arguments), capture_output=True, text=True, timeout=120, check=False)

    return run


def test_one_command_starts_all_in_order_records_from_sample_0_and_ends_after_the_signal(launch):
    Path("lockstep.yaml").write_text(LOCKSTEP)
    Path("rig.yaml").write_text(RIG.read_text())
    given = {"free_decay": 0.5, "parameters": "lockstep.yaml", "bag": "bags/first"}
    ended = launch("identification", drive="both", duration=4, rig="rig.yaml", **given)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "[supervisor] supervisor: all nodes have found each other; plant activated\n" in ended.stdout
    assert "[logger] logger: wrote bags/first: " in ended.stdout
    (run,) = read_runs("bags/first")
    assert run.sequence[0] == 0
    assert len(run.sequence) == run.sequence[-1] + 1 > 4.0 * 500


def test_a_reader_of_the_output_that_leaves_ends_the_test(domain, tmp_path, monkeypatch):  # noqa: ARG001
    monkeypatch.chdir(tmp_path)
    starts = command("identification", drive="table", duration=5, bag="first")
    with subprocess.Popen(starts, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as launched:
        assert launched.stdout is not None
        assert launched.stderr is not None
        assert any("plant activated" in line for line in launched.stdout)
        launched.stdout.close()
        assert launched.stderr.read() == "identification: the test was stopped before it was done\n"
        assert launched.wait(timeout=60) == 1
    assert read_runs("first")


def test_a_node_that_refuses_ends_the_test_and_the_terminal_says_why(launch):
    Path("wrong.yaml").write_text("/**/logger:\n  ros__parameters: {split_size: -1}\n")
    ended = launch("identification", drive="command", parameters="wrong.yaml", bag="bag")
    assert ended.returncode == 1
    assert "[logger] logger: parameter split_size: -1, expected a whole number" in ended.stdout
    assert ended.stderr == "identification: logger has ended with exit code 2, the test is incomplete\n"


def test_wrong_arguments_are_named_and_nothing_is_started(launch):
    ended = launch("closed_loop", controler="lqg3.yaml", duration="ten", bag="bag")
    assert (ended.returncode, ended.stdout) == (2, "")
    first, *lines = ended.stderr.splitlines()
    assert first == "closed_loop: wrong launch arguments, nothing was started"
    assert [line.partition(":")[0] for line in lines] == ["controler", "controller", "duration"]

# SPDX-License-Identifier: Apache-2.0
"""Processes: found, started, watched, stopped, and none left behind."""

import contextlib
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from abrace.processes.group import NodeDied, NodeProcess, ProcessGroup, Terminated, find_executable, launcher
from abrace.processes.group import terminate_as_exception as terminating
from abrace.processes.launcher import is_running
from abrace.processes.parameter_file import parameter_file
from abrace_core import AbraceError, RunFailed

PATIENCE = 30.0

OBEDIENT = "import sys, time\ntry:\n print('ready'); time.sleep(300)\nexcept KeyboardInterrupt:\n print('closed')"
STUBBORN = (
    "import signal, time\nfor n in (signal.SIGINT, signal.SIGTERM): signal.signal(n, signal.SIG_IGN)\n"
    "print('ready'); time.sleep(300)"
)
STOPPED_BY_SIGTERM = (
    "import signal, time\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\nprint('ready'); time.sleep(300)"
)
GRANDPARENT = f"import subprocess, sys, time\nsubprocess.Popen([sys.executable, '-uc', {STUBBORN!r}])\ntime.sleep(300)"
CHILDREN = {"obedient": OBEDIENT, "stubborn": STUBBORN, "grandparent": GRANDPARENT}


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def until(holds, what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < deadline, f"waited {PATIENCE} s for {what}"
        time.sleep(0.005)


def start_ready(group: ProcessGroup, folder: Path, name: str, code: str) -> NodeProcess:
    log = folder / f"{name}.log"
    process = group.start(name, python(code), log)
    until(lambda: "ready" in log.read_text(), f"{name} to be ready")
    return process


def test_stop_lets_a_process_close_on_sigint(tmp_path):
    with ProcessGroup() as group:
        start_ready(group, tmp_path, "logger", OBEDIENT)
        stopped = group.stop("logger")
    assert stopped.returncode == 0, "ended by itself on SIGINT"
    assert stopped.last_lines() == ["ready", "closed"]


@pytest.mark.parametrize(("code", "last"), [(STOPPED_BY_SIGTERM, signal.SIGTERM), (STUBBORN, signal.SIGKILL)])
def test_stop_goes_on_to_the_signal_that_ends_the_process(tmp_path, code, last):
    with ProcessGroup() as group:
        node = start_ready(group, tmp_path, "node", code)
        assert group.stop("node", grace=0.5).returncode == -last
    assert not is_running(node.group)


def test_stop_ends_what_the_process_started(tmp_path):
    with ProcessGroup(grace=0.05) as group:
        node = start_ready(group, tmp_path, "node", GRANDPARENT)
        group.stop("node")
        assert not is_running(node.group), "the grandchild ignores SIGINT and SIGTERM, and is gone all the same"


def test_stop_ends_what_a_dead_process_left(tmp_path):
    orphan = f"import subprocess, sys\nsubprocess.Popen([sys.executable, '-uc', {STUBBORN!r}])"
    with ProcessGroup(grace=0.05) as group:
        node = start_ready(group, tmp_path, "node", orphan)
        until(lambda: group.poll() is node, "the parent to end")
        assert is_running(node.group), "its child runs on"
        assert group.stop("node").returncode == 0
        assert not is_running(node.group)


def test_processes_are_stopped_in_the_order_asked_for_then_last_started_first(tmp_path):
    order = tmp_path / "order"
    code = OBEDIENT.replace("print('closed')", f"open({str(order)!r}, 'a').write(sys.argv[1])")
    with ProcessGroup() as group:
        for name in "abcd":
            group.start(name, [*python(code), name], tmp_path / name)
            until(lambda name=name: "ready" in (tmp_path / name).read_text(), "the process to be ready")
        group.stop_all(order=["b", "missing"])
    assert order.read_text() == "bdca"


@pytest.mark.parametrize("error", [ValueError, Terminated(signal.SIGTERM)])
def test_leaving_the_block_in_any_way_ends_all(tmp_path, error):
    def run() -> None:
        with ProcessGroup(grace=0.05) as group:
            started.extend(start_ready(group, tmp_path, name, code) for name, code in CHILDREN.items())
            raise error

    started: list[NodeProcess] = []
    with pytest.raises(error if isinstance(error, type) else type(error)):
        run()
    assert [node.name for node in started if is_running(node.group)] == []


def test_a_process_that_is_stopped_at_once_hears_the_first_signal(tmp_path):
    with ProcessGroup(grace=PATIENCE) as group:
        for _ in range(20):
            group.start("node", ["sleep", "300"], tmp_path / "log")
            assert group.stop("node").returncode == -signal.SIGINT


def test_a_death_is_reported_with_the_last_lines(tmp_path):
    with ProcessGroup() as group:
        start_ready(group, tmp_path, "plant", OBEDIENT)
        dying = group.start("controller", python("print('x' * 9000); gain = 1 / 0"), tmp_path / "logs" / "c.log")
        group.raise_if_died()
        until(lambda: group.poll() is not None, "the controller to die")
        assert group.poll() is dying
        with pytest.raises(NodeDied) as raised:
            group.raise_if_died(may_finish=["controller"])
    assert (raised.value.name, raised.value.returncode) == ("controller", 1)
    assert raised.value.last_lines[-1] == "ZeroDivisionError: division by zero"
    why = "controller died (exit code 1): ZeroDivisionError: division by zero"
    assert str(raised.value) == f"{why} (all it printed: {tmp_path / 'logs' / 'c.log'})"


def test_a_death_on_a_full_disk_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=4096))
    assert str(NodeDied("logger", 1, tmp_path / "log", [])).startswith(
        "logger died (exit code 1, no space left on the disk): it printed nothing"
    )


def test_a_death_by_a_signal_names_the_signal(tmp_path):
    with ProcessGroup() as group:
        group.start("plant", python("import os; os.kill(os.getpid(), 11)"), tmp_path / "log")
        until(lambda: group.poll() is not None, "the plant to die")
        with pytest.raises(NodeDied, match=r"plant died \(ended by SIGSEGV\): it printed nothing"):
            group.raise_if_died()


def test_an_early_end_is_a_death_unless_it_was_expected(tmp_path):
    with ProcessGroup() as group:
        group.start("ground_motion", python(""), tmp_path / "log")
        until(lambda: group.poll() is not None, "the process to end")
        group.raise_if_died(may_finish=["ground_motion"])
        with pytest.raises(NodeDied, match="exit code 0"):
            group.raise_if_died()
        group.stop("ground_motion")
        assert group.poll() is None, "a stopped process is watched no more"


def test_the_environment_is_ours_with_additions(tmp_path, monkeypatch):
    monkeypatch.setenv("OURS", "1")
    code = "import os; print(os.environ['OURS'], os.environ['ADDED'])"
    with ProcessGroup() as group:
        node = group.start("node", python(code), tmp_path / "log", {"ADDED": "2"})
        until(lambda: node.returncode is not None, "the process to end")
    assert node.last_lines() == ["1 2"]


def test_held_files_are_closed_once_the_last_process_has_ended(tmp_path):
    reading, writing = os.pipe()
    with ProcessGroup(held=[writing]) as group:
        start_ready(group, tmp_path, "node", OBEDIENT)
        os.close(writing)
        assert select.select([reading], [], [], 0.1)[0] == [], "the process has it open"
        group.stop("node")
        assert select.select([reading], [], [], PATIENCE)[0] == [reading]
    os.close(reading)


def test_a_node_is_a_fork_that_has_the_command_line_folder_variables_and_signals_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = [find_executable("abrace_bags", "logger"), "--ros-args", "-p", "output:=bag", "-p", "topics:=[x]"]
    with ProcessGroup() as group:
        node = group.start("logger", command, tmp_path / "log", {"ROS_LOG_DIR": str(tmp_path / "ros")})
        until((tmp_path / "bag").exists, "the bag")
        assert Path(f"/proc/{node.group}/cmdline").read_text().rstrip("\0").split("\0") == list(map(str, command))
        assert Path(f"/proc/{node.group}/comm").read_text() == "logger\n"
        assert (tmp_path / "ros").exists()
        assert group.stop("logger").returncode == 0, "ended by itself on SIGINT"
    assert node.last_lines() == ["logger: wrote bag: nothing came"]


def test_an_offline_node_leaves_no_figure_in_the_launcher_of_those_that_act(tmp_path):
    launcher().close()  # other tests have had figures drawn by commands in theirs: the group starts a new one
    with ProcessGroup() as group:
        command = [find_executable("abrace_sysid", "validate"), "--version"]
        node = group.start("validate", command, tmp_path / "log", offline=True)
        until(lambda: node.returncode is not None, "the node to end")
        assert "matplotlib" not in Path(f"/proc/{launcher().process}/maps").read_text()
    assert node.returncode == 0
    assert node.last_lines()[0].startswith("validate of abrace ")


def test_a_process_that_cannot_be_executed_says_why(tmp_path):
    program = tmp_path / "program"
    program.write_text("no program")
    program.chmod(0o755)
    with ProcessGroup() as group:
        node = group.start("node", [program], tmp_path / "log")
        until(lambda: node.returncode is not None, "the process to end")
    assert (node.returncode, node.last_lines()) == (127, [f"{program}: Exec format error"])


def test_a_group_whose_launcher_was_killed_starts_nothing_and_the_next_one_has_another(tmp_path):
    with ProcessGroup() as group:
        os.kill(launcher().process, signal.SIGKILL)
        with pytest.raises(RunFailed, match="cannot start node: "):
            group.start("node", python(""), tmp_path / "log")
    with ProcessGroup() as group:
        start_ready(group, tmp_path, "node", OBEDIENT)


def test_a_process_cannot_start_without_program_log_or_name_of_its_own(tmp_path):
    (tmp_path / "file").touch()
    with ProcessGroup() as group:
        with pytest.raises(AbraceError, match="cannot start node: no-such-program"):
            group.start("node", ["no-such-program"], tmp_path / "log")
        with pytest.raises(AbraceError, match=r"cannot write .*file/log: File exists"):
            group.start("node", python(""), tmp_path / "file" / "log")
        start_ready(group, tmp_path, "node", OBEDIENT)
        with pytest.raises(AbraceError, match="a process of that name"):
            group.start("node", python(""), tmp_path / "log")


# a program that runs a group of children and never leaves the block by itself
OWNER = f"""
import sys, time
from pathlib import Path
from abrace.processes.group import ProcessGroup, terminate_as_exception
with terminate_as_exception(), ProcessGroup(grace=float(sys.argv[2])) as group:
    for name, code in {CHILDREN!r}.items():
        node = group.start(name, [sys.executable, "-c", code], Path(sys.argv[1]) / name)
        print(node.group, flush=True)
    time.sleep(300)
"""


@contextlib.contextmanager
def owner(folder: Path, grace: float):
    """An owner with its children ready, and their process groups."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    argv = [*python(OWNER), str(folder), str(grace)]
    process = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    groups: list[int] = []
    try:
        assert process.stdout is not None
        groups += [int(process.stdout.readline()) for _ in CHILDREN]
        for name in CHILDREN:
            until(lambda name=name: "ready" in (folder / name).read_text(), f"{name} to be ready")
        yield process, groups
    finally:
        process.kill()
        process.communicate()
        for group in groups:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(group, signal.SIGKILL)


@pytest.mark.parametrize(
    ("number", "returncode"),
    [(signal.SIGINT, -signal.SIGINT), (signal.SIGTERM, 128 + signal.SIGTERM), (signal.SIGHUP, 128 + signal.SIGHUP)],
)
def test_a_signal_to_the_owner_ends_all(tmp_path, number, returncode):
    with owner(tmp_path, grace=0.5) as (process, groups):
        process.send_signal(number)
        assert process.wait(PATIENCE) == returncode
        assert [group for group in groups if is_running(group)] == []
    assert "closed" in (tmp_path / "obedient").read_text(), "the obedient child had its time to close"


def test_a_second_interruption_kills_at_once(tmp_path):
    with owner(tmp_path, grace=1000.0) as (process, groups):
        process.send_signal(signal.SIGINT)
        until(lambda: "KeyboardInterrupt" in (tmp_path / "grandparent").read_text(), "the stop to be under way")
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == -signal.SIGINT, "long before the grace of 1000 s"
        assert [group for group in groups if is_running(group)] == []


def test_kill_9_of_the_owner_leaves_nothing(tmp_path):
    with owner(tmp_path, grace=0.5) as (process, groups):
        process.kill()
        process.wait()
        until(lambda: not any(is_running(group) for group in groups), "the guard to end the children")
    assert "closed" in (tmp_path / "obedient").read_text(), "the obedient child had its time to close"


def test_sighup_stays_ignored_where_it_was():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with terminating():
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            with pytest.raises(Terminated) as raised:
                os.kill(os.getpid(), signal.SIGTERM)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert raised.value.code == 143
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def add_executable(prefix: Path, package: str, name: str) -> Path:
    marker = prefix / "share" / "ament_index" / "resource_index" / "packages" / package
    path = prefix / "lib" / package / name
    for file in (marker, path):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    path.chmod(0o755)
    return path


def test_an_executable_is_found_under_the_first_prefix_that_has_it(tmp_path, monkeypatch):
    second = add_executable(tmp_path / "2", "abrace_plant", "plant")
    add_executable(tmp_path / "3", "abrace_plant", "plant")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / '1'}:{tmp_path / '2'}:{tmp_path / '3'}")
    assert find_executable("abrace_plant", "plant") == second


def test_a_missing_executable_is_answered_with_those_that_are_there(tmp_path, monkeypatch):
    for package, name in (("abrace_plant", "plant"), ("abrace_plant", "record"), ("abrace_lqg", "design")):
        add_executable(tmp_path, package, name)
    add_executable(tmp_path, "abrace_empty", "notes").chmod(0o644)
    (tmp_path / "lib" / "python3.12").mkdir()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with pytest.raises(
        AbraceError, match="abrace_plant has no executable 'plan', expected one of plant, record, did you mean plant"
    ):
        find_executable("abrace_plant", "plan")
    with pytest.raises(
        AbraceError,
        match=r"no package 'abrace_pland'.* expected one of abrace_lqg, abrace_plant, did you mean abrace_plant",
    ):
        find_executable("abrace_pland", "plant")
    with pytest.raises(AbraceError, match="abrace_empty has no executables, expected 'notes'"):
        find_executable("abrace_empty", "notes")
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    with pytest.raises(AbraceError, match="AMENT_PREFIX_PATH is not set"):
        find_executable("abrace_plant", "plant")


def test_parameters_keep_their_types_in_the_file(tmp_path):
    parameters = {
        "flag": True,
        "count": 3,
        "rate": 500.0,
        "small": 1e-05,
        "large": -1e20,
        "third": 1 / 3,
        "name": "on",
        "number_as_text": "1e5",
        "path": 'C:\\a "b": {c}\n# é\u2028',
        "empty": "",
        "flags": [True, False],
        "counts": [1, 2],
        "gains": [1.0, 2, -3e-7],
        "names": ["a", "1"],
    }
    written = parameter_file(tmp_path / "made" / "node.yaml", parameters)
    read = yaml.safe_load(written.read_text())["/**"]["ros__parameters"]
    assert read == parameters
    assert {name: type(value) for name, value in read.items()} == {k: type(v) for k, v in parameters.items()}
    assert [type(value) for value in read["gains"]] == [float, float, float]
    text = written.read_text()
    assert '"rate": 500.0\n' in text
    assert '"small": 1.0e-05\n' in text
    assert '"gains": [1.0, 2.0, -3.0e-07]\n' in text


@pytest.mark.parametrize(
    "value", [float("nan"), float("inf"), None, [], [1, "a"], [True, 1], [True, 1.0], [[1]], {"a": 1}, 2**63, [None]]
)
def test_a_parameter_without_a_ros_type_is_refused(tmp_path, value):
    with pytest.raises(AbraceError, match=r"parameter gain: .*expected a bool"):
        parameter_file(tmp_path / "node.yaml", {"fine": 1, "gain": value})
    assert list(tmp_path.iterdir()) == []

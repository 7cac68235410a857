# SPDX-License-Identifier: Apache-2.0
"""The runner of the stages: what it finds in invented tests that pass, fail, fail once, hang, or end pytest."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
from outcomes import Report, read_quarantine
from processes import MARK
from source_tree import ROOT
from stage_runner import Runner
from stages import STAGES, STEPS, PytestStage, Stage

PYTEST = (sys.executable, "-m", "pytest")
ONCE = """import os
from pathlib import Path
ran = Path(__file__ + ".ran")
first = not ran.exists()
ran.touch()
"""
"""First lines of a file that does something else in its first run."""


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs invented tests as a stage: by the name of the file its content."""
    monkeypatch.chdir(tmp_path)

    def run_files(files: dict[str, str], *whole: str, limit: float = 100.0, quarantine=None, minutes=80.0) -> Report:
        Path("pytest.ini").write_text("[pytest]\naddopts = -p no:cacheprovider\n")
        for name, content in files.items():
            Path(name).write_text(textwrap.dedent(content))
        Path("out").mkdir(exist_ok=True)
        stage = PytestStage("invented", PYTEST, limit, 2, {"PYTHONDONTWRITEBYTECODE": "1"}, whole)
        return report([[[stage]]], quarantine or {}, minutes)

    return run_files


def report(steps: list[list[list[Stage]]], quarantine: dict[str, str], minutes: float = 80.0) -> Report:
    runner = Runner(Path("out"), quarantine, 60.0 * minutes)
    runner.run(steps)
    found = Report()
    for stage in (stage for step in steps for row in step for stage in row):
        found.add(stage.name, runner.seconds[stage.name], runner.outcomes[stage.name], quarantine)
    return found


@pytest.mark.parametrize("workers", [(), ("--numprocesses", "2", "--dist", "loadfile")])
def test_one_run_tells_everything_that_is_wrong(run, workers):
    """With workers as without: a file that cannot be imported keeps no other from being run."""
    found = run(
        {
            "test_well.py": "def test_a(): pass\ndef test_b(): pass\n",
            "test_wrong.py": "def test_well(): pass\ndef test_wrong():\n\n    assert 3 == 4, 'of the sum'\n",
            "test_broken.py": "import nothing_of_this_name\ndef test_a(): pass\n",
            "test_skipped.py": """
                import pytest
                def test_a(): pytest.skip("no browser")
                def test_b(): pytest.skip("no browser")
            """,
        },
        *workers,
    )
    assert found.passed == 3
    assert {name: why.splitlines()[0] for name, why in found.failed.items()} == {
        "test_broken.py": found.failed["test_broken.py"].splitlines()[0],
        "test_wrong.py::test_wrong": "test_wrong.py:4: AssertionError: of the sum",
    }
    assert "nothing_of_this_name" in found.failed["test_broken.py"]
    assert (found.unsteady, found.skipped) == ({}, {"no browser": 2})
    text = found.text(strict=False).splitlines()
    assert text[1].split()[:1] + text[1].split()[2:] == ["invented", "3", "2", "0", "2"]
    assert "failed: test_wrong.py::test_wrong" in text
    assert text[-1] == "3 passed, 2 failed"


def test_what_passes_alone_is_unsteady_and_a_failure_only_where_that_is_asked_for(run):
    found = run({"test_once.py": ONCE + "def test_a(): assert not first, 'at first'\ndef test_b(): pass\n"})
    assert found.failed == {}
    assert found.unsteady == {"test_once.py::test_a": "test_once.py:6: AssertionError: at first\nassert not True"}
    assert found.text(strict=False).splitlines()[-1] == "2 passed, 0 failed"
    assert found.text(strict=True).splitlines()[-1] == "1 passed, 1 failed"
    assert json.loads(found.json())["unsteady"] == found.unsteady


def test_what_fails_is_run_again_twice_by_itself(run):
    """A test beside others fails; alone, in its whole file, it is tried twice more and no more."""
    count = "import pathlib\ndef test_a():\n    with open('runs', 'a') as runs: runs.write('x')\n    "
    found = run(
        {
            "test_a.py": count + "assert len(pathlib.Path('runs').read_text()) == 3\n",
            "test_b.py": "def test_b(): pass\n",
        }
    )
    assert (found.failed, list(found.unsteady)) == ({}, ["test_a.py::test_a"])
    Path("runs").unlink()
    found = run({"test_a.py": count + "assert len(pathlib.Path('runs').read_text()) == 4\n"})
    assert (list(found.failed), found.unsteady) == (["test_a.py::test_a"], {})
    assert Path("runs").read_text() == "xxx"


def test_what_fails_only_when_it_is_run_again_is_unsteady_too(run):
    found = run({"test_once.py": ONCE + "def test_a(): assert not first\ndef test_b(): assert first\n"})
    assert (found.failed, sorted(found.unsteady)) == ({}, ["test_once.py::test_a", "test_once.py::test_b"])


def test_a_test_that_cannot_be_taken_down_has_failed(run):
    found = run(
        {"test_a.py": "import pytest\n@pytest.fixture\ndef rig():\n    yield\n    1 / 0\ndef test_a(rig): pass\n"}
    )
    assert (found.passed, list(found.failed)) == (0, ["test_a.py::test_a"])


def test_pytest_that_ends_by_itself_is_run_again_once(run):
    found = run({"test_once.py": ONCE + "def test_a():\n    if first: os._exit(7)\n"})
    assert (found.passed, found.failed) == (2, {})
    assert found.unsteady["pytest of stage invented"].startswith("exit code 7")
    found = run({"test_end.py": "import os\ndef test_a(): pass\ndef test_b(): os._exit(7)\n"})
    assert list(found.failed) == ["pytest of stage invented"], "test_a is known to have passed"


def test_a_worker_that_is_lost_fails_its_test_and_the_file_is_run_again(run):
    content = """
        import os
        from pathlib import Path
        def test_a():
            if not Path("ran").exists():
                Path("ran").touch()
                os._exit(7)
    """
    files = {"test_once.py": content, "test_b.py": "def test_b(): pass\n"}
    found = run(files, "--numprocesses", "2", "--dist", "loadfile")
    assert found.failed == {}
    assert "crashed" in found.unsteady["test_once.py::test_a"]


def test_no_test_at_all_is_a_failure(run):
    assert "exit code 5" in run({"test_none.py": "x = 1\n"}).failed["pytest of stage invented"]


def test_of_what_hangs_the_stacks_are_written_and_the_whole_has_an_end(run, capfd):
    content = """
        import time
        def test_a(): pass
        def test_that_hangs(): the_wait()
        def the_wait(): time.sleep(1000)
    """
    start = time.monotonic()
    found = run({"test_hang.py": content}, limit=5.0)
    assert time.monotonic() - start < 60.0
    assert found.failed["pytest of stage invented"].startswith("not done after 5 s")
    assert found.passed == 1
    assert "in the_wait" in capfd.readouterr().out


def test_after_the_longest_time_nothing_more_is_run_and_what_is_known_is_said(run):
    content = "import time\ndef test_a(): time.sleep(3)\ndef test_b(): assert 0\n"
    found = run({"test_a.py": content}, minutes=2.0 / 60)
    assert any("not done after 2 s" in why or "minutes are over" in why for why in found.failed.values())
    assert found.seconds["invented"] < 60


def test_a_test_in_quarantine_is_named_and_decides_nothing(run):
    files = {"test_q.py": "def test_a(): assert 0, 'as always'\ndef test_b(): pass\n"}
    quarantine = {"test_q.py::test_a": "by the clock", "test_q.py::test_b": "it was"}
    found = run(files, quarantine=quarantine)
    assert (found.passed, found.failed, found.unsteady) == (0, {}, {})
    assert found.quarantine == {
        "test_q.py::test_a": "test_q.py:1: AssertionError: as always (in quarantine: by the clock)",
        "test_q.py::test_b": "passed (in quarantine: it was)",
    }


def test_a_quarantine_without_a_reason_without_its_test_or_of_eleven_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("test_a.py").touch()
    file = tmp_path / "quarantine.txt"
    file.write_text("# none\n\ntest_a.py::test_a: by the clock\n")
    assert read_quarantine(file) == {"test_a.py::test_a": "by the clock"}
    for text, message in (
        ("test_a.py::test_a\n", "expected TEST: REASON"),
        ("test_b.py::test_a: by the clock\n", "test_b.py::test_a: no such file"),
        ("".join(f"test_a.py::test_{number}: slow\n" for number in range(11)), "11 tests, expected 10 at most"),
    ):
        file.write_text(text)
        with pytest.raises(ValueError, match=message):
            read_quarantine(file)


def test_a_command_is_run_again_once_and_its_last_lines_are_shown(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("out").mkdir()

    def command(name: str, script: str) -> Stage:
        return Stage(name, ("bash", "-c", script), 20.0)

    found = report(
        [
            [[command("once", "[ -f there ] || { touch there; exit 3; }")]],
            [[command("never", "echo what is wrong; exit 4")], [command("well", "echo well")]],
        ],
        {},
    )
    assert found.unsteady == {"once": "exit code 3\n"}
    assert found.failed["never"].splitlines() == ["exit code 4", "what is wrong"]
    assert found.passed == 2
    assert "    what is wrong" in found.text(strict=False).splitlines()


def test_a_process_that_outlives_its_stage_is_named_and_killed(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    Path("out").mkdir()
    report([[[Stage("leaves", ("bash", "-c", "setsid sleep 1234 & echo $! > number"), 20.0)]]], {})
    assert "did not end with stage leaves, killed: sleep 1234" in capfd.readouterr().out
    assert not Path(f"/proc/{Path('number').read_text().strip()}/exe").exists()


def test_a_process_of_an_earlier_run_is_named(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    ended = subprocess.Popen(["true"])
    ended.wait()
    with subprocess.Popen(["sleep", "1234"], env={**os.environ, MARK: f"{ended.pid}:graph"}) as left:
        report([], {})
        left.kill()
    said = capfd.readouterr().out
    assert f"process {left.pid} is left over from stage graph of an earlier run: sleep 1234" in said


INTERRUPTED = """
import sys
from pathlib import Path
sys.path[:0] = [sys.argv[1]]
from processes import stop_when_asked
from stage_runner import Runner
from stages import Stage
stop_when_asked()
runner = Runner(Path("."))
runner.run([[[Stage(name, ("bash", "-c", "echo runs; exec sleep 1234"), 2000.0)]] for name in ("first", "second")])
print(*(line for found in runner.outcomes.values() for line in found.failed().items()))
"""


def test_an_interrupted_run_says_what_is_known(tmp_path):
    command = [sys.executable, "-c", INTERRUPTED, str(ROOT / "tests/runner")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert [process.stdout.readline() for _ in range(2)] == ["abrace: first begins\n", "runs\n"]
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=60)[0]
    assert said.splitlines()[-1] == "('first', 'interrupted\\nruns') ('second', 'not run: interrupted\\n')"


def test_every_stage_stands_in_one_step():
    assert sorted(name for step in STEPS for row in step for name in row) == sorted(STAGES)


def test_an_unknown_stage_is_refused():
    command = [sys.executable, str(ROOT / "tests/runner"), "grahp"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert "no stage grahp, expected some of: demo, pip" in done.stderr

# SPDX-License-Identifier: Apache-2.0
"""The entry point of the nodes' executables."""

import subprocess
import sys
from pathlib import Path

import pytest


def ended(folder: Path, module: str) -> subprocess.CompletedProcess:
    """Run the executable lib/some_package/node, whose module is this text."""
    (folder / "some_package/nodes").mkdir(parents=True)
    (folder / "some_package/nodes/node.py").write_text(module)
    executable = folder / "lib/some_package/node"
    executable.parent.mkdir(parents=True)
    executable.write_text(
        f"import sys\nsys.path.insert(0, {str(folder)!r})\nfrom abrace_node.executable import main\nsys.exit(main())\n"
    )
    return subprocess.run([sys.executable, executable], capture_output=True, text=True, timeout=30, check=False)


def test_an_executable_runs_the_node_of_its_folder_and_name(tmp_path):
    found = ended(tmp_path, "def main():\n    return 3\n")
    assert (found.returncode, found.stderr) == (3, "")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_while_modules_are_imported_ends_it_without_a_word(tmp_path, name):
    found = ended(tmp_path, f"import os, signal\nos.kill(os.getpid(), signal.{name})\nraise RuntimeError\n")
    assert (found.returncode, found.stdout, found.stderr) == (0, "", "")


def test_it_ends_by_what_atexit_has_and_does_not_free_the_modules_objects_one_by_one(tmp_path):
    found = ended(
        tmp_path,
        "import atexit\n"
        "class Freed:\n    def __del__(self):\n        print('freed')\n"
        "freed = Freed()\n"
        "def main():\n    atexit.register(print, 'at exit', end='')\n    return 3\n",
    )
    assert (found.returncode, found.stdout, found.stderr) == (3, "at exit", "")


@pytest.mark.parametrize(
    ("distribution", "said"),
    [("", ""), ("jazzy", ""), ("rolling", "ROS_DISTRO=rolling: abrace was tried with jazzy alone\n")],
)
def test_another_distribution_is_a_warning(tmp_path, monkeypatch, distribution, said):
    monkeypatch.setenv("ROS_DISTRO", distribution)
    found = ended(tmp_path, "def main():\n    return 3\n")
    assert (found.returncode, found.stderr) == (3, said)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "node: HOME is not set, as for a service: set HOME or ROS_LOG_DIR, the folder of ROS's logs\n"),
        ({"HOME": ""}, "node: HOME is not set, as for a service: set HOME or ROS_LOG_DIR, the folder of ROS's logs\n"),
        ({"HOME": "/tmp"}, ""),
        ({"ROS_HOME": "/tmp"}, ""),
        ({"ROS_LOG_DIR": "/tmp"}, ""),
    ],
)
def test_a_service_without_a_folder_for_logs_is_told_which_variable_to_set(tmp_path, monkeypatch, given, said):
    for name in ("HOME", "ROS_HOME", "ROS_LOG_DIR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    found = ended(tmp_path, "def main():\n    return 3\n")
    assert (found.returncode, found.stderr) == ((2, said) if said else (3, ""))

# SPDX-License-Identifier: Apache-2.0
"""The scripts that make and enter the environment, in a folder of their own: what they refuse, in one line."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from source_tree import ROOT

SHELL = {name: os.environ[name] for name in ("HOME", "PATH")}


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with the scripts alone."""
    shutil.copytree(ROOT / "requirements", tmp_path / "requirements")
    for folder in ("src", "ros2_ws"):
        (tmp_path / folder).mkdir()
    for name in ("ros2_ws/setup.bash", "Makefile"):
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def installed(checkout: Path, ros: str) -> None:
    """As if `make setup` had been done with this ROS 2 sourced, or with none."""
    (checkout / ".venv/bin").mkdir(parents=True)
    (checkout / ".venv/bin/activate").touch()
    (checkout / ".venv/.installed").write_text(ros + "\n")
    (checkout / "ros2_ws/install").mkdir()
    (checkout / "ros2_ws/install/local_setup.bash").touch()
    (checkout / "ros2_ws/install/.built").touch()


def bash(checkout: Path, command: str, **variables: str) -> tuple[int, str, str]:
    """Exit code, standard output and errors of a command in a new shell."""
    ran = subprocess.run(
        ["bash", "-c", command], cwd=checkout, env=SHELL | variables, capture_output=True, text=True, check=False
    )
    return ran.returncode, ran.stdout, ran.stderr


SOURCE = "source ros2_ws/setup.bash && echo entered"
NOT_SOURCED = (
    "abrace: built with the installed ROS 2 Jazzy, which is not sourced in this shell: "
    "source /opt/ros/jazzy/setup.bash first\n"
)
SOURCED = (
    "abrace: built with ROS 2 as wheels, but ROS 2 Jazzy is sourced in this shell: "
    "use a shell without it, or build on it with 'make clean setup'\n"
)


@pytest.mark.parametrize("shell", [{}, {"ROS_DISTRO": "jazzy"}])
def test_the_environment_is_entered_with_the_ros_2_that_it_was_built_with(checkout, shell):
    assert bash(checkout, SOURCE, **shell) == (1, "", "abrace: not built yet; run 'make setup' first\n")
    installed(checkout, shell.get("ROS_DISTRO", ""))
    assert bash(checkout, SOURCE, **shell) == (0, "entered\n", "")


@pytest.mark.parametrize(
    ("ros", "shell", "message"), [("jazzy", {}, NOT_SOURCED), ("", {"ROS_DISTRO": "jazzy"}, SOURCED)]
)
def test_another_ros_2_is_refused_in_one_line_and_nothing_is_made_anew(checkout, ros, shell, message):
    installed(checkout, ros)
    assert bash(checkout, SOURCE, **shell) == (1, "", message)
    code, _, errors = bash(checkout, "make setup", **shell)
    assert code != 0
    assert message in errors
    assert (checkout / ".venv/.installed").read_text() == ros + "\n"


def test_an_environment_that_was_not_finished_is_not_entered(checkout):
    installed(checkout, "")
    (checkout / ".venv/.installed").unlink()
    assert bash(checkout, SOURCE) == (1, "", "abrace: not built yet; run 'make setup' first\n")


@pytest.mark.parametrize(
    ("refused", "shell", "message"),
    [
        ("pass", {}, "does not run; Python 3.11 or newer is needed"),
        ("version_info", {}, "is too old; Python 3.11 or newer is needed"),
        ("ensurepip", {}, "has no venv module; install it (Debian and Ubuntu: python3-venv)"),
        ("ctypes", {}, "was built without its module ctypes; use another Python (PYTHON=/usr/bin/python3 make setup)"),
        ("Python.h", {}, "has no C headers; install them (Debian and Ubuntu: python3-dev)"),
        ("nothing", {"ROS_DISTRO": "humble"}, "ROS 2 humble is sourced; abrace needs ROS 2 Jazzy"),
        ("rclpy", {"ROS_DISTRO": "jazzy"}, "cannot import the sourced ROS 2's rclpy; use the Python that it is for"),
    ],
)
def test_a_python_that_lacks_something_is_refused_in_one_line_before_anything_is_removed(
    checkout, refused, shell, message
):
    (checkout / ".venv").mkdir()
    python = checkout / "python"
    python.write_text(f'#!/bin/sh\ncase "$*" in *{refused}*) exit 1 ;; esac\nexec {sys.executable} "$@"\n')
    python.chmod(0o755)
    if refused == "rclpy":
        shell = shell | {"PYTHONPATH": str(checkout)}
        (checkout / "numpy.py").write_text("raise ImportError\n")
    code, output, errors = bash(checkout, "requirements/install.sh", PYTHON=str(python), **shell)
    assert (code, output) == (1, "")
    assert errors.startswith("abrace: ")
    assert message in errors
    assert errors.count("\n") == 1
    assert (checkout / ".venv").is_dir()


def test_no_python_at_all_is_refused_in_one_line(checkout):
    expected = "abrace: no python4 was found; Python 3.11 or newer is needed\n"
    assert bash(checkout, "requirements/install.sh", PYTHON="python4") == (1, "", expected)

# SPDX-License-Identifier: Apache-2.0
"""`abrace bag`: writes what it says, and says in one line what is wrong."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

from abrace.cli import main
from abrace_bags import Bag, BagWriter
from abrace_bags.figure import bag_figure
from abrace_bags.mcap.attachments import file_attachments

if TYPE_CHECKING:
    from pathlib import Path

HEADER = "std_msgs/Header header"
STAMP = "builtin_interfaces/Time stamp\nstring frame_id\n"
TIME = "int32 sec\nuint32 nanosec\n"
NESTED = "".join(
    f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in (("std_msgs/Header", STAMP), ("builtin_interfaces/Time", TIME))
)
DEFINITION = f"{HEADER}\nuint64 sequence\nfloat64 force\n{NESTED}"
PREFIX = b"\0\1\0\0" + np.array([0, 0, 4], "<u4").tobytes() + b"rig\0"
"""Of every message: encapsulation and header."""


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    (tmp_path / "lqg3.yaml").write_text("storeys: 3\n")
    attached = file_attachments([tmp_path / "lqg3.yaml"])
    with BagWriter(tmp_path / "bag", {"rig": "ncree"}, attachments=attached) as bag:
        topic = bag.add_topic("/force", "test_msgs/msg/Force", DEFINITION, "")
        for k in (0, 1, 2, 5):
            bag.write(topic, PREFIX + np.uint64(k).tobytes() + np.float64(k / 3).tobytes(), 10**9 * k, 10**9 * k)
    return tmp_path / "bag"


def test_info_tells_topics_gaps_and_facts(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", "info", str(bag)]) == 0
    lines = capsys.readouterr().out.splitlines()
    (row,) = (line.split() for line in lines if line.startswith("/force"))
    assert row == ["/force", "test_msgs/msg/Force", "4", "0.60", "0", "1", "2", "0"]
    assert "rig: ncree" in lines
    assert "attachment lqg3.yaml: 11 bytes" in lines
    assert any(line.startswith("5.000 s from 1970-01-01") for line in lines)


def test_info_of_a_cut_off_bag_warns(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = bag / "bag_0.mcap"
    path.write_bytes(path.read_bytes()[:-40])
    assert main(["bag", "info", str(bag)]) == 0
    assert "WARNING: " in capsys.readouterr().out


def test_a_part_of_a_bag_and_several_bags_become_a_new_bag(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for out, arguments in (("first", ["--duration", "2"]), ("last", ["force", "--start-offset", "2"])):
        assert main(["bag", "trim", str(bag), str(tmp_path / out), *arguments]) == 0
        assert capsys.readouterr().out == f"wrote {tmp_path / out}: 2 of /force\n"
    whole = tmp_path / "whole"
    assert main(["bag", "merge", str(whole), str(tmp_path / "last"), str(tmp_path / "first")]) == 0
    assert capsys.readouterr().out == f"wrote {whole}: 4 of /force\n"
    assert Bag(whole).arrays()["/force"].fields["sequence"].tolist() == [0, 1, 2, 5]
    assert Bag(whole).facts == {"rig": "ncree"}


def test_a_plot_shows_quantities_and_counters_only_where_there_are_none(bag: Path) -> None:
    topics = Bag(bag).arrays(["/force"])
    (axis,) = bag_figure(topics).axes
    assert axis.get_title(loc="left") == "force"
    assert axis.get_ylabel() == "[N]"
    del topics["/force"].fields["force"]
    assert [axis.get_title(loc="left") for axis in bag_figure(topics).axes] == ["sequence"]


def test_a_reader_who_has_had_enough_is_no_error(bag: Path) -> None:
    program = "import sys; from abrace.cli import main; sys.exit(main())"
    command = f"set -o pipefail; '{sys.executable}' -c '{program}' bag info '{bag}'"
    for end, said in (("| true", b""), ("| head -n 1", b"1 file")):
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
        ran = subprocess.run(["bash", "-c", f"{command} {end}"], capture_output=True, check=False, env=environment)
        assert (ran.returncode, ran.stderr) == (0, b"")
        assert said in ran.stdout


def test_a_terminal_without_a_letter_shows_another(bag: Path, tmp_path: Path) -> None:
    named = bag.rename(tmp_path / "Stäbe")
    program = "import sys; from abrace.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", program, "bag", "info", str(named)]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    ran = subprocess.run(command, capture_output=True, check=False, env=environment)
    assert (ran.returncode, ran.stderr) == (0, b"")
    assert b"St?be: 1 file" in ran.stdout


@pytest.mark.parametrize(
    ("action", "topics", "begin"),
    [("csv", ["force"], b"log_time"), ("mat", [], b"MATLAB 5.0"), ("plot", ["/force"], b"\x89PNG")],
)
def test_file_is_written(bag: Path, tmp_path: Path, action: str, topics: list[str], begin: bytes) -> None:
    output = tmp_path / "new/file"
    assert main(["bag", action, str(bag), *topics, "--output", str(output)]) == 0
    assert output.read_bytes().startswith(begin)


def test_topic_whose_name_has_no_slash_is_found(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", {}) as bag:
        for name in ("imu", "/force"):
            topic = bag.add_topic(name, "test_msgs/msg/Force", DEFINITION, "")
            bag.write(topic, PREFIX + bytes(16), 1, 1)
    for name in ("imu", "force", "/force"):
        assert main(["bag", "csv", str(tmp_path / "bag"), name, "--output", str(tmp_path / "out.csv")]) == 0
    assert main(["bag", "csv", str(tmp_path / "bag"), "/imu", "--output", str(tmp_path / "out.csv")]) == 2


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["csv", "{bag}", "/other", "--output", "x"], "no topic /other in it, expected one of /force"),
        (["info", "{bag}x"], "no such bag"),
        (["info", "n" * 5000], "File name too long"),
        (["mat", "{bag}", "--output", "{bag}/bag_0.mcap/x"], "cannot write"),
        (["csv", "{bag}", "force", "--output", "/"], "cannot write /"),
        (["mat", "{bag}", "--output", ""], "cannot write ."),
        (["csv", "{bag}", "force", "--start-offset", "900", "--output", "x"], "no message from 900 s to the end"),
        (["trim", "{bag}", "{bag}x", "--duration", "-1"], "--duration: -1.0, expected seconds from 0 on"),
        (["merge", "{bag}x", "{bag}", "{bag}"], "bag is named twice"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(
    bag: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], complaint: str
) -> None:
    assert main(["bag", *(argument.format(bag=bag) for argument in arguments)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("abrace: ")
    assert complaint in line

# SPDX-License-Identifier: Apache-2.0
"""Tutorials without nodes, followed in a second; all of them, whole, by `make verify PARTS=docs`."""

import subprocess
import sys

import pytest
from tutorials import SET_UP, lines, python, second_terminal, shown_lines, write_files

from abrace.campaign.file import load_campaign


def run(folder, *words: str) -> str:
    ended = subprocess.run([sys.executable, *words], cwd=folder, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_your_own_record_is_played_as_the_page_says(tmp_path):
    assert write_files("own_record", tmp_path) == ["make_record.py", "my_records.yaml", "treatment.yaml"]
    run(tmp_path, "make_record.py")
    moved = "assert 0.39 < run.to_pandas()['w'].abs().max() < 0.41, 'the peak that was asked for'"
    refused = (
        "try: abrace.simulate('ncree_three_storey', 'quake.csv')\n"
        "except abrace.AbraceError as error: assert 'exceeds the table' in str(error)\n"
        "else: raise AssertionError('its offset carries the table away')"
    )
    run(tmp_path, "-c", "\n".join([python("own_record"), moved, refused]))
    assert [step.name for step in load_campaign(tmp_path / "my_records.yaml").steps] == ["half", "whole"]


def test_a_device_of_ones_own_gives_readings_as_the_page_says(tmp_path):
    assert write_files("own_device", tmp_path) == ["my_daq.py"]
    run(tmp_path, "-c", python("own_device") + "\nassert reading.values[7:9].tolist() == [1000.0, 1000.0]")


@pytest.mark.parametrize("name", ["ten_minutes", "paper", "first_building", "own_record"])
def test_no_line_of_a_tutorial_is_left_out_for_its_form(name):
    """Each line is run, prepares the terminal, or belongs to a second terminal; a line of another form is found."""
    left = set(shown_lines(name)) - set(lines(name)) - set(second_terminal(name)) - set(SET_UP)
    assert len(lines(name)) > 1
    assert not left, f"{name}: no test runs {sorted(left)}"

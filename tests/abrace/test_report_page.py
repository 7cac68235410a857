# SPDX-License-Identifier: Apache-2.0
"""The report's page, as a browser shows and prints it; skipped where there is no Chromium."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml
from browser import CHROMIUM, open_page, printed_pages
from identification_speed import write_bag
from matplotlib.figure import Figure

from abrace.cli import main
from abrace.report.against import compare_campaigns
from abrace.report.writer import make_report
from abrace_core.drawing import captioned, save_figure
from abrace_core.errors import AbraceError
from abrace_core.node import find_file
from abrace_core.run import Run

if TYPE_CHECKING:
    from pathlib import Path

SAMPLES = 3000


def campaign(folder: Path, rig: str, size: float = 1.0) -> Path:
    """Results of a campaign without identification: one test of which there is a bag, and a figure of a step."""
    rig_file = find_file(rig, "abrace_plant", "config", ".yaml", "rig").read_text()
    floors = len(yaml.safe_load(rig_file)["building"]["masses"])
    groups = len(yaml.safe_load(rig_file)["braces"])
    noise = size * np.random.default_rng(1).standard_normal((SAMPLES, 2 * floors + 3 * groups + 1))
    outputs, ground, command = np.split(noise, [2 * (floors + groups), 2 * (floors + groups) + 1], axis=1)
    numbers = np.arange(SAMPLES, dtype=np.uint64)
    run = Run("shaken", 0.002, numbers, floors, groups, outputs, ground[:, 0], command)
    motion = {"record": "el_centro", "peak_acceleration": 0.98}
    more = {"rig_file": rig_file, "ground_motion": json.dumps(motion), "controller": "own_law"}
    write_bag(folder / "bags" / "shaken", run, rig, more)
    results = folder / "results" / folder.name
    (results / "nodes").mkdir(parents=True)
    parameters = {"/**": {"ros__parameters": {"output": "bags/shaken"}}}
    (results / "nodes" / "shaken_logger.yaml").write_text(yaml.dump(parameters))
    steps = [{"name": "shaken", "wall_seconds": 6.0 * size, "samples": SAMPLES, "run_seconds": 5.0}]
    timing = {"lockstep": True, "sample_rate": 500.0, "steps": steps}
    (results / "timing.json").write_text(json.dumps(timing))
    figure = Figure()
    figure.subplots().semilogy(np.arange(1.0, 9.0), label=r"$\ddot{x}_{1a}$")
    save_figure(captioned(figure, "Rising & rising."), results / "shaken" / "rise.png")
    return results


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    results = campaign(tmp_path_factory.mktemp("reported") / "day", "ncree_three_storey")
    make_report(results)
    return results


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
def test_a_browser_draws_every_figure_without_an_error_and_prints_the_page(reported: Path, tmp_path: Path) -> None:
    opened = open_page(reported / "report.html")
    assert opened.console == []
    assert len(opened.drawn) == 4, "rig, motion, responses, and the figure of the step"
    assert all(opened.drawn.values()), f"expected curves in each: {opened.drawn}"
    assert 'data-drawn="4"' in opened.content
    assert printed_pages(reported / "report.html", tmp_path / "report.pdf") >= 2


def test_a_campaign_without_identification_has_rig_tests_spectra_and_how_to_make_it_again(reported: Path) -> None:
    text, markdown = ((reported / name).read_text() for name in ("report.html", "report.md"))
    for told in ("The rig", "Tests", "Records and spectra", "Clipped, lost, late", "How to make it again"):
        assert f"<h2>{told}</h2>" in text
        assert f"## {told}\n" in markdown
    assert "Rising &amp; rising." in text
    assert "*Rising & rising.*" in markdown
    assert "el_centro at 0.0999 g" in text
    assert "<td>own_law</td>" in text, "a controller of the user's own needs no model"
    assert "peak a3 [g]" in text
    assert not text.count("https://") - text.count("https://github.com"), "the page needs nothing else"
    assert len(text) < 5e6


def test_the_papers_numbers_and_units_stand_beside_its_rig_alone(tmp_path: Path) -> None:
    results = campaign(tmp_path / "day", "five_storey")
    make_report(results)
    markdown = (results / "report.md").read_text()
    assert "peak x5 [mm]" in markdown
    assert "kgf" not in markdown
    assert "the paper" not in markdown


def test_the_building_moves_without_and_with_control_side_by_side(
    reported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, path = str(reported.parent.parent / "bags" / "shaken"), tmp_path / "both.gif"
    arguments = ["bag", "animate", bag, "--against", bag, "--start-offset", "1", "--duration", "0.4"]
    assert main([*arguments, "--exaggeration", "0.5", "--output", str(path)]) == 0
    assert "displacements 0.5 times as large" in capsys.readouterr().out
    content = path.read_bytes()
    assert content.startswith(b"GIF89a")
    frames = content.split(b"\x21\xf9\x04")[1:]
    assert len(frames) == 6
    assert min(map(len, frames)) > 100, "expected a building that moves"
    assert main([*arguments, "--output", str(tmp_path / "both.mp4")]) == 2
    assert "both.mp4: expected a name that ends in .gif" in capsys.readouterr().err


def test_two_campaigns_are_set_side_by_side_with_their_differences(tmp_path: Path) -> None:
    monday = campaign(tmp_path / "monday", "ncree_three_storey")
    tuesday = campaign(tmp_path / "tuesday", "ncree_three_storey", 1.5)
    text = compare_campaigns(tuesday, monday)
    (row,) = (line.split() for line in text.splitlines() if line.startswith("shaken"))
    assert row == ["shaken", "9.0", "6.0", "+50.0"]
    assert "Differences: tuesday minus monday." in (tuesday / "against_monday.html").read_text()
    with pytest.raises(AbraceError, match="the same campaign, expected another one"):
        compare_campaigns(monday, monday)

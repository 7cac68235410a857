# SPDX-License-Identifier: Apache-2.0
"""The report's page, as a browser shows and prints it; skipped where there is no Chromium."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml
from bag_of_run import write_bag
from browser import CHROMIUM, open_page, printed_pages
from matplotlib.figure import Figure

from abrace.report.writer import make_report
from abrace_core.figures.drawing import captioned
from abrace_core.figures.saving import save_figure
from abrace_core.files.installed import find_file
from abrace_core.model.run import Run

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
    motion = {"record": "el_centro", "peak_acceleration": 0.98}
    facts = {"sample_period": "0.002", "rig": rig, "rig_file": rig_file, "ground_motion": json.dumps(motion)}
    facts["controller"] = "own_law"
    run = Run("shaken", 0.002, numbers, floors, groups, outputs, ground[:, 0], command, facts)
    write_bag(run, folder / "bags" / "shaken")
    results = folder / "results" / folder.name
    (results / "nodes").mkdir(parents=True)
    parameters = {"/**": {"ros__parameters": {"output": "bags/shaken"}}}
    (results / "nodes" / "shaken_logger.yaml").write_text(yaml.dump(parameters))
    steps = [{"name": "shaken", "wall_seconds": 6.0 * size, "samples": SAMPLES, "run_seconds": 5.0}]
    timing = {"lockstep": True, "sample_rate": 500.0, "steps": steps}
    (results / "timing.json").write_text(json.dumps(timing))
    figure = Figure()
    figure.subplots().semilogy(np.arange(1.0, 9.0), label=r"$\ddot{x}_{1a}$")
    save_figure(captioned(figure, "Rising & rising."), results / "shaken" / "rise.svg")
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
    assert len(opened.drawn) == 3, "rig, responses, and the figure of the step"
    assert all(opened.drawn.values()), f"expected curves in each: {opened.drawn}"
    assert 'data-drawn="3"' in opened.content
    assert printed_pages(reported / "report.html", tmp_path / "report.pdf") >= 2


def test_a_campaign_without_identification_has_rig_tests_spectra_and_how_to_make_it_again(reported: Path) -> None:
    text = (reported / "report.html").read_text()
    for told in ("The rig", "Tests", "Result", "Warnings", "How to make it again"):
        assert f"<h2>{told}</h2>" in text
    assert "Rising &amp; rising." in text
    assert "el_centro at 0.0999 g" in text
    assert "<td>own_law</td>" in text, "a controller of the user's own needs no model"
    assert "peak a3 [g]" in text
    assert not text.count("https://") - text.count("https://github.com"), "the page needs nothing else"
    assert len(text) < 5e6

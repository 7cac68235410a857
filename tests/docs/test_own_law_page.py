# SPDX-License-Identifier: Apache-2.0
"""docs/own_law.md is followed: its law as a node and in Python, its campaigns, and the numbers of its table."""

import importlib
import re
import sys

import numpy as np
import pytest
from documents import ROOT, blocks, commands
from running_graph import graph_of_its_own
from tutorials import page, write_files

import abrace
from abrace.campaign.plan import check_campaign
from abrace.processes.parameter_file import parameter_file
from abrace_core.own_law import GuardedLaw
from abrace_interfaces.msg import BraceCommand, Response

PAGE = page("own_law")
RUN = "run_law(Skyhook)"


@pytest.fixture
def skyhook() -> type:
    """The class that the page shows."""
    (text,) = [block.text for block in blocks(PAGE) if block.name == "my_law.py"]
    assert text.strip().endswith(f"\n{RUN}"), "the last line makes a node of it"
    names = {}
    exec(compile(text.replace(RUN, ""), "my_law.py", "exec"), names)
    return names["Skyhook"]


@pytest.mark.usefixtures("domain")
def test_the_law_of_the_page_is_a_node_that_answers_every_sample(skyhook, tmp_path, monkeypatch):
    assert write_files("own_law", tmp_path) == ["my_law.py"]
    monkeypatch.chdir(tmp_path)
    with graph_of_its_own("/rig") as graph:
        responses, answers = graph.listen(Response, "response"), graph.listen(BraceCommand, "brace_command")
        given = parameter_file(tmp_path / "parameters.yaml", {"damping": 90.0e3})
        command = [sys.executable, "my_law.py", "--ros-args", "-r", "__ns:=/rig", "--params-file", given]
        graph.started["skyhook"] = graph.processes.start("skyhook", command, tmp_path / "skyhook.log")
        graph.start("plant", autostart=False, lockstep=True, wait_for=["brace_command", "ground_motion"], duration=2.0)
        graph.start("ground_motion", record="el_centro", peak_acceleration=0.98)
        assert graph.change_state("plant", "configure")
        graph.until_matched("plant", response=3, brace_command=1, ground_motion=1)
        graph.until_matched("skyhook", response=1, brace_command=2)
        graph.may_end.add("plant")
        assert graph.change_state("plant", "activate")
        assert graph.ended("plant") == 0, graph.output_of("plant")
        graph.until(lambda: len(responses) == len(answers) == 1000, "the last sample")
        assert graph.stop("skyhook") == 0, graph.output_of("skyhook")
    law = GuardedLaw(skyhook(damping=90.0e3), 0.002, 0.5)
    law.begin(3, 1)
    measured = [[*r.displacement, *r.stroke, *r.acceleration, sum(r.force) / 2] for r in responses]
    expected = [law.force(number, z, 0) for number, z in enumerate(measured)]
    np.testing.assert_allclose([list(answer.force) for answer in answers], expected, rtol=1e-12)
    assert np.abs(expected).max() > 1000.0


def test_the_law_of_the_page_is_simulated_as_its_last_section_says(skyhook):
    (code,) = re.findall(r"`(abrace\.simulate\([^`]*\))`", PAGE.read_text())
    run = eval(code, {"abrace": abrace, "Skyhook": skyhook})
    free = abrace.simulate("ncree_three_storey", "el_centro", peak_acceleration=0.98)
    assert run.to_pandas()["x3"].std() < 0.5 * free.to_pandas()["x3"].std()


def test_the_campaigns_of_the_page_are_whole():
    given = [command.split()[-1] for command in commands(PAGE) if command.startswith("abrace campaign ")]
    assert given == ["examples/skyhook/campaign.yaml", "examples/sliding_mode/campaign.yaml"]
    for name in given:
        assert check_campaign(ROOT / name).text()


def test_the_table_compares_the_laws_as_they_are():
    """Each number to the digit that is shown: the simulation is the lockstep test's, which is the same each time."""
    motion = {"record": "el_centro", "peak_acceleration": 0.98, "duration": 40.0}
    free = abrace.simulate("ncree_three_storey", **motion).to_pandas()
    for name, law in (("skyhook", "Skyhook"), ("sliding_mode", "SlidingMode")):
        made = getattr(importlib.import_module(f"{name}.{name}"), law)()
        run = abrace.simulate("ncree_three_storey", **motion, controller=made).to_pandas()
        rms = [100 * run[each].std() / free[each].std() for each in ("x1", "x3", "a1", "a3")]
        peaks = [100 * run[each].abs().max() / free[each].abs().max() for each in ("x3", "a3")]
        force = [1e-3 * run["U"].abs().max(), 1e-3 * run["U"].std()]
        (row,) = re.findall(rf"^\| `{name}`, .*", PAGE.read_text(), re.MULTILINE)
        shown = [float(cell.split()[0]) for cell in row.split("|")[2:-1]]
        assert len(shown) == 8
        for found, printed in zip([*rms, *peaks], shown[:6], strict=True):
            assert abs(found - printed) < 0.6, f"{name}: {found:.1f} %, the page has {printed} %"
        np.testing.assert_allclose(force, shown[6:], atol=0.06)


def test_the_row_of_lqg3_is_that_of_the_demo_in_readme():
    def reductions(name: str) -> list[float]:
        (row,) = re.findall(rf"^ +{name} \[c?[mg]\](?: +-?\d+\.\d+){{6}}$", readme, re.MULTILINE)
        peak, rms = row.split()[4], row.split()[7]
        return [float(peak), float(rms)]

    readme = (ROOT / "README.md").read_text().partition("Without and with lqg3")[2]
    (row,) = re.findall(r"^\| \[`lqg3`\].*", PAGE.read_text(), re.MULTILINE)
    shown = [float(cell.split()[0]) for cell in row.split("|")[2:8]]
    rms = [100 - reductions(name)[1] for name in ("x1", "x3", "a1", "a3")]
    peaks = [100 - reductions(name)[0] for name in ("x3", "a3")]
    np.testing.assert_allclose(shown, [*rms, *peaks], atol=0.6)

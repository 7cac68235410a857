# SPDX-License-Identifier: Apache-2.0
"""The graphs that launch files start."""

import re
from pathlib import Path

import pytest
import yaml

from abrace.processes.group import find_executable
from abrace_bringup.arguments import read_arguments
from abrace_bringup.graphs import CLOSED_LOOP, IDENTIFICATION, closed_loop, end_of_node, identification
from abrace_core.errors import AbraceError
from abrace_core.installed import find_file

PAGE = Path(__file__).parents[2] / "docs/nodes.md"


def nodes(table, make, folder, **given):
    """The nodes by their executables, of these arguments and the defaults of the others."""
    texts = {argument.name: argument.default for argument in table} | {"bag": str(folder / "bag")} | given
    return {each.executable: each for each in make(read_arguments(table, texts))}


@pytest.fixture
def controller(tmp_path) -> str:
    file = tmp_path / "lqg3.yaml"
    file.write_text("/**:\n  ros__parameters: {name: lqg3}\n")
    return str(file)


def test_the_closed_loop_waits_for_the_supervisor(tmp_path, controller):
    found = nodes(CLOSED_LOOP, closed_loop, tmp_path, controller=controller)
    assert list(found) == ["logger", "controller", "ground_motion", "plant", "supervisor"]
    assert found["plant"].parameters == {"rig": "ncree_three_storey", "autostart": False}
    assert found["controller"].files == (controller,)
    assert found["logger"].parameters["attachments"] == [controller]
    supervision = found["supervisor"].parameters
    assert supervision["inputs"] == ["brace_command=controller", "ground_motion=ground_motion"]
    assert (supervision["signals"], supervision["free_decay"]) == (["ground_motion"], 5.0)


def test_a_control_law_of_ones_own_takes_the_controllers_place(tmp_path):
    found = nodes(CLOSED_LOOP, closed_loop, tmp_path, controller="my_laws/skyhook")
    assert found["skyhook"].package == "my_laws"
    assert found["skyhook"].parameters == {"autostart": True}
    assert found["supervisor"].parameters["inputs"] == ["brace_command=skyhook", "ground_motion=ground_motion"]
    assert not found["logger"].parameters.get("attachments")


def test_a_rig_file_and_the_frame_file_that_it_names_go_into_the_bag(tmp_path):
    rig, frame = tmp_path / "rig.yaml", tmp_path / "frame.yaml"
    for named, expected in (
        (str(frame), [str(rig), str(frame)]),
        ("sac_la_3", [str(rig), str(find_file("sac_la_3", "abrace_plant", "config/frames", ".yaml", "frame"))]),
        (None, [str(rig)]),
        (3, [str(rig)]),
    ):
        frame.write_text("name: checked by the plant\n")
        rig.write_text(yaml.safe_dump({"building": {"frame": named}}))
        found = nodes(IDENTIFICATION, identification, tmp_path, drive="table", rig=str(rig))
        assert found["logger"].parameters["attachments"] == expected, named
    rig.write_text("building: {frame: none.yaml}")
    with pytest.raises(AbraceError, match=r"frame file none\.yaml: no such file"):
        nodes(IDENTIFICATION, identification, tmp_path, drive="table", rig=str(rig))


@pytest.mark.parametrize("drive", ["", "table", "command", "both"])
def test_nodes_exist_and_have_the_parameters_that_they_are_given(tmp_path, controller, drive):
    if drive:
        found = nodes(IDENTIFICATION, identification, tmp_path, drive=drive, parameters=controller)
    else:
        found = nodes(CLOSED_LOOP, closed_loop, tmp_path, controller=controller)
    page = PAGE.read_text()
    for name, setup in found.items():
        assert find_executable(setup.package, name).is_file()
        section = page.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
        assert set(setup.parameters) <= set(re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)), name


def test_the_page_lists_the_arguments_with_their_defaults():
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*?) \|", PAGE.with_name("launch.md").read_text(), re.MULTILINE))
    assert set(rows) == {argument.name for argument in (*CLOSED_LOOP, *IDENTIFICATION)}
    for argument in (*CLOSED_LOOP, *IDENTIFICATION):
        default = "required" if "required" in argument.description else argument.default or "none"
        assert default in rows[argument.name].replace("`", "").split("; "), argument.name


def test_without_a_plant_its_partners_wait(tmp_path, controller):
    found = nodes(CLOSED_LOOP, closed_loop, tmp_path, controller=controller, plant="false")
    assert "plant" not in found
    assert [found[name].parameters["autostart"] for name in ("controller", "ground_motion")] == [False, False]
    assert not found["supervisor"].parameters["plant"]


def test_without_a_record_the_test_goes_on_until_stopped(tmp_path, controller):
    found = nodes(CLOSED_LOOP, closed_loop, tmp_path, controller=controller, record="")
    assert "signals" not in found["supervisor"].parameters


@pytest.mark.parametrize(
    ("drive", "partners"),
    [("table", ["ground_motion"]), ("command", ["excitation"]), ("both", ["ground_motion", "excitation"])],
)
def test_an_identification_test_waits_for_the_signals_that_drive_it(tmp_path, drive, partners):
    found = nodes(IDENTIFICATION, identification, tmp_path, drive=drive, duration="60")
    assert list(found) == ["logger", *partners, "plant", "supervisor"]
    assert found["supervisor"].parameters["signals"] == partners
    assert all(found[name].parameters["duration"] == 60.0 for name in partners)


def test_the_table_is_that_of_the_rig_and_its_noise_does_not_begin_at_0_hz(tmp_path, controller):
    for found in (
        nodes(IDENTIFICATION, identification, tmp_path, drive="table", rig="five_storey"),
        nodes(CLOSED_LOOP, closed_loop, tmp_path, controller=controller, rig="five_storey"),
    ):
        assert found["ground_motion"].parameters["rig"] == found["plant"].parameters["rig"] == "five_storey"
    found = nodes(IDENTIFICATION, identification, tmp_path, drive="table")
    assert found["ground_motion"].parameters["band"] == [0.1, 10.0]


def test_an_identification_test_fits_the_rig(tmp_path):
    found = nodes(IDENTIFICATION, identification, tmp_path, drive="command", rig="five_storey")["excitation"].parameters
    assert (found["force_limit"], found["rms"], found["sample_rate"]) == ([5e4, 1e5], [3500.0, 7000.0], 500.0)
    slow = nodes(CLOSED_LOOP, closed_loop, tmp_path, controller="my_laws/own", rig="sac_la_20")
    assert slow["ground_motion"].parameters["sample_rate"] == 100.0
    given = {"table_rms": "0.1", "table_band": "[0.2, 25.0]", "command_rms": "900,0", "command_band": "0.5,40"}
    found = nodes(IDENTIFICATION, identification, tmp_path, drive="both", rig="five_storey", **given)
    assert [found["ground_motion"].parameters[name] for name in ("rms", "band")] == [0.1, [0.2, 25.0]]
    assert [found["excitation"].parameters[name] for name in ("rms", "band")] == [[900.0, 0.0], [0.5, 40.0]]
    for wrong in ("10,1", "3", "a,b", "1,2,3"):
        with pytest.raises(AbraceError, match=f"table_band:={wrong}, expected two frequencies in Hz"):
            nodes(IDENTIFICATION, identification, tmp_path, drive="table", table_band=wrong)
    with pytest.raises(AbraceError, match=r"rig 'seven': unknown, expected a file .* or one of .*five_storey"):
        nodes(IDENTIFICATION, identification, tmp_path, drive="table", rig="seven")


def test_multisines_do_not_begin_at_0_hz_and_both_have_lines_of_their_own(tmp_path):
    found = nodes(IDENTIFICATION, identification, tmp_path, drive="both")
    assert found["ground_motion"].parameters["record"] == found["excitation"].parameters["signal"] == "multisine"
    assert found["ground_motion"].parameters["band"] == [0.3, 10.0]
    assert found["excitation"].parameters["lines"] == "even"


@pytest.mark.parametrize(
    ("executable", "returncode", "shutting_down", "meaning"),
    [
        ("supervisor", 0, False, ""),
        ("plant", 0, False, ""),
        ("supervisor", 1, False, "supervisor has ended with exit code 1"),
        ("logger", 0, False, "logger has ended with exit code 0"),
        ("logger", 2, False, "logger has ended with exit code 2"),
        ("controller", -9, False, "controller has ended with signal 9"),
        ("logger", 0, True, None),
        ("plant", -2, True, None),
        ("logger", 1, True, "logger has ended with exit code 1"),
        ("plant", -9, True, "plant has ended with signal 9"),
    ],
)
def test_the_end_of_a_node_ends_the_launch_with_a_code_unless_the_test_is_over(
    executable, returncode, shutting_down, meaning
):
    found = end_of_node(executable, returncode, shutting_down)
    assert found == meaning or (meaning and found.startswith(meaning))

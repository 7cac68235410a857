# SPDX-License-Identifier: Apache-2.0
"""The graphs that launch files start."""

from pathlib import Path

import pytest
import write_nodes
import yaml

from abrace.processes.group import find_executable
from abrace_bringup.graphs import CLOSED_LOOP, IDENTIFICATION, end_of_node, has_end
from abrace_core import AbraceError


def nodes(graph, folder, **given):
    """The nodes by their executables, of these arguments and the defaults of the others."""
    return {each.executable: each for each in graph.nodes({"bag": str(folder / "bag")} | given)}


@pytest.fixture
def controller(tmp_path) -> str:
    file = tmp_path / "lqg3.yaml"
    file.write_text("/**:\n  ros__parameters: {name: lqg3}\n")
    return str(file)


def test_the_closed_loop_waits_for_the_supervisor(tmp_path, controller):
    found = nodes(CLOSED_LOOP, tmp_path, controller=controller)
    assert list(found) == ["logger", "controller", "ground_motion", "plant", "supervisor"]
    assert found["plant"].parameters == {"rig": "ncree_three_storey", "autostart": False}
    assert found["controller"].files == (controller,)
    assert found["logger"].parameters["attachments"] == [controller]
    supervision = found["supervisor"].parameters
    assert supervision["inputs"] == ["brace_command=controller", "ground_motion=ground_motion"]
    assert (supervision["signals"], supervision["free_decay"]) == (["ground_motion"], 5.0)


def test_a_control_law_of_ones_own_takes_the_controllers_place(tmp_path):
    found = nodes(CLOSED_LOOP, tmp_path, controller="my_laws/skyhook")
    assert found["skyhook"].package == "my_laws"
    assert found["skyhook"].parameters == {"autostart": True}
    assert found["supervisor"].parameters["inputs"] == ["brace_command=skyhook", "ground_motion=ground_motion"]
    assert not found["logger"].parameters.get("attachments")


def test_a_rig_file_of_ones_own_goes_into_the_bag(tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text("name: checked by the plant\n")
    for name, expected in ((str(rig), [str(rig)]), ("five_storey", [])):
        found = nodes(IDENTIFICATION, tmp_path, drive="table", rig=name)
        assert (found["logger"].parameters.get("attachments") or []) == expected


@pytest.mark.parametrize("drive", ["", "table", "command", "both"])
def test_nodes_exist_and_have_the_parameters_that_they_are_given(tmp_path, controller, drive):
    if drive:
        found = nodes(IDENTIFICATION, tmp_path, drive=drive, parameters=controller)
    else:
        found = nodes(CLOSED_LOOP, tmp_path, controller=controller)
    for name, setup in found.items():
        assert find_executable(setup.package, name).is_file()
        known = {parameter.name for parameter in write_nodes.parameters(setup.package, name)}
        assert set(setup.parameters) <= known, name


def test_names_enclaves_and_further_parameters_are_given_to_every_node(tmp_path, controller):
    Path(controller).with_name("all.yaml").write_text("/**:\n  ros__parameters: {name: other}\n")
    further = str(Path(controller).with_name("all.yaml"))
    found = nodes(CLOSED_LOOP, tmp_path, controller=controller, namespace="lab/rig", enclaves="/e", parameters=further)
    assert {name: each.enclave for name, each in found.items()} == {name: f"/e/{name}" for name in found}
    assert {each.namespace for each in found.values()} == {"/lab/rig"}
    assert found["controller"].files == (controller, further), "the later ones go before"
    assert all(each.files[-1] == further for each in found.values())
    assert found["logger"].parameters["attachments"] == [controller, further]
    assert {each.enclave for each in nodes(CLOSED_LOOP, tmp_path, controller=controller).values()} == {""}


def test_without_a_plant_its_partners_wait(tmp_path, controller):
    found = nodes(CLOSED_LOOP, tmp_path, controller=controller, plant="false")
    assert "plant" not in found
    assert [found[name].parameters["autostart"] for name in ("controller", "ground_motion")] == [False, False]
    assert not found["supervisor"].parameters["plant"]


@pytest.mark.parametrize(
    ("drive", "partners"),
    [("table", ["ground_motion"]), ("command", ["excitation"]), ("both", ["ground_motion", "excitation"])],
)
def test_an_identification_test_waits_for_the_signals_that_drive_it(tmp_path, drive, partners):
    found = nodes(IDENTIFICATION, tmp_path, drive=drive, duration="60")
    assert list(found) == ["logger", *partners, "plant", "supervisor"]
    assert drive != "table" or found["ground_motion"].parameters["band"] == [0.1, 10.0], "not from 0 Hz"
    assert found["supervisor"].parameters["signals"] == partners
    assert all(found[name].parameters["duration"] == 60.0 for name in partners)


def test_numbers_of_a_rig_file_that_carry_their_unit_reach_the_nodes(tmp_path):
    rig = tmp_path / "rig.yaml"
    braces = [{"actuator": {"capacity": "2.5 kN"}}, {"actuator": {"capacity": 1e3}}]
    rig.write_text(yaml.safe_dump({"sample_rate": "0.25 kHz", "braces": braces}))
    for name, limits, rate in ((str(rig), [2500.0, 1000.0], 250.0), ("single_storey", [2500.0], 500.0)):
        found = nodes(IDENTIFICATION, tmp_path, drive="command", rig=name)["excitation"].parameters
        assert (found["force_limit"], found["sample_rate"]) == (limits, rate)


def test_an_identification_test_fits_the_rig(tmp_path):
    found = nodes(IDENTIFICATION, tmp_path, drive="command", rig="five_storey")["excitation"].parameters
    assert (found["force_limit"], found["rms"], found["sample_rate"]) == ([5e4, 1e5], [3500.0, 7000.0], 500.0)
    given = {"table_rms": "0.1", "table_band": "[0.2, 25.0]", "command_rms": "900,0", "command_band": "0.5,40"}
    found = nodes(IDENTIFICATION, tmp_path, drive="both", rig="five_storey", **given)
    assert [found["ground_motion"].parameters[name] for name in ("rms", "band")] == [0.1, [0.2, 25.0]]
    assert [found["excitation"].parameters[name] for name in ("rms", "band")] == [[900.0, 0.0], [0.5, 40.0]]
    for wrong in ("10,1", "3", "a,b", "1,2,3"):
        with pytest.raises(AbraceError, match=f"table_band:={wrong}, expected two frequencies in Hz"):
            nodes(IDENTIFICATION, tmp_path, drive="table", table_band=wrong)
    with pytest.raises(AbraceError, match=r"rig 'seven': unknown, expected a file .* or one of .*five_storey"):
        nodes(IDENTIFICATION, tmp_path, drive="table", rig="seven")


def test_multisines_do_not_begin_at_0_hz_and_both_have_lines_of_their_own(tmp_path):
    found = nodes(IDENTIFICATION, tmp_path, drive="both")
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
        ("controller", -9, False, "controller has ended with signal 9"),
        ("plant", -2, True, None),
        ("supervisor", 0, True, None),
        ("plant", -9, True, "plant has ended with signal 9"),
    ],
)
def test_the_end_of_a_node_ends_the_launch_with_a_code_unless_the_test_is_over(
    executable, returncode, shutting_down, meaning
):
    found = end_of_node(executable, returncode, shutting_down)
    assert found == meaning or (meaning and found.startswith(meaning))


def test_a_test_with_a_signal_that_is_stopped_early_is_no_success(tmp_path, controller):
    with_signal = nodes(IDENTIFICATION, tmp_path, drive="table")["supervisor"]
    without = nodes(CLOSED_LOOP, tmp_path, controller=controller, record="")["supervisor"]
    assert (has_end(with_signal), has_end(without)) == (True, False)
    for returncode, shutting_down in ((0, True), (130, True), (130, False)):
        assert end_of_node("supervisor", returncode, shutting_down, ends_the_test=True) == (
            "the test was stopped before it was done"
        )

# SPDX-License-Identifier: Apache-2.0
"""The offline nodes as processes: from bags to a model, a controller, a comparison; and what wrong input gives."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from simulated_loop import RUN, simulated_loop

from abrace.processes.group import find_executable
from abrace_bags import BagWriter, message_definition
from abrace_core.controller_file import load_controller
from abrace_core.linear_model import load_model, pole_table
from abrace_core.node import find_file
from abrace_core.noise import banded_noise
from abrace_core.table_signals import table_noise
from abrace_core.wire import Responses
from abrace_plant.rig.file import load_rig

SECONDS = 80.0


def write_bag(
    path: Path, ground: np.ndarray, command: np.ndarray, lost: range = range(0), clipped: range = range(0)
) -> Path:
    """A bag of the rig's responses to a ground acceleration and a command that answer sample after sample.

    With `clipped` they say which channels are at the end of their range: a2 in these samples.
    """
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    loop = simulated_loop(rig, 3)
    definition = message_definition("abrace_interfaces/msg/Response")
    facts = {"sample_period": "0.002", "rig": rig.name, "capacity": json.dumps(rig.capacity.tolist())}
    with BagWriter(path, facts) as bag:
        topic = bag.add_topic("/response", definition.type_name, definition.text, definition.type_hash)
        packed = Responses()
        for k in range(len(ground)):
            sample = loop.step()
            z, until_now = sample.reading, sample.command
            time = 2_000_000 * k
            head = sample.head._replace(clipped=(k in clipped) << 5)
            payload = packed.pack(time, head, "", [2], z[:3], z[4:7], z[3:4], z[7:9], until_now, z[9])
            if k not in lost:
                bag.write(topic, payload, time, time)
            loop.receive_ground_acceleration(sample.stamp, float(ground[k]))
            loop.receive_command(RUN, k, [command[k]], "")
    return path


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bags")
    samples = round(SECONDS * 500)
    shaken = table_noise(samples, 500.0, (0.1, 10.0), 0.25, 1)
    pushed = banded_noise(samples, 500.0, (0.0, 30.0), 1800.0, 2)
    rest = np.zeros(samples)
    return {
        "table": write_bag(folder / "table", shaken, rest),
        "command": write_bag(folder / "command", rest, pushed),
        "gap": write_bag(folder / "gap", shaken, rest, range(6000, 6025)),
        "check": write_bag(
            folder / "check", table_noise(5000, 500.0, (0.1, 10.0), 0.2, 5), np.zeros(5000), clipped=range(700, 714)
        ),
    }


def run_node(package: str, executable: str, **parameters: object) -> subprocess.CompletedProcess:
    given = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
    command = [str(find_executable(package, executable)), "--ros-args", *given]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_bags_become_a_model_the_model_a_controller_and_both_are_compared(bags, tmp_path):
    model, controller, comparison = tmp_path / "model", tmp_path / "lqg3.yaml", tmp_path / "comparison"

    ended = run_node("abrace_sysid", "identify", table=bags["table"], command=bags["command"], output=model, mat="true")
    assert ended.returncode == 0, ended.stderr
    assert "100% identified" in ended.stdout
    assert load_model(model / "model.json").order == 14
    assert load_model(model / "superposed.json").order == 24
    assert load_model(model / "reduced.json").order == 8
    for name in ("figure_3_force.png", "figure_4_table.png", "figure_5_command.png", "model.mat", "reduced.mat"):
        assert (model / name).stat().st_size > 1000
    judged = json.loads((model / "validity.json").read_text())
    assert judged["verdict"] == "trust", ended.stdout
    assert "validity: trust" in ended.stdout
    assert (model / "validity.png").stat().st_size > 10_000
    found = json.loads((model / "poles.json").read_text())
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    own = pole_table(rig.model.poles())
    for test, count in (("table", 3), ("command", 6)):
        assert len(found[test]) == count
        for pole, (frequency, damping_ratio) in zip(found[test], own, strict=False):
            assert pole["frequency"] == pytest.approx(frequency, rel=2e-3)
            assert pole["damping_ratio"] == pytest.approx(damping_ratio, rel=0.10)

    ended = run_node(
        "abrace_lqg",
        "design",
        model=model / "reduced.json",
        check_models=f"[{model / 'model.json'}, {model / 'superposed.json'}]",
        output=controller,
    )
    assert ended.returncode == 0, ended.stderr
    assert "gain margin" in ended.stdout

    refused = tmp_path / "refused.yaml"
    ended = run_node("abrace_lqg", "design", model=model / "reduced.json", disk_margin=0.5, output=refused)
    assert ended.returncode == 2
    assert "design refused: disk margin 0.3" in ended.stderr
    assert "with reduced, expected at least 0.5 (accept: [small_disk_margin]" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1, ended.stderr
    assert not list(tmp_path.glob("refused*"))

    written = load_controller(controller)
    assert written.force_limit.tolist() == rig.capacity.tolist(), "from the bags' facts"
    law = written.law
    assert law.inputs == ("a1", "a2", "a3")
    assert law.sample_period == 0.002

    ended = run_node(
        "abrace_sysid",
        "validate",
        bag=bags["check"],
        model=model / "model.json",
        other_models=f"[{model / 'superposed.json'}, {model / 'reduced.json'}]",
        output=comparison,
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads((comparison / "comparison.json").read_text())
    assert found["clipped"] == {"measured": {"a2": 14}}
    assert f"{bags['check']}: a2: 14 samples at the end of its range" in ended.stderr
    assert set(found["other_models"]) == {"superposed", "reduced"}
    for prediction, least in ((found, 0.998), *((other, 0.98) for other in found["other_models"].values())):
        channels = prediction["simulated_vs_measured"]
        assert set(channels) == {"x1", "x2", "x3", "xf", "a1", "a2", "a3", "f"}
        assert min(channel["correlation"] for channel in channels.values()) > least
    assert found["peak_rms_error"] < 0.01
    assert all(
        row["noise_free_error"] <= row["normalised_rms_error"] for row in found["simulated_vs_measured"].values()
    )


def test_modes_are_found_without_a_drive_and_a_building_that_is_the_same_has_not_changed(bags, tmp_path):
    ended = run_node("abrace_sysid", "ambient", bag=bags["table"], before=bags["table"], output=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[-2] == "no change beyond chance"
    found = json.loads((tmp_path / "ambient.json").read_text())
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    for frequency, _ in pole_table(rig.model.poles())[:3]:
        assert any(mode["frequency"] == pytest.approx(frequency, rel=0.01) for mode in found["modes"])
    assert found["change"]["changed"] is False
    assert {mode["probability"] for mode in found["change"]["modes"]} == {1.0}
    for name in ("ambient_stabilization.png", "building_change.png"):
        assert (tmp_path / name).stat().st_size > 1000


def test_measured_data_become_a_model_that_predicts_what_was_held_out(tmp_path):
    random = np.random.default_rng(1)
    force, poles = random.standard_normal((6000, 2)), 2 * np.pi * np.array([8.0, 21.0]) * (-0.01 + 1j)
    s = 2j * np.pi * np.fft.rfftfreq(6000, 0.01)[:, None]
    modal = s**2 / ((s - poles) * (s - poles.conj())) * (np.fft.rfft(force, axis=0) @ random.standard_normal((2, 2)))
    moved = np.fft.irfft(modal @ random.standard_normal((2, 5)), 6000, axis=0)
    moved += 0.02 * moved.std(axis=0) * random.standard_normal(moved.shape)
    np.savez(tmp_path / "data.npz", force=force[2000:4000], moved=moved[2000:4000])
    given = {"data": tmp_path / "data.npz", "inputs": "[force_1, force_2]", "output": tmp_path / "model"}
    ended = run_node("abrace_sysid", "identify", **given, sample_rate=100.0, held_out=0.3, units="[force_1=N]")
    assert ended.returncode == 0, ended.stderr
    assert "variance accounted for, 6 s held out: mean 99.9" in ended.stdout
    (slow, fast) = json.loads((tmp_path / "model/poles.json").read_text())["data"]
    assert [slow["frequency"], fast["frequency"]] == pytest.approx(np.abs(poles), rel=1e-3)
    assert (tmp_path / "model/transfer_functions_force_1.png").stat().st_size > 1000


def test_a_bag_that_was_cut_off_or_has_a_gap_is_used_as_far_as_it_goes_and_says_so(bags, tmp_path):
    cut = tmp_path / "cut"
    shutil.copytree(bags["command"], cut)
    (cut / "metadata.yaml").unlink()
    (recorded,) = cut.glob("*.mcap")
    with recorded.open("r+b") as file:
        file.truncate(int(0.9 * recorded.stat().st_size))
    model = tmp_path / "model"
    ended = run_node("abrace_sysid", "identify", table=bags["gap"], command=cut, output=model)
    assert ended.returncode == 0, ended.stderr
    assert "cut" in ended.stderr
    assert "a gap after sample 5999 (25 samples, 0.05 s); samples 6025 to 39999 are used" in ended.stderr
    seconds = json.loads((model / "model.json").read_text())["provenance"]["seconds"]
    assert seconds["table"] == [pytest.approx(67.95)]
    assert seconds["command"][0] == pytest.approx(0.9 * SECONDS, abs=1.0)
    ended = run_node("abrace_sysid", "validate", bag=bags["gap"], model=model / "model.json", output=tmp_path / "check")
    assert ended.returncode == 2, "there the test has to be whole"
    assert "sample 5999 is followed by sample 6025" in ended.stderr


@pytest.mark.parametrize(
    ("package", "executable", "parameters", "expected"),
    [
        ("abrace_sysid", "identify", {"output": "o"}, "parameter table"),
        ("abrace_sysid", "identify", {"data": "d.npz", "table": "{table}", "output": "o"}, "parameter table"),
        ("abrace_sysid", "identify", {"data": "d.npz", "inputs": "[u]", "output": "o"}, "d.npz: No such file"),
        ("abrace_sysid", "identify", {"table": "no_bag", "command": "no_bag", "output": "o"}, "no_bag: no such bag"),
        ("abrace_sysid", "identify", {"table": "{command}", "command": "{table}", "output": "o"}, "expected 0"),
        ("abrace_sysid", "identify", {"table": "{check}", "command": "{command}", "output": "o"}, "at least 60 s"),
        (
            "abrace_sysid",
            "identify",
            {"table": "{table}", "command": "{command}", "output": "o", "method": "x"},
            "welch",
        ),
        ("abrace_sysid", "identify", {"table": "{table}", "command": "[]", "output": "o"}, "parameter command"),
        (
            "abrace_plant",
            "ground_motion",
            {"record": "multisine", "duration": "80.0", "band": "[0.0, 10.0]"},
            "frequency above 0",
        ),
        (
            "abrace_sysid",
            "ambient",
            {"bag": "{command}", "output": "o"},
            "expected 0: an ambient test is without commands",
        ),
        ("abrace_sysid", "validate", {"bag": "{check}", "model": "no.json", "output": "o"}, "model file no.json"),
        ("abrace_lqg", "design", {"model": "no.json", "output": "o.yaml"}, "model file no.json"),
        ("abrace_lqg", "design", {"model": "bad.json", "output": "o.yaml"}, "not JSON"),
        ("abrace_lqg", "design", {"model": "bad.json", "output": "o.txt"}, "ends in .yaml"),
        ("abrace_lqg", "design", {"model": "bad.json", "output": "o.yaml", "weights": "none"}, "weights 'none'"),
        ("abrace_plant", "characterize", {"rig": "none", "output": "o"}, "rig 'none': unknown"),
        ("abrace_plant", "characterize", {"rig": "no.yaml", "output": "o"}, "rig file no.yaml: no such file"),
        ("abrace_plant", "record", {"output": "o"}, "parameter record"),
        ("abrace_plant", "record", {"record": "kobe", "output": "o"}, "northridge_aftershock"),
        ("abrace_plant", "record", {"record": "{check}", "output": "o"}, "ground_acceleration"),
        ("abrace_plant", "record", {"record": "el_centro", "taper": "100.0", "output": "o"}, "taper"),
    ],
)
def test_wrong_input_gives_one_line_exit_code_2_and_writes_nothing(
    bags, tmp_path, monkeypatch, package, executable, parameters, expected
):
    monkeypatch.chdir(tmp_path)
    Path("bad.json").write_text("{")
    given = {name: str(value).format(**bags) for name, value in parameters.items()}
    ended = run_node(package, executable, **given)
    assert ended.returncode == 2
    assert expected in ended.stderr
    assert len(ended.stderr.splitlines()) == 1, ended.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["bad.json"]


def test_a_rig_is_characterized_with_the_papers_numbers_beside(tmp_path):
    ended = run_node("abrace_plant", "characterize", output=tmp_path / "rig")
    assert ended.returncode == 0, ended.stderr
    found = json.loads((tmp_path / "rig/characteristics.json").read_text())
    assert found["zero_command"][0] == pytest.approx([7.363, 0.0138], rel=0.05)
    assert {row["paper"] for row in found["comparison"]} >= {6.673, 22.933, 37.966}
    assert "antiresonance 1" in ended.stdout
    assert (tmp_path / "rig/characteristics.png").stat().st_size > 10_000


def test_a_record_is_measured_and_drawn_as_it_will_be_played(tmp_path):
    ended = run_node("abrace_plant", "record", record="el_centro", peak_acceleration=0.980665, output=tmp_path / "out")
    assert ended.returncode == 0, ended.stderr
    found = json.loads((tmp_path / "out/record.json").read_text())
    assert found["played"]["peak_acceleration"] == pytest.approx(0.980665, rel=1e-12)
    assert found["recorded"]["peak_acceleration"] == pytest.approx(0.281 * 9.80665, rel=0.01)
    assert found["recorded"]["significant_duration"] == pytest.approx(24.2, abs=0.1)
    for text in ("PGA", "PGV", "PGD", "Arias", "D5-95"):
        assert text in ended.stdout
    assert (tmp_path / "out/record.png").stat().st_size > 10_000


def test_a_bags_table_motion_is_a_record(bags, tmp_path):
    ended = run_node(
        "abrace_plant",
        "record",
        record=bags["check"],
        channel="response:ground_acceleration",
        band_limit=0.0,
        output=tmp_path / "out",
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads((tmp_path / "out/record.json").read_text())
    assert found["recorded"]["samples"] == 5000
    assert found["recorded"]["sample_period"] == pytest.approx(0.002)

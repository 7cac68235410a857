# SPDX-License-Identifier: Apache-2.0
"""MATLAB files and bags: the named array or field is read, and what cannot be one record is told."""

from __future__ import annotations

import re

import numpy as np
import pytest
import scipy.io
from forked_matlab import matlab_files_by_forks  # noqa: F401
from mcap_chunks import without_end
from reference_messages import DEFINITIONS, HASHES, RESPONSE, response_message, serialised

from abrace_bags import BagWriter, read_run
from abrace_core import AbraceError
from abrace_core.files import matlab_loader
from abrace_plant.records.files import read_record

G = 9.80665
VALUES = np.array([0.1, -0.2, 0.3, 0.25, -0.05])
TIMED = np.column_stack([0.02 * np.arange(5), VALUES])

# MATLAB ---------------------------------------------------------------------------------------------------------------


def saved(folder, **variables):
    scipy.io.savemat(folder / "quake.mat", variables)
    return folder / "quake.mat"


@pytest.mark.parametrize("version", ["5", "4"])
@pytest.mark.parametrize("values", [VALUES, VALUES[:, None], VALUES[None, :]])
def test_vector_of_a_matlab_file_that_is_named_an_acceleration_is_the_record(tmp_path, version, values):
    scipy.io.savemat(
        tmp_path / "quake.mat", {"acc": np.tile(values, 10), "dt": 0.01, "site": "here"}, format=version
    ) if values.ndim == 1 else scipy.io.savemat(tmp_path / "quake.mat", {"acc": values}, format=version)
    record = read_record(tmp_path / "quake.mat", "g", 0.01, None if values.ndim == 1 else "acc")
    assert (record.name, record.sample_period) == ("quake", 0.01)
    np.testing.assert_allclose(record.acceleration[:5], VALUES * G, rtol=1e-15)


SEVERAL = {"t": TIMED[:, 0], "q": {"a": VALUES}, "k": np.ones((3, 4)), "x": 1.0, "note": "text", "z": 1j * VALUES}


@pytest.mark.parametrize(
    ("variables", "channel", "message"),
    [
        (SEVERAL, None, r"no column named an acceleration, expected channel as one of q.a \(5\), k_1 \(4\), k_2 \(4\)"),
        (SEVERAL, "b", r"no column 'b', expected channel as one of q.a"),
        (SEVERAL, "z", "no column 'z'"),
        (SEVERAL, "k", "no column 'k'"),
        ({"note": "text"}, None, "no array of real numbers"),
        ({"a": [1.0, np.nan, 2.0]}, "a", "a, row 2: nan, expected a finite acceleration"),
        ({"a": [1.0, 1e308]}, "a", "a value that overflows in m/s"),
    ],
)
def test_matlab_file_without_one_good_series_says_what_there_is(tmp_path, variables, channel, message):
    path = saved(tmp_path, **variables)
    with pytest.raises(AbraceError, match=f"^ground motion {re.escape(str(path))}.*{message}"):
        read_record(path, "g", 0.01, channel)


@pytest.mark.parametrize(
    "content",
    [
        b"\x89HDF\r\n\x1a\n" + bytes(600),
        b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n",
        b"made elsewhere".ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(10),
    ],
)
@pytest.mark.parametrize("extra", [False, True])
def test_matlab_file_of_version_7_3_says_how_to_save_it_or_that_it_is_damaged(tmp_path, monkeypatch, content, extra):
    """Without the reader of the extra `records`, and with it."""
    if extra:
        pytest.importorskip("pymatreader")
    else:
        monkeypatch.setattr(matlab_loader.importlib.util, "find_spec", lambda _: None)
    (tmp_path / "a.mat").write_bytes(content)
    told = ("not read as .*", "") if extra else ("", ", expected one saved with save -v7")
    with pytest.raises(AbraceError, match=rf"{told[0]}version 7\.3 \(HDF5\){told[1]}"):
        read_record(tmp_path / "a.mat", "g", 0.01)


def test_truncated_matlab_file_is_told(tmp_path):
    path = saved(tmp_path, a=VALUES)
    whole = path.read_bytes()
    for size in (100, 127, 140, 190, len(whole) - 8):
        path.write_bytes(whole[:size])
        with pytest.raises(AbraceError, match=f"^ground motion {re.escape(str(path))}: .*MATLAB"):
            read_record(path, "g", 0.01)


STEPS = np.arange(400)
WAVE = np.sin(0.1 * STEPS)
STEP = 0.005
TIMES = STEP * STEPS


def struct_array(name: str, data: str, *pairs: tuple[str, np.ndarray]) -> np.ndarray:
    found = np.zeros((1, len(pairs)), dtype=[(name, object), (data, object)])
    for i, pair in enumerate(pairs):
        found[0, i] = pair
    return found


SIGNALS = struct_array("label", "values", ("w", WAVE[:, None]), ("a1", 2 * WAVE[:, None]))
SERIES = struct_array("Name", "Data", ("model/table/w", WAVE[None, :]), ('"model"/"roof"/"a1"', 2 * WAVE[None, :]))
AXIS = struct_array("Name", "Data", ("HostService", TIMES[None, :]))
WITH_TIMES = [
    ({"t": TIMES[:, None], "Acc": WAVE[:, None]}, "Acc", 1),
    ({"time": TIMES[None, :], "acc": WAVE[None, :]}, None, 1),
    ({"time_ms": 1e3 * TIMES, "acc": WAVE}, None, 1),
    ({"dt": STEP, "Tf": 2.0, "acc": WAVE}, None, 1),
    ({"Ts": STEP, "acc": WAVE}, None, 1),
    ({"dt_ms": 5.0, "acc": WAVE}, None, 1),
    ({"fs": 200.0, "acc": WAVE}, None, 1),
    ({"Sampling_Rate": 200, "acc": WAVE}, None, 1),
    ({"SamplingFrequency_kHz": 0.2, "acc": WAVE}, None, 1),
    ({"q": {"t": TIMES, "acc": WAVE}}, None, 1),
    ({"q": {"dt": STEP, "acc": WAVE}, "r": {"dt": 0.1, "acc": 2 * WAVE}}, "q.acc", 1),
    ({"q": {"t": TIMES, "acc": WAVE}, "r": {"t": 3 * TIMES, "acc": 2 * WAVE}}, "q.acc", 1),
    (
        {"quake": {"time": TIMES[:, None], "signals": {"values": WAVE[:, None], "label": "a", "dimensions": 1.0}}},
        None,
        1,
    ),
    ({"quake": {"time": TIMES[:, None], "signals": {"values": WAVE[:, None]}}}, "quake", 1),
    ({"log": {"time": TIMES[:, None], "signals": SIGNALS}}, "a1", 2),
    ({"log": {"time": TIMES, "signals": {"values": np.column_stack([WAVE, 2 * WAVE])}}}, "log_2", 2),
    ({"run_7": {"X": AXIS, "Y": SERIES}}, "w", 1),
    ({"run_7": {"X": AXIS, "Y": SERIES}}, "model/roof/a1", 2),
    ({"data": np.column_stack([TIMES, WAVE, 2 * WAVE])}, "data_3", 2),
    ({"data": np.vstack([TIMES, WAVE, 2 * WAVE])}, "data_2", 1),
    ({"data": np.column_stack([TIMES, WAVE, 2 * WAVE]), "dt": STEP, "other": WAVE[:99]}, "data_3", 2),
    ({"data": np.column_stack([TIMES, WAVE])}, None, 1),
]


@pytest.mark.parametrize(("variables", "channel", "times"), WITH_TIMES)
def test_the_times_of_a_matlab_file_are_found_and_a_period_that_contradicts_them_is_refused(
    tmp_path, variables, channel, times
):
    path = saved(tmp_path, **variables)
    record = read_record(path, "m/s^2", None, channel)
    assert record.sample_period == pytest.approx(STEP, rel=1e-9)
    np.testing.assert_allclose(record.acceleration, times * WAVE, rtol=1e-12)
    assert read_record(path, "m/s^2", STEP, channel).sample_period == pytest.approx(STEP, rel=1e-9)
    with pytest.raises(AbraceError, match=r"sample period 0\.005 s( by its times)?, 0\.02 s was given"):
        read_record(path, "m/s^2", 0.02, channel)


@pytest.mark.parametrize("turn", [np.asarray, np.transpose])
def test_times_in_the_first_column_of_a_numpy_array_are_found(tmp_path, turn):
    np.save(tmp_path / "quake.npy", turn(np.column_stack([TIMES, WAVE, 2 * WAVE])))
    record = read_record(tmp_path / "quake.npy", "m/s^2", channel="3")
    assert record.sample_period == pytest.approx(STEP, rel=1e-9)
    np.testing.assert_array_equal(record.acceleration, 2 * WAVE)
    with pytest.raises(AbraceError, match=r"sample period 0\.005 s by its times, 0\.02 s was given"):
        read_record(tmp_path / "quake.npy", "m/s^2", 0.02, "3")
    with pytest.raises(AbraceError, match=r"expected channel as one of 2 \(400\), 3 \(400\)"):
        read_record(tmp_path / "quake.npy", "m/s^2")


@pytest.mark.parametrize(
    ("variables", "channel", "message"),
    [
        (
            {"t": TIMES[:-1], "acc": WAVE},
            None,
            "t has 399 times and acc 400 values, expected as many, or sample_period",
        ),
        (
            {"x_time": TIMES, "y_time": 2 * TIMES, "acc": WAVE},
            None,
            "2 columns of times, x_time, y_time; expected sample",
        ),
        ({"period": 0.8, "frequency": 2.0, "acc": WAVE}, None, "no times in the file"),
        ({"dt": 5.0, "acc": WAVE}, None, "no times in the file"),
        (
            {"rec": np.ones((100, 3, 4))},
            "rec_1",
            "rec is 100 x 3 x 4, expected each record of it as a matrix of its own",
        ),
        ({"rec": np.ones((100, 3, 4))}, None, "rec is 100 x 3 x 4, expected each record of it as a matrix of its own"),
        ({"acc": 1j * WAVE}, None, "acc is complex, expected real numbers"),
    ],
)
def test_what_is_no_record_in_a_matlab_file_is_named(tmp_path, variables, channel, message):
    with pytest.raises(AbraceError, match=message):
        read_record(saved(tmp_path, **variables), "m/s^2", None, channel)


# Bags -----------------------------------------------------------------------------------------------------------------

START, TICK = 1_700_000_000_000_000_000, 2_000_000


def write_bag(folder, numbers=range(7, 107), values=None):
    """A bag of responses with these numbers, sampled at 500 Hz with jitter; the table's acceleration is the number."""
    jitter = np.random.default_rng(1).integers(-300_000, 300_001, len(numbers))
    with BagWriter(folder, {"sample_period": "0.002"}) as bag:
        topic = bag.add_topic("/rig/response", RESPONSE, DEFINITIONS[RESPONSE], HASHES[RESPONSE])
        for k, number in enumerate(numbers):
            stamp = START + TICK * number + int(jitter[k])
            z = np.full(10, float(number)) if values is None else values[k]
            message = response_message(number, z, stamp // 10**9, stamp % 10**9)
            bag.write(topic, serialised(message), stamp, stamp)
    return folder


def test_acceleration_of_the_table_in_a_bag_is_the_record_also_with_jitter(tmp_path):
    bag = write_bag(tmp_path / "run_1.5")
    for path in (bag, bag / "run_1.5_0.mcap"):
        record = read_record(path)
        assert record.sample_period == pytest.approx(0.002, rel=1e-12)
        np.testing.assert_array_equal(record.acceleration, np.arange(7.0, 107.0))
    assert read_record(str(bag), "m/s^2", 0.002, " w ").name == "run_1.5"
    with pytest.raises(AbraceError, match="the file states m/s\\^2, unit g was given"):
        read_record(bag, unit="g")


def test_channel_of_a_bag_is_another_acceleration(tmp_path):
    bag = write_bag(tmp_path / "bag")
    run = read_run(bag)
    for channel in ("a3", "acceleration[2]", "rig/response:a3", "/rig/response:acceleration[2]", "response: a3"):
        np.testing.assert_array_equal(read_record(bag, channel=channel).acceleration, run.channels(["a3"])[:, 0])
    assert read_record(bag, channel="rig/response:ground_acceleration").chosen == "w in m/s^2"


@pytest.mark.parametrize(
    ("channel", "message"),
    [
        ("x1", "x1 is in m, expected an acceleration: channel as one of w, a1, a2, a3"),
        ("displacement[0]", "displacement[0] is in m, expected an acceleration"),
        ("rig/response:displacement[2]", "displacement[2] is in m, expected an acceleration"),
        ("xf", "xf is in m, expected an acceleration"),
        ("stroke[0]", "stroke[0] is in m, expected an acceleration"),
        ("f", "f is in N, expected an acceleration"),
        ("force[0]", "force[0] is in N, expected an acceleration"),
        ("U", "U is in N, expected an acceleration"),
        ("command[0]", "command[0] is in N, expected an acceleration"),
        ("table_displacement", "table_displacement is in m, expected an acceleration"),
        ("b", "no acceleration 'b' in it, expected an acceleration: channel as one of w, a1, a2, a3"),
        ("a4", "no acceleration 'a4' in it, expected an acceleration: channel as one of w, a1, a2, a3"),
        ("other:w", "no topic other of type abrace_interfaces/msg/Response in it"),
    ],
)
def test_a_channel_of_a_bag_that_is_no_acceleration_is_refused_by_its_unit(tmp_path, channel, message):
    bag = write_bag(tmp_path / "bag")
    with pytest.raises(AbraceError) as refused:
        read_record(bag, channel=channel)
    assert str(refused.value).startswith(f"ground motion {bag}: ")
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ([0, 1, 5, 6, 9], "sample 1 is followed by sample 5, expected 2"),
        ([3, 4, 4, 5], "sample 4 is followed by sample 4"),
    ],
)
def test_samples_missing_from_a_bag_are_told(tmp_path, numbers, message):
    path = write_bag(tmp_path / "bag", numbers)
    with pytest.raises(AbraceError, match=f"^ground motion {re.escape(str(path))}.*{message}"):
        read_record(path)


def test_value_that_is_no_number_in_a_bag_is_told(tmp_path):
    values = np.zeros((9, 10))
    values[4] = np.nan
    with pytest.raises(AbraceError, match=r"^ground motion .*(nan|finite)"):
        read_record(write_bag(tmp_path / "bag", range(9), values))


def test_bag_that_was_cut_off_is_not_whole(tmp_path):
    path = write_bag(tmp_path / "bag") / "bag_0.mcap"
    whole = path.read_bytes()
    path.write_bytes(without_end(whole))
    with pytest.raises(AbraceError, match=r"^ground motion .*bag_0.mcap: not whole: .*cut off or damaged"):
        read_record(path)


def test_directory_without_a_bag_and_file_that_is_none_are_told(tmp_path):
    (tmp_path / "folder.mat").mkdir()
    with pytest.raises(
        AbraceError, match=r"^ground motion .*folder.mat: no MCAP or sqlite3 file in it, expected a bag directory"
    ):
        read_record(tmp_path / "folder.mat")
    (tmp_path / "a.mcap").write_bytes(b"SQLite format 3\0" * 9)
    with pytest.raises(AbraceError, match=r"^ground motion .*a.mcap: can't be read .file is not a database."):
        read_record(tmp_path / "a.mcap")

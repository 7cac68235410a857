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


# Bags -----------------------------------------------------------------------------------------------------------------

START, STEP = 1_700_000_000_000_000_000, 2_000_000


def write_bag(folder, numbers=range(7, 107), values=None):
    """A bag of responses with these numbers, sampled at 500 Hz with jitter; the table's acceleration is the number."""
    jitter = np.random.default_rng(1).integers(-300_000, 300_001, len(numbers))
    with BagWriter(folder, {"sample_period": "0.002"}) as bag:
        topic = bag.add_topic("/rig/response", RESPONSE, DEFINITIONS[RESPONSE], HASHES[RESPONSE])
        for k, number in enumerate(numbers):
            stamp = START + STEP * number + int(jitter[k])
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
    np.testing.assert_array_equal(read_record(bag, channel="a3").acceleration, run.channels(["a3"])[:, 0])
    for channel in ("x1", "b", "response:ground_acceleration"):
        expected = f"no acceleration '{channel}' in it, expected channel as one of w, a1, a2, a3$"
        with pytest.raises(AbraceError, match=f"^ground motion {re.escape(str(bag))}: {expected}"):
            read_record(bag, channel=channel)


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

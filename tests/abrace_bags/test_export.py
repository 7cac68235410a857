# SPDX-License-Identifier: Apache-2.0
"""Bags for people and other programs: description, CSV, MATLAB file, figure."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bag_contents import read_topics
from reference_messages import DEFINITIONS, RESPONSE, STRING, note, response_message, serialised
from scipy.io import loadmat

from abrace_bags import BagWriter, TopicArrays, describe, export, write_csv, write_mat
from abrace_bags.export import columns
from abrace_bags.figure import bag_figure
from abrace_core import AbraceError
from abrace_core.figures.saving import save_figure

if TYPE_CHECKING:
    from pathlib import Path

LOST = (4, 5, 9)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Twenty samples at 500 Hz of which three are lost, and two notes with commas and quotes."""
    source = np.random.default_rng(3)
    with BagWriter(tmp_path / "bag", {"rig": "ncree, three storeys", "sample_period": "0.002"}) as bag:
        responses = bag.add_topic("/rig/response", RESPONSE, DEFINITIONS[RESPONSE], "")
        notes = bag.add_topic("/note", STRING, DEFINITIONS[STRING], "")
        for k in set(range(20)) - set(LOST):
            x = source.normal(size=10)
            time = 1_700_000_000_000_000_000 + 2_000_000 * k
            bag.write(responses, serialised(response_message(k, x, 9, 2_000_000 * k)), time, time)
        for text in ('a "word", a comma', ""):
            bag.write(notes, note(text), time, time)
    return tmp_path / "bag"


def test_description_counts_rates_and_gaps(bag: Path) -> None:
    found = describe(bag)
    note, response = found.contents["/note"], found.contents["/rig/response"]
    assert list(found.types.items()) == [("/note", STRING), ("/rig/response", RESPONSE)]
    assert response.messages == 17
    assert (response.gaps, response.missing) == (2, 3)
    assert response.rate == pytest.approx(500), "the rig's, also where samples are lost"
    assert (note.messages, note.rate, note.first_number) == (2, 0.0, None)
    assert found.duration == pytest.approx(0.038)
    assert found.facts["sample_period"] == "0.002"
    assert found.size == sum(path.stat().st_size for path in bag.glob("*.mcap"))
    assert (found.files, found.warnings) == (1, ())


def test_csv_keeps_every_digit(bag: Path, tmp_path: Path) -> None:
    contents = read_topics(bag)
    write_csv(tmp_path / "out.csv", [contents["/rig/response"]])
    with (tmp_path / "out.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header[:2] == ["log_time", "publish_time"]
    assert "displacement[2]" in header
    assert len(rows) == 17
    for name, column in columns(contents["/rig/response"]).items():
        text = [row[header.index(name)] for row in rows]
        np.testing.assert_array_equal(np.array(text).astype(column.dtype), column)
    write_csv(tmp_path / "note.csv", [contents["/note"]])
    with (tmp_path / "note.csv").open(newline="") as file:
        assert [row[2] for row in csv.reader(file)] == ["data", 'a "word", a comma', ""]


def test_mat_has_every_value_under_names_that_matlab_takes(bag: Path, tmp_path: Path) -> None:
    contents = read_topics(bag)
    write_mat(tmp_path / "out.mat", contents, contents.facts)
    found = loadmat(tmp_path / "out.mat", simplify_cells=True)
    for name, values in contents["/rig/response"].fields.items():
        read = found["rig_response"][name.replace(".", "_")]
        if values.dtype.kind == "U":
            # of an empty text SciPy makes an empty array
            read = np.array([text if np.size(text) else "" for text in read])
        np.testing.assert_array_equal(np.reshape(read, values.shape), values)
    np.testing.assert_array_equal(found["rig_response"]["log_time"], contents["/rig/response"].log_time)
    assert found["facts"]["rig"] == "ncree, three storeys"


def arrays(**fields: Any) -> TopicArrays:
    time = np.arange(3)
    return TopicArrays("test_msgs/msg/Odd", {name: np.asarray(value) for name, value in fields.items()}, time, time)


def test_what_no_table_can_hold_is_refused(tmp_path: Path) -> None:
    ragged = np.empty(3, object)
    ragged[:] = [np.zeros(1), np.zeros(2), np.zeros(1)]
    with pytest.raises(AbraceError, match="values does not have the same length in all messages"):
        write_csv(tmp_path / "out.csv", [arrays(values=ragged)])
    with pytest.raises(AbraceError, match="are both a_b in MATLAB"):
        write_mat(tmp_path / "out.mat", {"/a/b": arrays(x=[1, 2, 3]), "/a_b": arrays(x=[1, 2, 3])}, {})
    assert list(tmp_path.iterdir()) == []


def test_times_of_the_bag_and_of_its_messages_are_kept_apart(tmp_path: Path) -> None:
    messages = arrays(log_time=[7.5, 8.5, 9.5])
    named = columns(messages)
    assert (named["log_time"].tolist(), named["message.log_time"].tolist()) == ([0, 1, 2], [7.5, 8.5, 9.5])
    write_mat(tmp_path / "out.mat", {"/a": messages}, {})
    struct = loadmat(tmp_path / "out.mat", simplify_cells=True)["a"]
    assert (struct["log_time"].tolist(), struct["message_log_time"].tolist()) == ([0, 1, 2], [7.5, 8.5, 9.5])


def test_texts_of_very_different_lengths_are_written_too(tmp_path: Path) -> None:
    texts = np.array(["short", "x" * 1000, ""], object)
    write_csv(tmp_path / "out.csv", [arrays(data=texts)])
    with (tmp_path / "out.csv").open(newline="") as file:
        assert [row[2] for row in csv.reader(file)] == ["data", *texts]
    write_mat(tmp_path / "out.mat", {"/texts": arrays(data=texts)}, {})
    assert loadmat(tmp_path / "out.mat", simplify_cells=True)["texts"]["data"][1] == "x" * 1000


def test_a_topic_that_matlab_could_not_load_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "_LARGEST_VARIABLE", 10_000)
    fields = {name: np.zeros((100, 7)) for name in "ab"}
    write_mat(tmp_path / "out.mat", {"/one": arrays(a=fields["a"]), "/other": arrays(a=fields["b"])}, {})
    for too_much in (fields, {"texts": np.array(["x" * 50] * 100)}):
        with pytest.raises(AbraceError, match=r"topic /a: has 0.0 GB, expected less than 2 GB"):
            write_mat(tmp_path / "other.mat", {"/a": arrays(**too_much)}, {})
    assert not (tmp_path / "other.mat").exists()


@pytest.mark.filterwarnings("error")
def test_numbers_that_overflow_an_axis_are_not_drawn(tmp_path: Path) -> None:
    figure = bag_figure({"/a": arrays(x=[1.0, 1.7e308, -1.7e308], y=[1.0, np.inf, np.nan], n=[2**64 - 1, 0, 1])})
    save_figure(figure, tmp_path / "out.svg")
    assert np.isfinite(figure.axes[0].lines[0].get_ydata()).tolist() == [True, False, False]


def test_figure_has_a_panel_for_each_quantity_that_changes(bag: Path) -> None:
    figure = bag_figure(read_topics(bag, ["/rig/response"]))
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert titles == ["displacement", "acceleration", "stroke", "force", "command", "ground acceleration"]
    panel = figure.axes[0]
    assert panel.get_ylabel() == "[m]"
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["x1", "x2", "x3"]
    assert len(panel.lines) == 3
    np.testing.assert_allclose(panel.lines[0].get_xdata()[-1], 0.038, rtol=1e-12)
    with pytest.raises(AbraceError, match=r"topics /note: nothing to draw"):
        bag_figure(read_topics(bag, ["/note"]))

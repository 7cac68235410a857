# SPDX-License-Identifier: Apache-2.0
"""A figure that can be zoomed says what the figure on paper says."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from abrace_core.drawing import captioned, plain_ticks, save_figure, save_image
from abrace_core.errors import AbraceError
from abrace_core.zoomable import plotly_figure
from abrace_core.zoomable_curves import thinned


def numbers(packed):
    """A curve's numbers, as Plotly unpacks them."""
    if isinstance(packed, list):
        return np.array([np.nan if one is None else one for one in packed])
    return np.frombuffer(base64.b64decode(packed["bdata"]), "<f4")


def converted(figure):
    figure.draw_without_rendering()
    return plotly_figure(figure)


def test_no_peak_of_a_long_curve_is_lost():
    curve = np.sin(np.arange(500_000) / 300)
    curve[[123_457, 400_001]] = 7.0, -9.0
    curve[250_000:250_100] = np.nan
    figure = Figure()
    figure.subplots().plot(curve)
    (trace,) = converted(figure)["data"]
    y = numbers(trace["y"])
    assert (np.nanmax(y), np.nanmin(y)) == (7.0, -9.0)
    assert len(y) < 6000
    assert np.isnan(y).any(), "the gap stays"
    assert numbers(trace["x"])[np.nanargmax(y)] == 123_457


def test_thinning_keeps_short_curves_and_those_of_nothing_but_gaps():
    assert thinned(np.arange(100.0), np.ones(100)).tolist() == list(range(100))
    assert thinned(np.arange(9000.0), np.full(9000, np.nan)).size


def test_axes_labels_scales_and_legends_are_those_of_the_figure():
    figure = Figure(figsize=(6.0, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True)
    left.loglog([1, 10], [3, 300], "--", color="#123456", label=r"$\ddot{x}_{1a}$")
    left.axvline(2.0, label="limit")
    left.set(xlabel="frequency [Hz]", ylabel="[m]", title="left")
    left.legend()
    right.bar([1, 2], [3.0, 4.0], color="#abcdef")
    found = converted(figure)
    layout, (curve, limit, bars) = found["layout"], found["data"]
    assert layout["xaxis"]["type"] == layout["yaxis"]["type"] == "log"
    assert layout["xaxis"]["range"] == pytest.approx(np.log10(left.get_xlim()))
    assert layout["xaxis2"]["matches"] == "x", "both are zoomed together"
    assert layout["xaxis"]["domain"][1] < layout["xaxis2"]["domain"][0]
    assert (curve["line"]["color"], curve["line"]["dash"]) == ("#123456", "dash")
    assert (curve["name"], limit["name"]) == ("<i>x\u0308</i><sub>1a</sub>", "limit")
    assert curve["showlegend"]
    assert limit["showlegend"]
    assert not bars["showlegend"]
    assert np.nanmax(numbers(bars["y"])) == 4.0
    words = {text["text"]: text["textangle"] for text in layout["annotations"]}
    assert words == {"left": 0, "frequency [Hz]": 0, "[m]": -90}


def test_a_figure_is_saved_with_its_caption_and_what_cannot_be_zoomed_is_an_image(tmp_path):
    figure = Figure()
    figure.subplots().imshow(np.eye(2))
    save_figure(captioned(figure, "A test."), tmp_path / "image.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["image.plotly.json", "image.png", "image.svg"]
    assert json.loads((tmp_path / "image.plotly.json").read_text()) == {"caption": "A test.", "plotly": None}
    with pytest.raises(AbraceError, match=r"image.bmp: expected a name that ends in .png or .svg"):
        save_image(figure, tmp_path / "image.bmp")


def test_ticks_of_less_than_a_decade_are_plain_numbers():
    figure = Figure()
    axis = figure.subplots()
    axis.semilogy([1, 2], [0.4, 3.0])
    plain_ticks(axis.yaxis, 0.4, 3.0)
    assert [text.get_text() for text in axis.get_yticklabels()] == ["0.5", "1", "2"]

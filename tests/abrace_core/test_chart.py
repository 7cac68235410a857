# SPDX-License-Identifier: Apache-2.0
"""A chart in the browser shows what the same chart on paper shows."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.figures.chart import POINTS, Chart, Curve, Panel, thinned, time_histories
from abrace_core.figures.saving import save_figure
from abrace_core.model import plotted
from abrace_core.model.run import Run


def numbers(packed):
    """A curve's numbers, as Plotly unpacks them."""
    return np.frombuffer(base64.b64decode(packed["bdata"]), "<f4")


def test_no_peak_of_a_long_curve_is_lost_on_paper_or_in_the_browser():
    curve = np.sin(np.arange(500_000) / 300)
    curve[[123_457, 400_001]] = 7.0, -9.0
    curve[250_000:252_000] = np.nan
    chart = Chart(((Panel((Curve(np.arange(500_000.0), curve),)),),), (6.0, 3.0))
    (trace,) = chart.plotly()["data"]
    (line,) = chart.figure().axes[0].lines
    for x, y in ((numbers(trace["x"]), numbers(trace["y"])), line.get_data()):
        assert (np.nanmax(y), np.nanmin(y)) == (7.0, -9.0)
        assert len(y) < 1600
        assert np.isnan(y).any(), "the gap stays"
        assert x[np.nanargmax(y)] == 123_457


def test_thinning_keeps_short_curves_and_those_of_nothing_but_gaps():
    assert thinned(np.ones(100)).tolist() == list(range(100))
    kept = thinned(np.full(9001, np.nan))
    assert (kept[0], kept[-1]) == (0, 9000)


def example() -> Chart:
    frequency = np.array([1.0, 10.0])
    gain = Panel(
        (Curve(frequency, np.array([3.0, 300.0]), "fitted", "#123456", 1.0, "--"),),
        "a3 / w", "", "amplitude [-]", "xy", (1.0, 100.0), (0.1, 1000.0), y_ticks=(0.1, 10.0, 1000.0),
    )  # fmt: skip
    phase = Panel((Curve(frequency, np.array([-90.0, 90.0]), "measured", style=POINTS),), x_label="frequency [Hz]")
    return Chart(((gain, gain), (phase, phase)), (8.0, 5.0), "A <chart>.", (2.0, 1.0))


def test_axes_labels_scales_limits_and_colours_are_those_of_the_chart():
    layout, data = example().plotly()["layout"], example().plotly()["data"]
    figure = example().figure()
    assert layout["height"] == 480
    assert (layout["xaxis"]["type"], layout["yaxis"]["type"]) == ("log", "log")
    assert layout["xaxis"]["range"] == pytest.approx(np.log10(figure.axes[0].get_xlim()))
    assert layout["yaxis"]["range"] == pytest.approx(np.log10(figure.axes[0].get_ylim()))
    assert layout["yaxis"]["tickvals"] == tuple(figure.axes[0].get_yticks()) == (0.1, 10.0, 1000.0)
    assert layout["xaxis3"]["title"]["text"] == figure.axes[2].get_xlabel() == "frequency [Hz]"
    assert (layout["xaxis3"]["matches"], layout["xaxis4"]["matches"]) == ("x", "x2"), "a column is zoomed together"
    assert layout["xaxis"]["domain"][1] < layout["xaxis2"]["domain"][0]
    above, below = (layout[axis]["domain"] for axis in ("yaxis", "yaxis3"))
    assert above[0] > below[1]
    assert above[1] - above[0] == pytest.approx(2 * (below[1] - below[0]))
    assert [text["text"] for text in layout["annotations"]] == ["a3 / w", "a3 / w"]
    assert (data[0]["line"]["color"], data[0]["line"]["dash"], data[2]["mode"]) == ("#123456", "dash", "markers")
    assert figure.axes[0].lines[0].get_color() == "#123456"


def test_a_legend_names_each_curve_once():
    shown = [trace["name"] for trace in example().plotly()["data"] if trace["showlegend"]]
    (legend,) = example().figure().legends
    assert shown == [text.get_text() for text in legend.get_texts()] == ["fitted", "measured"]


def test_a_column_of_panels_has_a_legend_in_each():
    time = np.arange(3.0)
    chart = time_histories(time, {"x1": (time, "m"), "x2": (time, "m"), "U": (time, "N")}, "a test")
    shown = [(trace["name"], trace["legend"]) for trace in chart.plotly()["data"] if trace["showlegend"]]
    assert shown == [("x1", "legend"), ("x2", "legend"), ("U", "legend2")]
    assert [axis.get_ylabel() for axis in chart.figure().axes] == ["displacement\n[m]", "command\n[N]"]


def test_a_chart_is_saved_for_paper_and_for_the_report(tmp_path):
    save_figure(example(), tmp_path / "chart.svg")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["chart.plotly.json", "chart.svg"]
    content = json.loads((tmp_path / "chart.plotly.json").read_text())
    assert content["caption"] == "A <chart>."
    assert len(content["plotly"]["data"]) == 4
    assert "A &lt;chart&gt;." in (tmp_path / "chart.svg").read_text()


def test_without_the_package_that_draws_it_a_run_says_what_to_import(monkeypatch):
    run = Run("a test", 0.002, np.arange(3, dtype=np.uint64), 1, 0, np.zeros((3, 2)), np.zeros(3), np.zeros((3, 0)))
    monkeypatch.setattr(plotted, "_DRAWN", {})
    with pytest.raises(AbraceError, match="figure of a Run: nothing to draw it with, expected `import abrace` before"):
        run.plot()

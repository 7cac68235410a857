# SPDX-License-Identifier: Apache-2.0
import pytest
from matplotlib.figure import Figure

from abrace_core.drawing import legend_above, save_figure, save_image
from abrace_core.errors import AbraceError


def test_saved_figures_are_whole_png_files_or_none(tmp_path):
    figure = Figure()
    figure.subplots().plot([1, 2, 3])
    save_figure(figure, tmp_path / "new" / "fig6.png")
    assert (tmp_path / "new" / "fig6.png").read_bytes().startswith(b"\x89PNG")
    names = ["fig6.plotly.json", "fig6.png", "fig6.svg"]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == names
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(AbraceError, match="cannot write"):
        save_figure(figure, tmp_path / "folder.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder.png", "new"]


def test_a_legend_above_covers_no_axis():
    figure = Figure(layout="constrained")
    axes = figure.subplots(2, 2)
    for axis in axes.flat:
        axis.plot([1, 2, 3], label="x1")
        axis.set_title("from w")
    legend_above(figure, axes[0, 0], 1)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert legend.get_window_extent().y1 <= figure.bbox.y1
    assert legend.get_window_extent().y0 >= max(axis.get_tightbbox().y1 for axis in axes.flat)


def test_a_figure_is_the_same_file_each_time(tmp_path):
    for name in ("first.svg", "second.svg"):
        figure = Figure()
        figure.subplots().plot([1, 2, 3])
        save_image(figure, tmp_path / name)
    assert (tmp_path / "first.svg").read_bytes() == (tmp_path / "second.svg").read_bytes()


def test_the_last_digits_of_a_layout_change_no_file(tmp_path):
    """Its solver finds others in each process."""
    for name, moved in (("one", 0.0), ("other", 1e-13)):
        figure = Figure(layout="constrained")
        upper, lower = figure.subfigures(2, 1)
        for axis in (*upper.subplots(1, 2), lower.subplots()):
            axis.bar([1, 2], [3, 4])
        figure.draw_without_rendering()
        figure.set_layout_engine(None)
        upper.bbox_relative.p1 += moved
        for axis in figure.axes:
            axis.set_position([value + moved for value in axis.get_position().bounds])
        save_figure(figure, tmp_path / name)
    for suffix in (".svg", ".plotly.json"):
        assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"other{suffix}").read_bytes()

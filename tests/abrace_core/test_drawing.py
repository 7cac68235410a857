# SPDX-License-Identifier: Apache-2.0
import pytest
from matplotlib.figure import Figure

from abrace_core import AbraceError
from abrace_core.figures.drawing import legend_above, plain_ticks
from abrace_core.figures.saving import save_figure


def test_saved_figures_are_whole_png_files_or_none(tmp_path):
    figure = Figure()
    figure.subplots().plot([1, 2, 3])
    save_figure(figure, tmp_path / "new" / "fig6.png")
    assert (tmp_path / "new" / "fig6.png").read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["fig6.png"]
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
        save_figure(figure, tmp_path / f"{name}.svg")
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "other.svg").read_bytes()


def test_an_image_of_another_kind_is_refused(tmp_path):
    with pytest.raises(AbraceError, match=r"image.bmp: expected a name that ends in .svg or .png"):
        save_figure(Figure(), tmp_path / "image.bmp")


def test_ticks_of_less_than_a_decade_are_plain_numbers():
    figure = Figure()
    axis = figure.subplots()
    axis.semilogy([1, 2], [0.4, 3.0])
    plain_ticks(axis.yaxis, 0.4, 3.0)
    assert [text.get_text() for text in axis.get_yticklabels()] == ["0.5", "1", "2"]

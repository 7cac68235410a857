# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.figures.drawing import ERROR, MEASURED, REFERENCE, SIMULATED, last_motion
from abrace_core.model.linear_model import pole_table
from abrace_sysid.figures import identification as figures
from abrace_sysid.figures.identification import FAINT
from abrace_sysid.figures.poles import confidence, pole_chart
from abrace_sysid.figures.validation import control_effect, time_histories
from abrace_sysid.validation import compare


@pytest.fixture(scope="module")
def comparison(identified, laboratory, controller):
    return compare(laboratory.earthquake(controller, 20), identified.model, controller, laboratory.rig.capacity)


def colours(panel):
    return {curve.label: curve.colour for curve in panel.curves}


def test_transfer_functions_show_measured_and_fitted_with_units(identified):
    chart = figures.transfer_functions(identified.command_response, ["x3", "a1"], identified.model)
    (amplitude, acceleration), (phase, _) = chart.rows
    expected = {"measured": MEASURED, "fitted": SIMULATED, "fitted minus measured, rms": ERROR}
    assert colours(amplitude) == expected | {"measured, noise": FAINT, "standard deviation": REFERENCE}
    named = {label: colour for label, colour in colours(acceleration).items() if label}
    assert named == expected | {"standard deviation": REFERENCE}, "the acceleration is no noise"
    assert amplitude.y_label == "amplitude [m / N]"
    assert acceleration.y_label == "amplitude [m/s² / N]"
    assert (phase.x_label, phase.y_label) == ("frequency [Hz]", "phase angle [deg]")
    curves = {curve.label: curve.x for curve in amplitude.curves}
    assert curves["fitted"][-1] == pytest.approx(30, abs=0.01)
    assert len(curves["measured"]) + len(curves["measured, noise"]) == len(identified.command_response.omega)
    assert np.median(curves["measured, noise"]) > np.median(curves["measured"]), "the displacement fades out"
    assert phase.curves[0].x.tolist() == curves["measured"].tolist(), "noise has no phase"
    assert identified.command_response.method in chart.caption
    table = figures.transfer_functions(identified.table_response, ["x3"], identified.model)
    assert table.rows[0][0].y_label == "amplitude [m / (m/s²)]"


def test_the_fitted_curve_is_drawn_as_the_rig_was_sampled(identified, rig):
    chart = figures.transfer_functions(identified.command_response, ["f"], rig.model)
    measured, fitted = chart.rows[1][0].curves
    of_fitted = np.interp(measured.x, fitted.x, fitted.y)
    left_over = np.abs(measured.y - of_fitted)[measured.x > 20]
    assert np.nanmedian(left_over) < 0.5, "phases in degrees, hold included in both"


def test_time_histories_have_their_error_below_and_are_in_the_units_asked_for(comparison):
    chart = time_histories(comparison, zoom=(5, 8), tested="el_centro at 0.1 g, lqg3")
    (whole, zoomed), (error, _), (acceleration, _) = chart.rows[:3]
    assert colours(whole) == {"measured": MEASURED, "simulated": SIMULATED}
    assert colours(error) == {"simulated minus measured": ERROR}
    assert error.curves[0].y == pytest.approx(whole.curves[1].y - whole.curves[0].y)
    assert (whole.y_label, acceleration.y_label) == ("x3 [cm]", "a1 [g]")
    assert "el_centro at 0.1 g, lqg3" in chart.caption
    assert time_histories(comparison, units="SI").rows[0][0].y_label == "x3 [mm]"
    assert (zoomed.curves[0].x.min(), zoomed.curves[0].x.max()) == pytest.approx((5, 8), abs=0.003)
    assert np.abs(whole.curves[0].y).max() == pytest.approx(100 * comparison.measured_peak_rms()["x3"].peak)
    with pytest.raises(AbraceError, match=r"no channel x9, expected any of x1"):
        time_histories(comparison, ["x9"])


def test_control_effect_shows_both_runs_as_measured(laboratory, controller):
    without, controlled = laboratory.earthquake(seconds=10), laboratory.earthquake(controller, 10)
    (panel,) = control_effect(without, controlled, ["x3", "a1"]).rows[0]
    assert colours(panel) == {"without control": REFERENCE, "controlled": MEASURED}
    peaks = [np.abs(curve.y).max() for curve in panel.curves]
    assert peaks == pytest.approx([100 * np.abs(run.channels(["x3"])).max() for run in (without, controlled)])
    with pytest.raises(AbraceError, match="no channel 'x9'"):
        control_effect(without, controlled, ["x9"])


def test_the_silent_end_of_a_record_is_cut():
    time = np.arange(0.0, 100.0, 0.01)
    assert last_motion(time, np.where(time < 40, np.sin(time), 0.001), np.zeros(10000)) == pytest.approx(40, abs=0.3)
    assert last_motion(time, np.sin(time)) == pytest.approx(100, abs=0.3)


def test_pole_chart_shows_how_far_each_pair_is_from_the_rigs_own(identified, rig):
    figure = pole_chart(
        {"table": identified.poles.table, "command": identified.poles.command}, {"rig": rig.model.poles}
    )
    frequency, damping = figure.axes
    shown = {line.get_label(): line for line in frequency.lines if not line.get_label().startswith("_")}
    assert list(shown) == ["rig", "table", "command"]
    assert np.isfinite(shown["command"].get_xdata()).sum() == 6
    assert np.isfinite(shown["table"].get_xdata()).sum() == 3
    (first, *_), (own, *_) = identified.poles.table_pairs, pole_table(rig.model.poles)
    factor = {"%": 1e2, "ppm": 1e6}[frequency.get_xlabel().split("[")[1][:-1]]
    assert shown["table"].get_xdata()[0] == pytest.approx(factor * (first.frequency / own[0] - 1))
    heights = [tuple(line.get_ydata()) for line in shown.values()]
    assert len(set(heights)) == 3, "no mark lies on another"
    assert [axis.get_xlabel().partition(" minus")[0] for axis in (frequency, damping)] == ["frequency", "damping ratio"]


def test_intervals_of_each_pair_are_drawn_about_those_of_both_tests(identified):
    figure = confidence({"table test": identified.poles.table_pairs, "both tests": identified.poles.common_pairs})
    bars = figure.axes[0].containers
    assert [len(bar.lines[0].get_xdata()) for bar in bars] == [len(identified.poles.common_pairs)] * 2
    assert bars[1].lines[0].get_xdata() == pytest.approx(0.0)


def test_hankel_chart_tells_kept_from_cut(identified):
    (axis,) = figures.hankel_singular_values(identified.reduction).axes
    kept, cut = axis.containers
    assert (len(kept), len(cut)) == (8, identified.reduction.whole.order - 8)
    assert kept[0].get_height() == pytest.approx(identified.reduction.hankel_singular_values[0])

import numpy as np
import pytest

from abrace_core.drawing import MEASURED, REFERENCE, SIMULATED
from abrace_core.errors import AbraceError
from abrace_sysid.figures import identification as figures
from abrace_sysid.figures.validation import control_effect, time_histories
from abrace_sysid.validation import compare


@pytest.fixture(scope="module")
def comparison(identified, laboratory, controller):
    return compare(laboratory.earthquake(controller, 20), identified.model, controller, laboratory.rig.capacity)


def colours(axis):
    return {line.get_label(): line.get_color() for line in axis.lines}


def test_transfer_functions_show_measured_and_fitted_with_units(identified):
    figure = figures.transfer_functions(identified.command_response, ["x3", "a1"], identified.model)
    amplitude, phase = figure.axes[0], figure.axes[2]
    expected = {"measured": MEASURED, "fitted": SIMULATED}
    assert colours(amplitude) == expected | {"standard deviation": REFERENCE}
    assert amplitude.get_ylabel() == "amplitude [m / N]"
    assert figure.axes[1].get_ylabel() == "amplitude [m/s² / N]"
    assert phase.get_xlabel() == "frequency [Hz]"
    assert phase.get_ylabel() == "phase angle [deg]"
    assert amplitude.lines[0].get_xdata()[-1] == pytest.approx(30, abs=0.01)
    table = figures.transfer_functions(identified.table_response, ["x3"], identified.model)
    assert table.axes[0].get_ylabel() == "amplitude [m / (m/s²)]"


def test_the_fitted_curve_is_drawn_as_the_rig_was_sampled(identified, rig):
    figure = figures.transfer_functions(identified.command_response, ["f"], rig.model)
    measured, fitted = (line.get_ydata() for line in figure.axes[1].lines)
    high = identified.command_response.omega > 2 * np.pi * 20
    assert np.nanmedian(np.abs(measured - fitted)[high]) < 0.5, "phases in degrees, hold included in both"


def test_time_histories_are_in_the_paper_s_units_and_colours(comparison):
    figure = time_histories(comparison, zoom=(5, 8))
    whole, zoomed = figure.axes[0], figure.axes[1]
    assert colours(whole) == {"measured": MEASURED, "simulated": SIMULATED}
    assert whole.get_ylabel().endswith("[cm]")
    assert figure.axes[2].get_ylabel().endswith("[g]")
    assert zoomed.get_xlim() == (5, 8)
    assert np.abs(whole.lines[0].get_ydata()).max() == pytest.approx(100 * comparison.measured_peak_rms()["x3"].peak)
    with pytest.raises(AbraceError, match=r"no channel x9, expected any of x1"):
        time_histories(comparison, ["x9"])


def test_control_effect_shows_both_runs_as_measured(laboratory, controller):
    without, controlled = laboratory.earthquake(seconds=10), laboratory.earthquake(controller, 10)
    figure = control_effect(without, controlled, ["x3", "a1"])
    assert colours(figure.axes[0]) == {"uncontrolled": REFERENCE, "controlled": MEASURED}
    peaks = [np.abs(line.get_ydata()).max() for line in figure.axes[0].lines]
    assert peaks == pytest.approx([100 * np.abs(run.channels(["x3"])).max() for run in (without, controlled)])
    with pytest.raises(AbraceError, match="no channel 'x9'"):
        control_effect(without, controlled, ["x9"])


def test_pole_chart_shows_frequency_and_damping_of_each_pair(identified, rig):
    figure = figures.pole_chart(
        {"table": identified.poles.table, "command": identified.poles.command}, {"rig": rig.model.poles()}
    )
    (axis,) = figure.axes
    shown = {line.get_label(): line for line in axis.lines}
    assert list(shown) == ["rig", "table", "command"]
    assert len(shown["command"].get_xdata()) == 6
    assert shown["table"].get_ydata()[0] == pytest.approx(1.39, rel=0.03)
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("frequency [rad/s]", "damping ratio [%]")


def test_hankel_chart_tells_kept_from_cut(identified):
    (axis,) = figures.hankel_singular_values(identified.hankel_singular_values, 8).axes
    kept, cut = axis.containers
    assert (len(kept), len(cut)) == (8, identified.whole.order - 8)
    assert kept[0].get_height() == pytest.approx(identified.hankel_singular_values[0])

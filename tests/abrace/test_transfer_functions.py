# SPDX-License-Identifier: Apache-2.0
"""Transfer functions in Python, against those of the rig that was simulated."""

from dataclasses import replace

import control
import numpy as np
import pandas
import pytest
from laboratory import Laboratory
from scipy import io

import abrace
from abrace_core import AbraceError
from abrace_core.model.multisine import repeated_multisine

RIG = abrace.load_rig("ncree_three_storey")
BAND = (0.5, 9.5)


@pytest.fixture(scope="module")
def table_test():
    return Laboratory(RIG, 3).table_test(60)


@pytest.fixture(scope="module")
def measured(table_test):
    return abrace.transfer_functions(table_test, band=BAND)


def test_two_multisines_average_and_their_noise_with_them():
    still = np.zeros(5 * 8192)
    sines = [repeated_multisine(81.92, 16.384, 500.0, (0.3, 30.0), 1800.0, 7)] * 2
    one, both = (
        abrace.transfer_functions(
            [Laboratory(RIG, seed).open_loop(f"bags/{seed}", still, sines[seed]) for seed in each]
        )
        for each in ((0,), (0, 1))
    )
    assert (one.input, both.input) == ("U", "U")
    assert np.median(both.sigma / one.sigma) == pytest.approx(1 / np.sqrt(2), rel=0.1)
    assert both.method == one.method + ", 2 tests"


def test_a_response_is_the_same_in_control_csv_matlab_and_pandas(measured, tmp_path):
    system = measured.to_control()
    assert isinstance(system, control.FrequencyResponseData)
    assert (system.input_labels, tuple(system.output_labels)) == (["w"], measured.outputs)
    at = system(1j * measured.omega[5])
    np.testing.assert_allclose(np.ravel(at), measured.response[5])
    measured.to_csv(tmp_path / "table.csv")
    read = pandas.read_csv(tmp_path / "table.csv", index_col="frequency [Hz]")
    pandas.testing.assert_frame_equal(read, measured.to_pandas())
    np.testing.assert_allclose(read["x3 real"] + 1j * read["x3 imaginary"], measured.response[:, 2])
    np.testing.assert_allclose(read["a1 deviation"], measured.sigma[:, measured.outputs.index("a1")])
    measured.to_mat(tmp_path / "table.mat")
    content = io.loadmat(tmp_path / "table.mat", simplify_cells=True)
    np.testing.assert_array_equal(content["x3_real"] + 1j * content["x3_imaginary"], measured.response[:, 2])
    np.testing.assert_allclose(2 * np.pi * content["frequency_Hz"], measured.omega)


def test_the_figure_shows_amplitude_and_phase_of_the_measured_response(measured):
    figure = measured.plot("x3")
    amplitude, phase = figure.axes[:2]
    (line,) = (one for one in amplitude.lines if one.get_label() == "measured")
    np.testing.assert_allclose(line.get_ydata().max(), np.abs(measured.response[:, 2]).max())
    assert amplitude.get_title(loc="left") == "x3 / w"
    assert "phase" in phase.get_ylabel()


def test_what_cannot_be_estimated_is_said(table_test):
    test = abrace.Test.of(table_test)
    with pytest.raises(AbraceError, match="segmnt: unknown key, did you mean segment"):
        abrace.transfer_functions(test, segmnt=4096)
    with pytest.raises(AbraceError, match="input 'U2', expected one of w, U"):
        abrace.transfer_functions(test, "U2")
    with pytest.raises(AbraceError, match="U is not excited"):
        abrace.transfer_functions(test, "U", band=BAND)
    with pytest.raises(AbraceError, match="w, U move, expected the name of one of them as input"):
        abrace.transfer_functions(replace(test, hold="zero", floors=0, braces=()))
    dead = test.outputs.copy()
    dead[:, 2] = 0.1
    with pytest.warns(UserWarning, match=r"channel x3 is left out: never changes from 0\.1"):
        found = abrace.transfer_functions(replace(test, outputs=dead), band=BAND)
    assert "x3" not in found.outputs


@pytest.fixture(scope="module")
def structure():
    """A test of some structure, whose channels have names of their own."""
    pushed, noise = np.random.default_rng(1).normal(size=(2, 4000))
    return {"push": pushed, "moved": np.convolve(pushed, [0.2, 0.5, 0.3])[:4000] + 0.01 * noise}


def test_those_of_any_structure_are_drawn_too(structure):
    found = abrace.transfer_functions(abrace.Test.from_arrays(structure, "push", sample_rate=100.0))
    assert found.plot().axes[0].get_ylabel() == "amplitude [- / -]"
    with pytest.raises(AbraceError, match=r"^transfer functions from push: no output 'x', it has moved$"):
        found.plot("x")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda _: abrace.transfer_functions(None), "^test None: expected a Test, a Run, or the folder of a bag"),
        (lambda test: abrace.transfer_functions(test, band=(5, 1)), "band 5 to 1 Hz .* the lower frequency first"),
        (lambda test: abrace.transfer_functions(test.part(0, 5)), "push in 0.05 s, expected .* or a longer test"),
        (
            lambda test: abrace.transfer_functions(test, segment="x"),
            "^transfer functions: segment: 'x', expected a whole",
        ),
        (lambda _: abrace.Test.read("nowhere", "push"), "^nowhere: No such file or directory$"),
        (
            lambda _: abrace.Test.from_arrays({"a": [1, 2]}, "a", sample_rate="1"),
            "sample_rate '1', expected a number of Hz",
        ),
    ],
)
def test_a_mistake_is_one_line(structure, spoil, message):
    with pytest.raises(AbraceError, match=message):
        spoil(abrace.Test.from_arrays(structure, "push", sample_rate=100.0))

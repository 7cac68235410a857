# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_sysid.fitting.observation import Observation
from abrace_sysid.recorded.test import Test
from abrace_sysid.spectra.fourier import automatic_half_width


def test_outputs_are_response_times_excitation_plus_transient_and_noise(plain_run):
    random = np.random.default_rng(1)
    ground, command = random.standard_normal((2, 40_000))
    held = np.append(command[1:], command[-1])
    run = plain_run(2 * ground - 3 * held, ground, command)
    run.outputs[:] += 0.1 * random.standard_normal(run.outputs.shape)
    found = Observation.of_test(Test.of(run), ("w", "U"), (1.0, 50.0))
    assert found.inputs == ("w", "U")
    assert np.allclose(found.omega, 2 * np.pi * np.arange(80, 4001) / 80)
    assert np.mean(np.abs(found.excitation) ** 2) == pytest.approx(1, rel=0.05), "unit variance, scaled by 1/sqrt(N)"
    left_over = found.measured - (found.excitation @ [2, -3])[:, None]
    assert np.mean(np.abs(left_over) ** 2) == pytest.approx(0.01, rel=0.05)
    some = Observation.of_test(Test.of(run), ("w", "U"), (1.0, 50.0), ["f", "x1"])
    assert np.array_equal(some.measured, found.measured[:, [3, 0]])


def test_windows_are_narrower_in_shorter_records_and_wider_for_more_inputs():
    widths = [automatic_half_width(seconds, 1, 0.22) for seconds in (10, 60, 120, 1200)]
    assert widths == [6, 13, 20, 20]
    assert automatic_half_width(10, 2, 0.22) > automatic_half_width(10, 1, 0.22)
    assert automatic_half_width(60, 1, 0.4) > automatic_half_width(60, 1, 0.22)


def test_a_band_without_a_line_is_refused(plain_run):
    noise = np.random.default_rng(3).standard_normal(500)
    with pytest.raises(AbraceError, match=r"no frequency line between 1.1 and 1.9 Hz"):
        Observation.of_test(Test.of(plain_run(noise, noise)), ("w",), (1.1, 1.9))

# SPDX-License-Identifier: Apache-2.0
"""Transfer functions of recorded tests with noise, by one of three methods chosen by name.

They replace the paper's "FFT technique" of Figs. 3 to 5: the local rational method, the local polynomial method, or
Welch's method. Periodic tests have their own method (`periodic_response`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from abrace_core.files.options import Count, Options
from abrace_sysid.recorded.test import of_one_rig
from abrace_sysid.spectra.bands import slowest_bandwidth
from abrace_sysid.spectra.fourier import DEGREE, WIDEST, automatic_half_width, lines_within
from abrace_sysid.spectra.frequency_response import FrequencyResponse
from abrace_sysid.spectra.local_regression import check_window, fit_locally
from abrace_sysid.spectra.welch import check_segment, welch

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from abrace_sysid.recorded.test import AnyTest, Test


LONGEST_SEGMENT = 32768
"""Default number of samples in a segment of Welch's method: 65 s at 500 Hz, a frequency resolution of 0.015 Hz."""

POLYNOMIAL = 4, 6
"""Default degree and half-width of the local polynomial method."""

Method = Literal["local_rational", "local_polynomial", "welch"]


class TransferFunctionOptions(Options):
    """A method and its settings; a setting of 0 is chosen from the record's length.

    The default is the local rational method, which was best for every length of record. The table gives the rms error
    over the band in % of the worst channel and the worst of three seeds, with sensors of 65 dB, and every other method
    at its best settings:

    ============================  ============  ============  ============  ============
    table, command                60 s          120 s         300 s         600 s
    ============================  ============  ============  ============  ============
    Welch                         60, 63        56, 38        14, 12        10, 7.2
    local polynomial              40, 32        8.4, 11       0.96, 2.2     0.44, 1.4
    local rational, automatic     0.23, 0.82    0.17, 0.62    0.16, 0.60    0.16, 0.59
    ============================  ============  ============  ============  ============
    """

    who: ClassVar[str] = "transfer functions"

    transfer_function: Method = Field(default="local_rational", description="how transfer functions are estimated")
    segment: Count = Field(default=0, description="samples of a segment in Welch's method; 0: from the record's length")
    degree: Count = Field(default=0, description="of the local methods' polynomials; 0: 2 rational, 4 polynomial")
    half_width: Count = Field(default=0, description="lines on each side in the local methods; 0: from the record")

    def require_samples(self, samples: Mapping[str, int], lines: float) -> None:
        """Check that the settings suit noise tests of so many `samples`, by the tests' names, with one input at least.

        Parameters
        ----------
        lines
            Number of lines of the shortest one in the band, at most.

        Raises
        ------
        AbraceError
            If they do not; a setting that is chosen from the record always does.
        """
        if self.transfer_function == "welch":
            if self.segment:
                check_segment(self.segment, samples)
            return
        shortest, rational = min(samples.values()), self.transfer_function == "local_rational"
        records = sum(each // shortest for each in samples.values())
        half_width = self.half_width or (WIDEST if rational else POLYNOMIAL[1])
        degree = self.degree or (DEGREE if rational else POLYNOMIAL[0])
        check_window(degree, half_width, lines if self.half_width else np.inf, 1, records, 1 if rational else 0)


def frequency_responses(
    given: AnyTest | Sequence[AnyTest],
    inputs: Sequence[str],
    band: tuple[float, float],
    options: TransferFunctionOptions | None = None,
) -> tuple[FrequencyResponse, ...]:
    """One transfer function for each excited input, from one test or repeated ones.

    Tests of one structure can have other outputs (setups): each output's is estimated from all tests that have it.

    Parameters
    ----------
    given
    band
        Lowest and highest frequency [Hz]; the inputs must be excited throughout.
    options
        Method and settings; by default those of `TransferFunctionOptions`.

    Raises
    ------
    AbraceError
        If the tests are too short for the method.
    """
    options = options or TransferFunctionOptions()
    tests = of_one_rig(given, alike=["inputs"])
    setups: dict[tuple[int, ...], list[str]] = {}
    for name in dict.fromkeys(name for test in tests for name in test.names):
        setups.setdefault(tuple(i for i, test in enumerate(tests) if name in test.names), []).append(name)
    shortest = min(len(each.outputs) for each in tests)
    if len(setups) == 1:
        return _of_setup(tests, inputs, band, options, shortest)
    found = [
        _of_setup([tests[i].select(names) for i in having], inputs, band, options, shortest)
        for having, names in setups.items()
    ]
    return tuple(
        replace(
            each[0],
            outputs=tuple(name for one in each for name in one.outputs),
            response=np.hstack([one.response for one in each]),
            sigma=np.hstack([one.sigma for one in each]),
        )
        for each in zip(*found, strict=True)
    )


def _of_setup(
    tests: Sequence[Test],
    inputs: Sequence[str],
    band: tuple[float, float],
    options: TransferFunctionOptions,
    shortest: int,
) -> tuple[FrequencyResponse, ...]:
    """As `frequency_responses`, of tests with the same outputs; the `shortest` of all has so many samples."""
    if options.transfer_function == "welch":
        segment = options.segment or min(LONGEST_SEGMENT, shortest // 4)
        return tuple(welch(tests, name, band, segment) for name in inputs)
    if options.transfer_function == "local_polynomial":
        degree, half_width = options.degree or POLYNOMIAL[0], options.half_width or POLYNOMIAL[1]
        return local_responses(tests, inputs, band, degree, half_width, 0, shortest)
    seconds = shortest * tests[0].sample_period
    half_width = options.half_width or automatic_half_width(seconds, len(inputs), slowest_bandwidth(tests[0], band))
    return local_responses(tests, inputs, band, options.degree or DEGREE, half_width, 1, shortest)


def local_responses(
    tests: Sequence[Test],
    inputs: Sequence[str],
    band: tuple[float, float],
    degree: int,
    half_width: int,
    poles: Literal[0, 1],
    samples: int,
) -> tuple[FrequencyResponse, ...]:
    """One transfer function for each of the inputs that were excited at once.

    Repeated tests share response and noise level; each has its own transient. Longer tests are cut into pieces; the
    remainder at the end of a test is not used.

    Parameters
    ----------
    tests
        The test, or repeated ones of the same rig.
    inputs
        Names of all inputs that were excited; where there are several, they must not be proportional.
    band
        Lowest and highest frequency [Hz]; the inputs must be excited throughout.
    degree
        Degree of the polynomials of the response (in the rational method of its numerator) and of the transient.
    half_width
        Lines on either side of the centre line; the unknowns are estimated from 2 half_width + 1 lines.
    poles
        0: local polynomial method (Schoukens et al. 2009; Pintelon and Schoukens 2012, sec. 7.2); 1: local rational
        method (McKelvey and Guerin 2012), one pole shared by all channels.
    samples
        Of each piece, at most those of the shortest test.

    Raises
    ------
    AbraceError
        If a window has too few lines, the band has fewer lines than a window, or an input is not excited.
    """
    lines, omega = lines_within(tests[0], samples, band)
    excitation, outputs = [], []
    for test in tests:
        starts = range(0, len(test.outputs) - samples + 1, samples)
        whole = len(test.outputs) == samples
        for one in (test,) if whole else (test.part(first, first + samples) for first in starts):
            excitation.append(one.spectra(inputs)[lines])
            outputs.append(one.spectra(one.names)[lines])
    response, sigma = fit_locally(np.array(excitation), np.array(outputs), degree, half_width, poles)
    method = f"local {'rational' if poles else 'polynomial'} method, degree {degree}, half-width {half_width}"
    if len(excitation) > 1:
        method += f", {len(excitation)} records"
    return tuple(
        FrequencyResponse(
            name,
            tests[0].names,
            omega,
            np.ascontiguousarray(response[:, :, i]),
            np.ascontiguousarray(sigma[:, :, i]),
            tests[0].sample_period,
            method,
            tests[0].hold_of(name),
        )
        for i, name in enumerate(inputs)
    )

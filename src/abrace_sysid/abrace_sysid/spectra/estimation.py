# SPDX-License-Identifier: Apache-2.0
"""Transfer functions of recorded tests with noise, by one of three methods chosen by name.

They replace the paper's "FFT technique" of Figs. 3 to 5: the local rational method, the local polynomial method, or
Welch's method. Periodic tests have their own method (`periodic_response`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from abrace_core.errors import AbraceError
from abrace_sysid.spectra.bands import slowest_bandwidth
from abrace_sysid.spectra.fourier import ORDER, Test, automatic_half_width, runs_of_one_rig
from abrace_sysid.spectra.local_polynomial import local_responses
from abrace_sysid.spectra.welch import Estimator, welch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_sysid.spectra.frequency_response import FrequencyResponse

LONGEST_SEGMENT = 32768
"""Default number of samples in a segment of Welch's method: 65 s at 500 Hz, a frequency resolution of 0.015 Hz."""

Method = Literal["local_rational", "local_polynomial", "welch"]


@dataclass(frozen=True)
class TransferFunctionOptions:
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

    Parameters
    ----------
    method
        "local_rational", "local_polynomial" or "welch".
    order, half_width
        Settings of the local methods: order of the polynomials, and half-width of the windows in lines. By default 2
        and `automatic_half_width` for the rational method, 4 and 6 for the polynomial method.
    segment
        Samples in each segment of Welch's method. By default 32768, or a quarter of a shorter record.
    window, overlap, estimator
        Settings of Welch's method, see `welch`.
    bandwidth
        Half-power bandwidth 2 zeta omega [rad/s] of the narrowest expected resonance; 0: `slowest_bandwidth` of the
        first test.
    """

    method: Method = "local_rational"
    order: int = 0
    half_width: int = 0
    segment: int = 0
    window: str = "hann"
    overlap: float = 0.5
    estimator: Estimator = "H1"
    bandwidth: float = 0.0


def frequency_responses(
    run: Test | Sequence[Test],
    inputs: Sequence[str],
    band: tuple[float, float],
    options: TransferFunctionOptions | None = None,
) -> tuple[FrequencyResponse, ...]:
    """One transfer function for each excited input, from one test or repeated ones.

    Parameters
    ----------
    run
        The test, or repeated ones.
    inputs
        Names of all inputs that were excited.
    band
        Lowest and highest frequency [Hz]; the inputs must be excited throughout.
    options
        Method and settings; by default those of `TransferFunctionOptions`.

    Raises
    ------
    AbraceError
        If the tests are too short for the method, or there is no method of that name.
    """
    options = options or TransferFunctionOptions()
    runs = runs_of_one_rig(run)
    shortest = min(len(each.outputs) for each in runs)
    if options.method == "welch":
        segment = options.segment or min(LONGEST_SEGMENT, shortest // 4)
        settings = segment, options.estimator, options.window, options.overlap
        return tuple(welch(runs, name, band, *settings) for name in inputs)
    if options.method == "local_polynomial":
        return local_responses(runs, inputs, band, options.order or 4, options.half_width or 6, poles=0)
    if options.method == "local_rational":
        seconds = shortest * runs[0].sample_period
        bandwidth = options.bandwidth or slowest_bandwidth(runs[0], band)
        half_width = options.half_width or automatic_half_width(seconds, len(inputs), bandwidth)
        return local_responses(runs, inputs, band, options.order or ORDER, half_width, poles=1)
    expected = "'local_rational', 'local_polynomial' or 'welch'"
    raise AbraceError(f"transfer functions: method {options.method!r}, expected {expected}")

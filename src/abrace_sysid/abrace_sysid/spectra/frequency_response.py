"""Transfer functions of recorded white-noise tests: the way in, with settings chosen by the record and the damping.

The paper's "FFT technique" behind Figs. 3 to 5, by Welch's method, the local polynomial method or the local rational
method.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from abrace_core.errors import AbraceError
from abrace_sysid.spectra.fourier import LEAST_BANDWIDTH, ORDER, all_of, automatic_half_width, held_input
from abrace_sysid.spectra.local_polynomial import local_polynomial, local_rational, local_responses
from abrace_sysid.spectra.transfer_function import FrequencyResponse, fitted_delay, hold_and_delay
from abrace_sysid.spectra.welch import Estimator, welch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_core.run import Run

__all__ = [
    "Choice",
    "FrequencyResponse",
    "fitted_delay",
    "frequency_responses",
    "held_input",
    "hold_and_delay",
    "local_polynomial",
    "local_rational",
    "local_responses",
    "welch",
]

LONGEST_SEGMENT = 32768
"""Samples in a piece of Welch's method: 65 s at 500 Hz, lines of 0.015 Hz."""

Method = Literal["local_rational", "local_polynomial", "welch"]


@dataclass(frozen=True)
class Choice:
    """A method and its settings; what is 0 follows from the record.

    The default is the local rational method for every record: worst channel's rms error in % over the band, worst of
    three seeds, 65 dB sensors, every other method at its best settings:

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
        Of the local methods. By default 2 and what `automatic_half_width` says of record and damping for the rational
        one, 4 and 6 for the polynomial one.
    segment
        Samples in each piece of Welch's method. By default 32768, or what gives a shorter record four pieces.
    window, overlap, estimator
        Of Welch's method, see `welch`.
    bandwidth
        2 zeta omega [rad/s] of the least damped mode expected.
    """

    method: Method = "local_rational"
    order: int = 0
    half_width: int = 0
    segment: int = 0
    window: str = "hann"
    overlap: float = 0.5
    estimator: Estimator = "H1"
    bandwidth: float = LEAST_BANDWIDTH


def frequency_responses(
    run: Run | Sequence[Run], inputs: Sequence[str], band: tuple[float, float], choice: Choice | None = None
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
    choice
        Method and settings; by default those of `Choice`.

    Raises
    ------
    AbraceError
        If the tests are too short for the method, or the method has no such name.
    """
    choice = choice or Choice()
    runs = all_of(run)
    shortest = min(len(each.outputs) for each in runs)
    if choice.method == "welch":
        segment = choice.segment or min(LONGEST_SEGMENT, shortest // 4)
        return tuple(
            welch(runs, name, band, segment, choice.estimator, choice.window, choice.overlap) for name in inputs
        )
    if choice.method == "local_polynomial":
        return local_responses(runs, inputs, band, choice.order or 4, choice.half_width or 6, poles=0)
    if choice.method == "local_rational":
        seconds = shortest * runs[0].sample_period
        half_width = choice.half_width or automatic_half_width(seconds, len(inputs), choice.bandwidth)
        return local_responses(runs, inputs, band, choice.order or ORDER, half_width)
    expected = "'local_rational', 'local_polynomial' or 'welch'"
    raise AbraceError(f"transfer functions: method {choice.method!r}, expected {expected}")

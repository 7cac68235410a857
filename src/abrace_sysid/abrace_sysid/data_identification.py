# SPDX-License-Identifier: Apache-2.0
"""Identification from measured data of any structure, without knowledge of what the channels mean.

transfer functions  from all inputs at once, by default by the local rational method
modes               found one by one (`mode_search`), then fitted together to the whole record by maximum likelihood
model               one state-space model for all inputs: these modes, and residual terms for modes above the band
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_sysid.fitting.mode_search import fit_with_residual_terms, search_modes, weighed
from abrace_sysid.fitting.observation import Observation
from abrace_sysid.fitting.vector_fitting import HEAVY_DAMPING
from abrace_sysid.models.modal import modal_model
from abrace_sysid.recordings import check_channels
from abrace_sysid.spectra.estimation import TransferFunctionOptions, frequency_responses
from abrace_sysid.spectra.fourier import spectra_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace_core.linear_model import LinearModel
    from abrace_sysid.fitting.pole_estimate import PoleEstimate, PoleInterval
    from abrace_sysid.measured_data import MeasuredData
    from abrace_sysid.spectra.frequency_response import FrequencyResponse

LEAST_LINES = 10
"""The default band begins at this multiple of the record's frequency resolution (1 / duration).

A slower mode completes fewer than ten periods within the record.
"""

LEAST_SAMPLES = 400
"""Samples that a record must have at least: half of a shorter one has too few lines for more than one or two modes."""


@dataclass(frozen=True)
class DataOptions:
    """How to identify from measured data.

    Parameters
    ----------
    band
        [Hz] that is used; all inputs must be excited in it. None: from ten times the frequency resolution to half the
        sample rate.
    most_modes
        Greatest number of modes (pole pairs and real poles) that are searched.
    transfer_function
        Method and settings of the transfer functions.
    """

    band: tuple[float, float] | None = None
    most_modes: int = 60
    transfer_function: TransferFunctionOptions = field(default_factory=TransferFunctionOptions)


@dataclass(frozen=True)
class DataIdentification:
    """The identified model of a structure, and the estimates from which it was computed.

    Parameters
    ----------
    data
        The data used, without the channels that do not respond to the inputs.
    band
        [Hz] that was used.
    responses
        Transfer functions from each input.
    estimate
        Poles and mode shapes fitted by maximum likelihood.
    model
        The same fit as a continuous state-space model.
    warnings
        About the data, one sentence each.
    """

    data: MeasuredData
    band: tuple[float, float]
    responses: tuple[FrequencyResponse, ...]
    estimate: PoleEstimate
    model: LinearModel
    warnings: tuple[str, ...]

    @property
    def pairs(self) -> tuple[PoleInterval, ...]:
        """Modes within the band with their intervals, lowest frequency first; without heavily damped pole pairs."""
        low, high = (2 * np.pi * edge for edge in self.band)
        modes = [pair for pair in self.estimate.pairs() if low <= pair.frequency <= high]
        return tuple(pair for pair in modes if pair.damping < HEAVY_DAMPING)


def identify_data(
    data: MeasuredData,
    options: DataOptions | None = None,
    progress: Callable[[str, float], None] = lambda _step, _fraction: None,
) -> DataIdentification:
    """Identify a structure from measured inputs and outputs.

    Parameters
    ----------
    data
        One test; all its inputs may be excited at once, by signals that are not proportional.
    options
        By default those of `DataOptions`.
    progress
        Called at the beginning of each step, with the step's name and the fraction of the work done.

    Raises
    ------
    AbraceError
        If the data or an option cannot be used, or no stable model is found.
    """
    options = options or DataOptions()
    if options.most_modes < 1:
        raise AbraceError(f"identification: most_modes {options.most_modes}, expected at least 1")
    samples = len(data.outputs)
    if samples < LEAST_SAMPLES:
        raise AbraceError(f"{data.source}: {samples} samples, expected at least {LEAST_SAMPLES}")
    band = options.band or (LEAST_LINES / data.seconds, 0.5 / data.sample_period)
    progress("checking the data", 0.0)
    left_out, warnings = check_channels(data, data.inputs, band)
    data = data.select([name for name in data.names if name not in left_out])
    progress("transfer functions", 0.05)
    responses = frequency_responses(data, data.inputs, band, options.transfer_function)

    def observed(part: MeasuredData) -> Observation:
        return Observation.of_spectra(spectra_of(part, part.inputs, band), part.source)

    def found_so_far(modes: int) -> None:
        progress(f"modes: {modes}", 0.1 + 0.8 * modes / (modes + 10))

    found_so_far(0)
    whole = observed(data)
    halves = observed(data.part(0, samples // 2)), observed(data.part(samples // 2, samples))
    poles = search_modes(halves, options.most_modes, found_so_far)
    progress("maximum likelihood", 0.9)
    estimate = fit_with_residual_terms(whole, poles, spread="none")
    estimate = fit_with_residual_terms(weighed([whole], estimate)[0], estimate.poles[: len(poles)])
    provenance = {
        "data": data.source,
        "seconds": data.seconds,
        "band": list(band),
        "method": responses[0].method,
        "options": asdict(options),
        "hold": data.hold,
        "states": f"{len(poles)} modes by maximum likelihood, and one pair for each input that represents modes above",
    }
    progress("identified", 1.0)
    return DataIdentification(data, band, responses, estimate, modal_model(estimate, provenance), warnings)

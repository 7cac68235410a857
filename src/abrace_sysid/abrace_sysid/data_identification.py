# SPDX-License-Identifier: Apache-2.0
"""Identification from measured data of any structure: the chain of the rig's own tests, without the rig.

transfer functions  from all inputs at once, by the local rational method
modes               found one by one (`mode_search`), then all by maximum likelihood from the whole record
model               those modes and what the modes above the band leave in it: one state-space model for all inputs
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
"""By default the band begins there: slower modes hardly oscillate within the record."""

LEAST_SAMPLES = 400
"""Shorter records have too few lines, of each half, for anything but one or two modes."""


@dataclass(frozen=True)
class DataOptions:
    """How to identify from measured data.

    Parameters
    ----------
    band
        [Hz] within which the data are used, and all inputs are excited; None: from ten lines to half the sample rate.
    most_modes
        Pairs, and real poles, at most.
    transfer_function
        Method and settings.
    """

    band: tuple[float, float] | None = None
    most_modes: int = 60
    transfer_function: TransferFunctionOptions = field(default_factory=TransferFunctionOptions)


@dataclass(frozen=True)
class DataIdentification:
    """The model of a structure, with what it was made from.

    Parameters
    ----------
    data
        The outputs that respond.
    band
        [Hz] that was used.
    responses
        Transfer functions from each input.
    estimate
        The fit by maximum likelihood.
    model
        The continuous model that it is.
    warnings
        On the data, one sentence each.
    """

    data: MeasuredData
    band: tuple[float, float]
    responses: tuple[FrequencyResponse, ...]
    estimate: PoleEstimate
    model: LinearModel
    warnings: tuple[str, ...]

    @property
    def pairs(self) -> tuple[PoleInterval, ...]:
        """Modes within the band with their intervals, slowest first; without pairs so damped that they are none."""
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
        Called with the step that begins and the fraction done.

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
        "states": f"{len(poles)} modes by maximum likelihood, and one pair for each input that stands for modes above",
    }
    progress("identified", 1.0)
    return DataIdentification(data, band, responses, estimate, modal_model(estimate, provenance), warnings)

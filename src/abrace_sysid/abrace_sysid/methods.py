# SPDX-License-Identifier: Apache-2.0
"""The methods of identification: each takes the tests with their transfer functions and gives poles and models.

- paper: Eqs. (1) to (7) of the paper, on the transfer functions
- vector_fitting: common poles of all channels of the transfer functions, in one model for all inputs
- maximum_likelihood: these poles refined on the spectra, with intervals and a covariance
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_core.model.linear_model import pole_table
from abrace_sysid.fitting.pole_estimate import PoleInterval
from abrace_sysid.fitting.pole_fits import PoleFit, fit_modes
from abrace_sysid.models.modal import modal_covariance, modal_model, servo_lags, without_lags
from abrace_sysid.models.realization import realize
from abrace_sysid.paper import paper_model, superpose

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_sysid.fitting.options import IdentificationOptions
    from abrace_sysid.input_tests import InputTests
    from abrace_sysid.spectra.frequency_response import FrequencyResponse


class Fitted(NamedTuple):
    """What a method finds.

    Parameters
    ----------
    poles
        Poles of the tests on the table, with commands, and of both; mode shapes, if the method has them.
    model
        For prediction.
    whole
        The model to be reduced, each servo's lag and delay as the input delay of its command.
    superposed
        Eqs. (6) and (7).
    lags
        Lag and delay of each command [s].
    covariance
        Of the parameters of `model`; None: the method gives none.
    """

    poles: PoleFit
    model: LinearModel
    whole: LinearModel
    superposed: LinearModel
    lags: dict[str, float]
    covariance: NDArray[np.float64] | None = None


def fit(
    table: InputTests,
    commands: Sequence[InputTests],
    floors: int,
    options: IdentificationOptions,
    progress: Callable[[str, float], None],
) -> Fitted:
    """Poles and models by the method that the options name.

    Parameters
    ----------
    floors
    table, commands
        The tests on the table, and of each command.
    options
        Those of the identification.
    progress
        Called with the step that begins and the fraction done.

    Raises
    ------
    AbraceError
        If a fit fails, or a pole is unstable.
    """
    if options.method == "paper":
        return _paper(table, commands, floors, options)
    poles = fit_modes(table, commands, floors, options, progress)
    assert poles.estimate is not None
    progress("numerators", 0.85)
    highest = float(commands[0].responses[0].omega[-1])
    lags = {data.input: options.servo_lag for data in commands} | servo_lags(poles.estimate, highest)
    model, whole = modal_model(poles.estimate, {}), modal_model(without_lags(poles.estimate, highest), {})
    covariance = modal_covariance(poles.estimate)
    return Fitted(poles, model, whole, _superposed(table, commands, poles, lags), lags, covariance)


def _paper(table: InputTests, commands: Sequence[InputTests], floors: int, options: IdentificationOptions) -> Fitted:
    """By the paper: 24 states for three floors are the only model."""
    found = paper_model(
        table.responses[0],
        [data.responses[0] for data in commands],
        floors,
        2 * options.modes,
        options.lambda_power,
        options.lambda_steps,
        options.servo_lag,
    )
    table_pairs, command_pairs = (
        tuple(PoleInterval(*pair) for pair in pole_table(poles)) for poles in (found.table, found.command)
    )
    pairs = found.command[found.command.imag > 0][:floors]
    building = np.column_stack([pairs, pairs.conj()]).ravel()
    poles = PoleFit(found.table, found.command, table_pairs, command_pairs, command_pairs, building)
    lags = {data.input: options.servo_lag for data in commands}
    return Fitted(poles, found.model, found.model, found.model, lags)


def _superposed(
    table: InputTests, commands: Sequence[InputTests], poles: PoleFit, delays: Mapping[str, float]
) -> LinearModel:
    """Eqs. (3) to (7) with given poles: one part for the table, two for each command (accelerations; all others)."""
    accelerations = [name for name in table.outputs if name.startswith("a")]
    others = [name for name in table.outputs if name not in accelerations]

    def of(data: InputTests, outputs: Sequence[str]) -> list[FrequencyResponse]:
        return [response.select(outputs) for response in data.responses]

    parts = [realize(of(table, table.outputs), poles.table)]
    for command in commands:
        if accelerations:
            parts.append(realize(of(command, accelerations), poles.command, delays[command.input]))
        if others:
            parts.append(realize(of(command, others), poles.building, delays[command.input]))
    return superpose(parts, (table.input, *(command.input for command in commands)), table.outputs)

# SPDX-License-Identifier: Apache-2.0
"""The options of an identification, from its transfer functions to its reduced model."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from abrace_core import signals
from abrace_sysid.spectra.bands import common_band
from abrace_sysid.spectra.estimation import TransferFunctionOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_core.run import Run

FIT_METHODS = ("maximum_likelihood", "vector_fitting", "sk", "paper")
"""Methods of fitting poles, see `pole_fits`."""

AS_EXCITED = (0.0, 0.0)
"""Instead of a band: the band that the tests excite."""


@dataclass(frozen=True)
class IdentificationOptions:
    """Options of an identification.

    Parameters
    ----------
    transfer_function
        Method and settings for tests with noise; periodic tests are averaged over their periods.
    fit
        Method for the poles: one of FIT_METHODS.
    table_band, command_band
        Bands [Hz] in which the tests are used; the tests must excite all of the band. AS_EXCITED: all that they excite.
    command_order
        Number of oscillating poles in the response to the commands (A2), even; 0: chosen from the tests by description
        length, by `maximum_likelihood` only; the other fits need a number.
    servo_lag
        Lag of the actuators from a bench test [s] (Fig. 2); 0: no bench test. `maximum_likelihood` compares it with the
        lag that it estimates; the other fits use it as given.
    reduced_order
        States of the reduced model; 0: the number of significant Hankel singular values.
    """

    transfer_function: TransferFunctionOptions = field(default_factory=TransferFunctionOptions)
    fit: str = "maximum_likelihood"
    table_band: tuple[float, float] = AS_EXCITED
    command_band: tuple[float, float] = AS_EXCITED
    command_order: int = 0
    servo_lag: float = 0.0
    reduced_order: int = 0

    def of_tests(self, table: Sequence[Run], command: Sequence[Run]) -> IdentificationOptions:
        """The same options, with the bands that the tests excite in place of those not given.

        Parameters
        ----------
        table, command
            The tests on the table, and with commands; at least one of each.
        """
        table_band, command_band = self.table_band, self.command_band
        if table_band == AS_EXCITED:
            table_band = common_band(table, (signals.GROUND,))
        if command_band == AS_EXCITED:
            command_band = common_band(command, command[0].command_names)
        return replace(self, table_band=table_band, command_band=command_band)

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
"""Of the poles, see `pole_fits`."""

AS_EXCITED = (0.0, 0.0)
"""In place of a band: the one that the tests excite."""


@dataclass(frozen=True)
class IdentificationOptions:
    """How to identify.

    Parameters
    ----------
    transfer_function
        Method and settings for tests with noise; periodic tests are averaged over their periods.
    fit
        Of the poles: one of FIT_METHODS.
    table_band, command_band
        [Hz] within which the tests are used; they must be excited throughout. AS_EXCITED: all that they excite.
    command_order
        Oscillating poles of the response to the commands (A2), even; 0: as many as the tests show, by description
        length. The other fits than `maximum_likelihood` have to be given it.
    servo_lag
        Of the actuators, from a bench test [s] (Fig. 2), with which what the tests show is compared; 0: there was none.
        The other fits than `maximum_likelihood`, which do not measure it, take it as it is.
    reduced_order
        States of the reduced model; 0: as many as have a Hankel singular value that counts.
    """

    transfer_function: TransferFunctionOptions = field(default_factory=TransferFunctionOptions)
    fit: str = "maximum_likelihood"
    table_band: tuple[float, float] = AS_EXCITED
    command_band: tuple[float, float] = AS_EXCITED
    command_order: int = 0
    servo_lag: float = 0.0
    reduced_order: int = 0

    def of_tests(self, table: Sequence[Run], command: Sequence[Run]) -> IdentificationOptions:
        """The same with the bands that these tests excite, where none are given.

        Parameters
        ----------
        table, command
            The tests on the table, and with commands; one at least of each.
        """
        table_band, command_band = self.table_band, self.command_band
        if table_band == AS_EXCITED:
            table_band = common_band(table, (signals.GROUND,))
        if command_band == AS_EXCITED:
            command_band = common_band(command, command[0].command_names)
        return replace(self, table_band=table_band, command_band=command_band)

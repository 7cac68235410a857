# SPDX-License-Identifier: Apache-2.0
"""The options of an identification: keywords in Python, parameters of the node `identify`, keys of a campaign."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from abrace_core import AbraceError
from abrace_core.files.options import NOT_GIVEN, Band, Count, NonNegative
from abrace_core.model import signals
from abrace_sysid.spectra.bands import common_band
from abrace_sysid.spectra.estimation import TransferFunctionOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_sysid.recorded.test import Test

POWER, STEPS = -8.0, 10
"""lambda = w^POWER in the first step of the paper's curve fits, then 1 / |A|^2 of the step before, STEPS times."""


MORE_PAIRS = 3
"""Pole pairs of A2 beyond the building's: the paper found three that "come from the dynamics of control devices"."""

REALS = 2
"""Greatest number of real poles of a servo; the table's tests may show one more."""


class IdentificationOptions(TransferFunctionOptions):
    """Options of an identification, each with its meaning, range and default."""

    who: ClassVar[str] = "identification"

    method: Literal["maximum_likelihood", "vector_fitting", "paper"] = Field(
        default="maximum_likelihood", description="how poles and models are fitted"
    )
    table_band: Band = Field(default=NOT_GIVEN, description="Hz, band used of the table's tests; 0, 0: as excited")
    command_band: Band = Field(default=NOT_GIVEN, description="Hz, band used of the commands' tests; 0, 0: as excited")
    modes: Count = Field(
        default=0,
        description="number of pole pairs in the commands' tests; 0: found from the tests, by the method paper one for "
        "each floor and three",
    )
    lambda_power: float = Field(
        default=POWER,
        description="method paper: the weights of Eq. (1) are this power of the frequency in the first step",
    )
    lambda_steps: Count = Field(
        default=STEPS, description="method paper: further steps, weighted by the poles of the step before"
    )
    servo_lag: NonNegative = Field(default=0.0, description="s, lag of the actuators in a bench test; 0: no such test")
    reduced_order: Count = Field(default=0, description="states of the reduced model; 0: from singular values")

    def require_possible(self, floors: int, groups: int) -> None:
        """Check that a rig of so many `floors` and brace `groups` can be identified with these options.

        Raises
        ------
        AbraceError
            If not.
        """
        if not groups:
            raise AbraceError("identification: a rig without braces, expected one group at least")
        if self.modes and self.modes < floors:
            raise AbraceError(f"identification: modes {self.modes}, expected at least {floors}, one for each floor")
        least, given = 2 * floors, 2 * self.modes
        most = float("inf")
        if self.method == "paper":
            most = least + groups * (least + (given or least + 2 * MORE_PAIRS))
        elif given:
            most = given + REALS * groups + 1
        if self.reduced_order > most:
            whole = f"the {most:g} states of the model by method {self.method}"
            raise AbraceError(f"identification: reduced_order {self.reduced_order}, expected at most {whole}")

    def of_tests(self, table: Sequence[Test], command: Sequence[Test]) -> IdentificationOptions:
        """The same options, with the bands that the tests excite in place of those not given.

        Parameters
        ----------
        table, command
            The tests on the table, and with commands; at least one of each. A band from 0 Hz begins at the first line
            of the spectrum of the longest one: means are removed.
        """
        bands = {}
        for name, tests, inputs in (
            ("table_band", table, (signals.GROUND,)),
            ("command_band", command, command[0].commands),
        ):
            band = getattr(self, name)
            low, high = common_band(tests, inputs) if band == NOT_GIVEN else band
            bands[name] = low or 1 / max(test.seconds for test in tests), high
        return self.model_copy(update=bands)

    def band_of(self, test: Test) -> tuple[float, float]:
        """The band [Hz] of a `test`: that of the commands if one moves."""
        return self.command_band if test.moving else self.table_band

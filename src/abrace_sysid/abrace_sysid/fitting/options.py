"""The options of an identification, from its transfer functions to its reduced model."""

from __future__ import annotations

from dataclasses import dataclass, field

from abrace_sysid.spectra.estimation import TransferFunctionOptions

FIT_METHODS = ("maximum_likelihood", "vector_fitting", "sk", "paper")
"""Of the poles, see `pole_fits`."""


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
        [Hz] within which the tests are used; they must be excited throughout.
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
    table_band: tuple[float, float] = (0.3, 10.0)
    command_band: tuple[float, float] = (0.3, 30.0)
    command_order: int = 0
    servo_lag: float = 0.0
    reduced_order: int = 0

"""The whole chain: two recorded white-noise tests to the 24-state model and its reduced one (Eqs. 1 to 9).

table test    w to z: 2 floors poles from the top floor's acceleration (A1), then C1 and D1
command test  U to z: 12 poles from the top floor's acceleration (A2), C2 and D2 for the accelerations;
              the building's poles among them (A3), C3 and D3 for displacements, strokes and forces
superposed, then balanced and cut
"""

from __future__ import annotations

import itertools
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy import fft

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel, pole_table
from abrace_sysid.curve_fit import fit_sanathanan_koerner, require_stable, uncertainty_weights
from abrace_sysid.frequency_response import FrequencyResponse, held_input, local_polynomial, welch
from abrace_sysid.realization import realize, superpose
from abrace_sysid.reduction import Reduction, balanced_truncation, typical_scales

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from abrace_core.run import Run

Method = Literal["local_polynomial", "welch"]

LEAST_SECONDS = 60.0
"""Shorter tests do not resolve modes of 1 % damping near 1 Hz."""

REST = 0.05
"""A table at rest moves less than this share of a table that is shaken: sensor noise alone."""


@dataclass(frozen=True)
class IdentificationOptions:
    """How to identify.

    Parameters
    ----------
    method
        Of the transfer functions: "local_polynomial" or "welch".
    order, half_width
        Of the local polynomial method.
    segment
        Samples in each piece of Welch's method.
    table_band, command_band
        [Hz] within which the tests are used; they must be excited throughout.
    command_order
        Poles of the accelerations' response to the command (A2), even.
    servo_lag
        Of the actuators, from the bench test [s] (Fig. 2).
    reduced_order
        States of the reduced model.
    """

    method: Method = "local_polynomial"
    order: int = 4
    half_width: int = 6
    segment: int = 32768
    table_band: tuple[float, float] = (0.3, 10.0)
    command_band: tuple[float, float] = (0.3, 30.0)
    command_order: int = 12
    servo_lag: float = 0.0008
    reduced_order: int = 8


@dataclass(frozen=True)
class Identification:
    """What two tests gave.

    Parameters
    ----------
    table_response, command_response
        The measured transfer functions, of the sampled rig.
    table_poles, command_poles
        Eigenvalues of A1 and A2 [rad/s], slowest first.
    model
        Eqs. (6) and (7); 24 states for three floors. The servo's lag is its input delay.
    reduction
        Eq. (9): the reduced model and the Hankel singular values.
    """

    table_response: FrequencyResponse
    command_response: FrequencyResponse
    table_poles: NDArray[np.complex128]
    command_poles: NDArray[np.complex128]
    model: LinearModel
    reduction: Reduction

    @property
    def reduced(self) -> LinearModel:
        """The reduced model."""
        return self.reduction.model

    @property
    def hankel_singular_values(self) -> NDArray[np.float64]:
        """(states,) of the whole model in balancing units, greatest first."""
        return self.reduction.hankel_singular_values


def identify(
    table: Run,
    command: Run,
    options: IdentificationOptions | None = None,
    progress: Callable[[str, float], None] = lambda _step, _fraction: None,
) -> Identification:
    """Identify the braced building from two tests.

    Parameters
    ----------
    table
        White noise on the table, zero command.
    command
        White noise as command, the table at rest.
    options
        How.
    progress
        Called with what begins and the fraction done.

    Raises
    ------
    AbraceError
        If the tests are not what they should be, or what was fitted is not stable.
    """
    options = options or IdentificationOptions()
    progress("checking the tests", 0.0)
    _check(table, command, options)
    floors, outputs = table.floors, table.names
    (command_name,) = command.command_names
    accelerations = outputs[floors + 1 : 2 * floors + 1]
    others = tuple(name for name in outputs if name not in accelerations)

    progress("transfer functions from the table", 0.1)
    table_response = _frequency_response(table, signals.GROUND, options.table_band, options)
    progress("transfer functions from the command", 0.25)
    command_response = _frequency_response(command, command_name, options.command_band, options)

    progress("curve fitting, table", 0.5)
    top = accelerations[-1]
    table_hold = np.sinc(table_response.omega * table.sample_period / (2 * np.pi)) ** 2
    table_poles = _poles(table_response, top, table_hold.astype(np.complex128), 2 * floors, floors, table.source)
    progress("curve fitting, command", 0.6)
    command_hold = np.sinc(command_response.omega * command.sample_period / (2 * np.pi)) * np.exp(
        -1j * command_response.omega * (options.servo_lag + command.sample_period / 2)
    )
    command_poles = _poles(command_response, top, command_hold, options.command_order, floors, command.source)
    building_poles = command_poles[: 2 * floors]

    progress("realisation and superposition", 0.8)
    parts = (
        realize(table_response, table_poles),
        realize(command_response.select(accelerations), command_poles, options.servo_lag),
        realize(command_response.select(others), building_poles, options.servo_lag),
    )
    provenance = {
        "bags": {"table": table.source, "command": command.source},
        "seconds": {
            run: len(test.outputs) * test.sample_period for run, test in (("table", table), ("command", command))
        },
        "method": {"table": table_response.method, "command": command_response.method},
        "options": asdict(options),
    }
    model = superpose(parts, (signals.GROUND, command_name), outputs)
    model = replace(model, provenance={**provenance, "states": "superposed, Eqs. (6) and (7)"})
    progress("balanced reduction", 0.9)
    reduction = balanced_truncation(model, options.reduced_order, typical_scales(model, options.command_band))
    reduced = replace(reduction.model, provenance={**provenance, "states": "balanced truncation, Eq. (9)"})
    progress("identified", 1.0)
    return Identification(
        table_response, command_response, table_poles, command_poles, model, replace(reduction, model=reduced)
    )


def _frequency_response(
    run: Run, input_name: str, band: tuple[float, float], options: IdentificationOptions
) -> FrequencyResponse:
    if options.method == "welch":
        return welch(run, input_name, band, options.segment)
    return local_polynomial(run, input_name, band, options.order, options.half_width)


def _poles(
    response: FrequencyResponse, output: str, hold: NDArray[np.complex128], order: int, floors: int, source: str
) -> NDArray[np.complex128]:
    """Stable poles of one output's response with the hold and the lag taken out; the slowest are `floors` pairs."""
    one = response.divided_by(hold).select([output])
    g, sigma = one.response[:, 0], one.sigma[:, 0]
    fit = fit_sanathanan_koerner(one.omega, g, order, order, uncertainty_weights(g, sigma))
    where = f"{source}: curve fit of {output} from {response.input}, order {order}"
    poles = require_stable(fit.poles(), where)
    pairs = pole_table(poles[: 2 * floors])
    if len(pairs) != floors:
        raise AbraceError(
            f"{where}: the slowest {2 * floors} poles have {len(pairs)} oscillating pairs, expected {floors}"
        )
    return poles


def _check(table: Run, command: Run, options: IdentificationOptions) -> None:
    """That the options can be met and the tests are what they should be."""
    if options.method not in ("local_polynomial", "welch"):
        raise AbraceError(f"identification: method {options.method!r}, expected 'local_polynomial' or 'welch'")
    if not (options.servo_lag >= 0 and np.isfinite(options.servo_lag)):
        raise AbraceError(f"identification: servo_lag {options.servo_lag} s, expected a number >= 0")
    for run in (table, command):
        if run.groups != 1:
            raise AbraceError(f"{run.source}: {run.groups} brace groups, expected 1")
        seconds = len(run.outputs) * run.sample_period
        if seconds < LEAST_SECONDS:
            raise AbraceError(f"{run.source}: {seconds:g} s, expected at least {LEAST_SECONDS:g} s")
        gaps = np.flatnonzero(np.diff(run.sequence.astype(np.int64)) != 1)
        if len(gaps):
            after = run.sequence[gaps[0]]
            raise AbraceError(f"{run.source}: a gap after sample {after}, expected consecutive sample numbers")
        for name in (*run.names, signals.GROUND, *run.command_names):
            if not np.isfinite(run.channels([name])).all():
                raise AbraceError(f"{run.source}: channel {name} has a value that is not finite")
        for name in run.names:
            if not np.ptp(run.channels([name])):
                raise AbraceError(f"{run.source}: channel {name} never changes, expected a response")
    _expect_same(table, command, "floors", table.floors, command.floors)
    _expect_same(table, command, "sample period", table.sample_period, command.sample_period)
    if "rig" in table.facts and "rig" in command.facts:
        _expect_same(table, command, "rig", table.facts["rig"], command.facts["rig"])
    floors = table.floors
    if options.command_order < 2 * floors or options.command_order % 2:
        expected = f"an even number of at least {2 * floors}"
        raise AbraceError(f"identification: command_order {options.command_order}, expected {expected}")

    if np.any(table.command):
        raise AbraceError(
            f"{table.source}: a table test with commands up to {np.abs(table.command).max():g} N, expected 0"
        )
    moved, rest = (float(np.std(run.ground_acceleration)) for run in (table, command))
    if not moved * REST > rest:
        raise AbraceError(
            f"{table.source}: rms ground acceleration {moved:.3g} m/s^2, and {rest:.3g} in the command test "
            f"{command.source}; expected the first shaken and the second at rest (less than {REST:g} of the first)"
        )
    _expect_excited(table, signals.GROUND, options.table_band)
    _expect_excited(command, command.command_names[0], options.command_band)


def _expect_same(table: Run, command: Run, what: str, one: object, other: object) -> None:
    if one != other:
        raise AbraceError(f"{command.source}: {what} {other}, but {one} in {table.source}: expected the same rig")


def _expect_excited(run: Run, name: str, band: tuple[float, float]) -> None:
    """That the input has power in every tenth of the band."""
    excitation = held_input(run, name)
    half = 0.5 / run.sample_period
    if not 0 <= band[0] < band[1] <= half:
        raise AbraceError(
            f"identification: band {band[0]:g} to {band[1]:g} Hz for {name}, expected within 0 to {half:g} Hz"
        )
    power = np.abs(fft.rfft(excitation - excitation.mean())) ** 2
    frequency = fft.rfftfreq(len(excitation), run.sample_period)
    edges = np.linspace(*band, 11)
    share = np.array([power[(frequency >= a) & (frequency < b)].mean() for a, b in itertools.pairwise(edges)])
    weak = np.flatnonzero(~(share > 1e-3 * share.max()))
    if len(weak):
        low, high = edges[weak[0]], edges[weak[0] + 1]
        raise AbraceError(
            f"{run.source}: {name} is not excited from {low:.3g} to {high:.3g} Hz, "
            f"expected noise from {band[0]:g} to {band[1]:g} Hz"
        )

# SPDX-License-Identifier: Apache-2.0
"""Poles of the table test, of the command test and of both, by a method chosen by name.

- maximum_likelihood: all channels, leakage, the servos' real poles and delays in the model, with confidence intervals;
  orders chosen from the data by description length
- vector_fitting: common poles of all channels of the transfer functions
- sk: Sanathanan-Koerner iterations on the top floor's acceleration, weighted by its uncertainty
- paper: Eqs. (1) and (2) on the top floor's acceleration, unweighted, the sign in Eq. (1) corrected

The last two fit a ratio of polynomials of s. Hold and servo lag are not such ratios and are divided out first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_core.linear_model import pole_table
from abrace_sysid.fitting.building_modes import building_modes, same_modes
from abrace_sysid.fitting.covariance import LEAST_PIECES
from abrace_sysid.fitting.curve_fit import fit_rational, fit_sanathanan_koerner, require_stable, uncertainty_weights
from abrace_sysid.fitting.maximum_likelihood import fit_poles
from abrace_sysid.fitting.mode_search import weighed
from abrace_sysid.fitting.observation import Observation
from abrace_sysid.fitting.order_selection import Order, no_modes, search_order
from abrace_sysid.fitting.pole_estimate import PoleInterval
from abrace_sysid.fitting.slow_pole import slow_real_pole
from abrace_sysid.fitting.vector_fitting import modes_of, vector_fitting
from abrace_sysid.spectra.fourier import spectra_of
from abrace_sysid.spectra.periodic_response import periodic_response

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.options import IdentificationOptions
    from abrace_sysid.fitting.pole_estimate import PoleEstimate
    from abrace_sysid.spectra.frequency_response import FrequencyResponse
    from abrace_sysid.spectra.measured_tests import TestData

NEIGHBOURS = 17
"""Lines over which the level of a fit's residual is averaged: 0.06 Hz for a record of 300 s."""


ROUNDING = 1e-9
"""By this share a band is widened, so that rounding leaves out no line at its edges."""


@dataclass(frozen=True)
class PoleFit:
    """The poles by one method.

    Parameters
    ----------
    table
        (2 modes,) A1: the building's poles from the table test [rad/s], conjugates too, slowest first.
    command
        (2 pairs,) A2: all pairs of the command test, in the same order.
    of_model
        The common poles of both inputs, with the servo's slow real pole, for the consistent model.
    table_pairs, command_pairs, common_pairs
        Frequency and damping of the pairs with their standard deviations; NaN if the method gives none.
    building
        (2 floors,) the building's poles from the command test.
    estimate
        The modes of all tests by maximum likelihood; None with another method.
    warnings
        On the modes, one sentence each.
    """

    table: NDArray[np.complex128]
    command: NDArray[np.complex128]
    of_model: NDArray[np.complex128]
    table_pairs: tuple[PoleInterval, ...]
    command_pairs: tuple[PoleInterval, ...]
    common_pairs: tuple[PoleInterval, ...]
    building: NDArray[np.complex128]
    estimate: PoleEstimate | None = None
    warnings: tuple[str, ...] = ()


def fit_poles_of(
    table: TestData,
    commands: Sequence[TestData],
    floors: int,
    options: IdentificationOptions,
    progress: Callable[[str, float], None],
) -> PoleFit:
    """The poles by the method that the options name.

    Parameters
    ----------
    table, commands
        The tests on the table, and of each command.
    floors
        Number of floors, and of the building's modes.
    options
        `fit`, `command_order` and `servo_lag` are used.
    progress
        Called with the step that begins and the fraction done.

    Raises
    ------
    AbraceError
        If a fit fails, a pole is unstable, or the building's modes are not among the poles.
    """
    if options.fit == "maximum_likelihood":
        return _maximum_likelihood(table, commands, floors, options, progress)
    if len(commands) > 1:
        raise AbraceError(f"identification: fit {options.fit} of {len(commands)} commands, expected maximum_likelihood")
    building = _by_curve_fit(table, 2 * floors, options, floors)
    everything = _by_curve_fit(commands[0], options.command_order, options, floors)
    slowest = [(one + other) / 2 for one, other in zip(building, everything[:floors], strict=True)]
    common = _with_conjugates(np.array([*slowest, *everything[floors:]]))
    slow = slow_real_pole(table.responses[0], common)
    return PoleFit(
        _with_conjugates(building),
        _with_conjugates(everything),
        common if slow is None else np.append(common, slow),
        _without_deviation(building),
        _without_deviation(everything),
        _without_deviation(common),
        _with_conjugates(everything[:floors]),
    )


def steady(data: TestData, estimate: PoleEstimate) -> TestData:
    """Periodic tests with the free decay of the modes of a fit removed from the responses; others as they are.

    Parameters
    ----------
    data
        The tests of one input.
    estimate
        The fit.
    """
    if not data.periodic:
        return data
    omega = data.responses[0].omega
    band = float(omega[0] / (2 * np.pi)), float(omega[-1] / (2 * np.pi))
    return replace(data, responses=tuple(_without_decay(data, band, _upper(estimate.poles))))


def _maximum_likelihood(
    table: TestData,
    commands: Sequence[TestData],
    floors: int,
    options: IdentificationOptions,
    progress: Callable[[str, float], None],
) -> PoleFit:
    """Fit table and commands alone, then both with common modes: the commands', some of which the table shows."""
    responses = [data.responses[0] for data in commands]
    if len(table.together) > 1:
        progress("maximum likelihood, both", 0.5)
        of_both = _of_tests_with_all_inputs(table, commands, floors, options)
        of_table = of_command = of_both
    else:
        of_table, of_command, of_both = _of_tests_apart(table, commands, floors, options, progress)
    highest = responses[0].omega[-1]
    building = building_modes(of_both, floors)
    if not len(building):
        raise AbraceError(f"{table.source}: no pair is a mode of the building, expected up to {floors}")
    in_table, in_command = (same_modes(of_both, building, other) for other in (of_table, of_command))
    reals = _reals(of_both.poles)
    heavy = no_modes(of_both, responses[0].omega)
    return PoleFit(
        _with_conjugates(of_table.poles[in_table[in_table >= 0]]),
        _with_conjugates(_upper(of_command.poles)),
        np.concatenate([_with_conjugates(_upper(of_both.poles)), reals[np.abs(reals) <= highest]]),
        _pairs_at(of_table, in_table),
        tuple(of_command.pairs()),
        tuple(pair for pair in of_both.pairs() if pair not in heavy),
        _with_conjugates(of_command.poles[in_command[in_command >= 0]]),
        of_both,
        _remarks(table, of_both, building, in_table, heavy, floors),
    )


def _of_tests_with_all_inputs(
    table: TestData, commands: Sequence[TestData], floors: int, options: IdentificationOptions
) -> PoleEstimate:
    """The modes of tests in which table and commands were excited at once by noise."""
    responses = side_by_side([data.responses[0] for data in (table, *commands)])
    given, groups = options.command_order // 2, len(commands)
    tests = _observations([table])
    first = search_order(tests, responses, given or floors, _servos(groups), groups, given > 0)
    tests, found = _with_noise_as_found(tests, first)
    return fit_poles(tests, found, spread="joint")


def _of_tests_apart(
    table: TestData,
    commands: Sequence[TestData],
    floors: int,
    options: IdentificationOptions,
    progress: Callable[[str, float], None],
) -> tuple[PoleEstimate, PoleEstimate, PoleEstimate]:
    """The modes of the table tests, of the command tests, and of all tests together."""
    top, highest = (data.responses[0].omega[-1] for data in (table, commands[0]))
    progress("maximum likelihood, table", 0.5)
    from_table, measured = _observations([table]), table.responses[0]
    of_table = search_order(from_table, measured, floors, [Order(0, 1), Order(0, 0)])
    from_table, of_table = _with_noise_as_found(_steady([table], from_table, of_table), of_table)
    progress("maximum likelihood, command", 0.6)
    from_command, groups = _observations(commands), len(commands)
    responses = [data.responses[0] for data in commands]
    # multisines share the lines: the lines of each are too far apart for interpolation
    together = responses if commands[0].periodic else [side_by_side(responses)]
    given = options.command_order // 2
    of_command = search_order(from_command, together, given or floors, _servos(groups), groups, given > 0)
    from_command, of_command = _with_noise_as_found(_steady(commands, from_command, of_command), of_command)

    progress("maximum likelihood, both", 0.75)
    poles, drive = of_command.poles, of_command.drive
    slow = _reals(of_table.poles)
    if len(slow) and not (np.abs(_reals(poles)) < highest).any():
        # if filters and servo are slow, both real poles may represent them: the table test still shows the slow pole
        poles = np.append(poles, slow[:1])
        drive = np.vstack([drive, np.ones((1, len(commands)))])
    lags = (poles.imag == 0) & (np.abs(poles) > highest)
    shown = tuple(int(i) for i in np.flatnonzero((np.abs(poles) <= top) & ~lags))
    # each lag is driven by its own command alone, not by the table
    driven = np.hstack([np.ones((len(poles), 1), dtype=np.bool_), drive != 0])
    delays = np.concatenate([[np.nan], of_command.delays])
    tests = [*(replace(one, poles=shown) for one in from_table), *from_command]
    of_both = fit_poles(tests, poles, driven, spread="joint", delays=delays)
    return of_table, of_command, of_both


def _with_noise_as_found(
    observations: Sequence[Observation], estimate: PoleEstimate
) -> tuple[list[Observation], PoleEstimate]:
    """The tests with lines weighted by the residual of a first fit around them, and the fit of the weighted tests.

    The residual is larger at a resonance: noise of the measured input passes through the structure to all channels, and
    peaks are never exactly linear. The channels then contain less information than independent ones, and the weight of
    these tests among others is reduced by the increase of their poles' variance. A few multisines have too few lines
    around a resonance, and keep the noise levels from their periods. With more, these levels are not used: of each line
    they are known from a few others in between, and so uneven that some lines would count much too much.
    """
    found = list(observations)
    if observations[0].transient or len(observations) >= LEAST_PIECES:
        even = [one.with_noise(np.ones(len(one.z))) for one in observations]
        found = weighed(even, estimate, NEIGHBOURS)
    again = fit_poles(found, estimate)
    return [replace(one, weight=1 / again.inflation) for one in found], again


def _servos(groups: int) -> list[Order]:
    """Forms of the servos: with slow pole, lag and delay first, then simpler ones."""
    forms = [Order(0, 2, "delay", groups == 1), Order(0, 2, "lag", groups == 1), Order(0, 2), Order(0, 1), Order(0, 0)]
    return forms if groups == 1 else [*forms, Order(0, 2, "delay")]


def _pairs_at(estimate: PoleEstimate, places: NDArray[np.int64]) -> tuple[PoleInterval, ...]:
    """Frequency and damping of the pairs at the indices `places` among the poles; -1: none."""
    frequencies = np.abs(estimate.poles[places[places >= 0]])
    return tuple(pair for pair in estimate.pairs() if np.isclose(pair.frequency, frequencies, rtol=1e-12).any())


def _remarks(
    table: TestData,
    estimate: PoleEstimate,
    building: NDArray[np.int64],
    in_table: NDArray[np.int64],
    heavy: Sequence[PoleInterval],
    floors: int,
) -> tuple[str, ...]:
    """Warnings on the modes."""
    found = []
    if len(building) < floors:
        found.append(
            f"{len(building)} modes of the building are found, of {floors} floors: a wider band, a longer or a "
            "stronger test may show the others"
        )
    missed = [f"{abs(estimate.poles[mode]):.4g}" for mode, place in zip(building, in_table, strict=True) if place < 0]
    if missed:
        found.append(
            f"{table.source}: does not show the building's mode at {', '.join(missed)} rad/s: expected a table_band "
            "beyond it"
        )
    named = [f"{pair.frequency:.4g} rad/s, damping {pair.damping:.0%}" for pair in heavy]
    if named:
        found.append(f"command_order: the pairs at {'; '.join(named)} are no modes, and left out of the poles")
    return tuple(found)


def side_by_side(responses: Sequence[FrequencyResponse]) -> FrequencyResponse:
    """Responses to several inputs as channels of one response, at the lines of the first; for starting poles only.

    Parameters
    ----------
    responses
        Responses at about the same frequencies.
    """
    first = responses[0]

    def at_its_lines(other: FrequencyResponse, values: NDArray[Any]) -> NDArray[Any]:
        columns = [np.interp(first.omega, other.omega, column) for column in values.T]
        return np.column_stack(columns)

    names = tuple(f"{name} to {other.input}" for other in responses for name in other.outputs)
    # channels are normalised for each input: responses to N and to m/s^2 cannot be compared
    response = np.hstack([at_its_lines(other, other.response) for other in responses])
    sigma = np.hstack([at_its_lines(other, other.sigma) for other in responses])
    return replace(first, outputs=names, response=response, sigma=sigma)


def _observations(tests: Sequence[TestData], poles: NDArray[np.complex128] | None = None) -> list[Observation]:
    """Observations: of each test with noise its spectra with leakage, once; of a periodic test its responses.

    With `poles` [rad/s], their free decay is removed from periodic tests.
    """
    found = []
    for data in tests:
        omega = data.responses[0].omega
        band = (float(omega[0] / (2 * np.pi)), float(omega[-1] / (2 * np.pi)))
        if data.periodic:
            responses = data.responses if poles is None else _without_decay(data, band, poles)
            found += [Observation.of_response(one, run.source) for one, run in zip(responses, data.runs, strict=True)]
        elif data.input == data.together[0]:
            spectra = [spectra_of(run, data.together, band).select(data.outputs) for run in data.runs]
            found += [Observation.of_spectra(one, run.source) for one, run in zip(spectra, data.runs, strict=True)]
    return found


def _without_decay(data: TestData, band: tuple[float, float], poles: NDArray[np.complex128]) -> list[FrequencyResponse]:
    """The responses of periodic tests with the free decay of modes removed."""
    edges = band[0] * (1 - ROUNDING), band[1] * (1 + ROUNDING)
    found = [periodic_response(run, data.input, edges, poles=poles).frequency_response for run in data.runs]
    return [one.select(data.outputs) for one in found]


def _steady(
    tests: Sequence[TestData], observations: Sequence[Observation], estimate: PoleEstimate
) -> Sequence[Observation]:
    """Periodic tests without the free decay of the modes of a first fit; tests with noise as they are."""
    return _observations(tests, _upper(estimate.poles)) if tests[0].periodic else observations


def _by_curve_fit(data: TestData, order: int, options: IdentificationOptions, floors: int) -> NDArray[np.complex128]:
    """(order / 2,) upper poles of the pairs, slowest first; the slowest `floors` are the building's."""
    measured = data.responses[0]
    where = f"{data.source}: {options.fit} of {data.input}, order {order}"
    if options.fit == "vector_fitting":
        # and the servo's slow pole, together with a local mode (table) or the lag (command)
        fit = vector_fitting(measured, order + (3 if data.input == signals.GROUND else 2))
        poles = modes_of(fit, measured)[: order // 2]
    else:
        poles = _upper(require_stable(_ratio_of_polynomials(measured, order, options), where))
    poles = poles[np.argsort(np.abs(poles))]
    if len(poles) != order // 2 or len(pole_table(poles[:floors])) != floors:
        raise AbraceError(f"{where}: {len(poles)} oscillating pairs, expected {order // 2}")
    return np.asarray(poles)


def _ratio_of_polynomials(
    measured: FrequencyResponse, order: int, options: IdentificationOptions
) -> NDArray[np.complex128]:
    """All poles of the top floor's acceleration by Eq. (1) or by Sanathanan-Koerner iterations."""
    accelerations = [name for name in measured.outputs if name.startswith("a")]
    if not accelerations:
        raise AbraceError(f"{options.fit} of {measured.input}: no acceleration among the channels, expected one")
    delay = 0.0 if measured.input == signals.GROUND else options.servo_lag
    one = measured.without_hold(delay).select([accelerations[-1]])
    g, sigma = one.response[:, 0], one.sigma[:, 0]
    if options.fit == "paper":
        return fit_rational(one.omega, g, order, order).poles()
    return fit_sanathanan_koerner(one.omega, g, order, order, uncertainty_weights(g, sigma)).poles()


def _upper(poles: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Of each pair the pole above the real axis, slowest first."""
    upper = poles[poles.imag > 0]
    return np.asarray(upper[np.argsort(np.abs(upper))])


def _reals(poles: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """The real poles, slowest first: the servo's integral action, if it shows, and its lag."""
    reals = poles[poles.imag == 0]
    return np.asarray(reals[np.argsort(np.abs(reals))])


def _with_conjugates(poles: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Each upper pole followed by its conjugate."""
    return np.asarray(np.column_stack([poles, poles.conj()]).ravel())


def _without_deviation(poles: NDArray[np.complex128]) -> tuple[PoleInterval, ...]:
    unknown = float("nan")
    return tuple(PoleInterval(*pair, unknown, unknown) for pair in pole_table(poles))

# SPDX-License-Identifier: Apache-2.0
"""Poles of the table tests, of the command tests and of both, by vector fitting or by maximum likelihood.

The number of modes is found from the spectra (`servo_forms.rig_modes`).

- vector_fitting: so many common poles of all channels of the transfer functions; shapes and drives for these poles from
  the spectra, by one linear least-squares problem
- maximum_likelihood: the modes refined on the spectra, with leakage and the servos' real poles and delays in the model,
  and confidence intervals
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.modes import match_modes, modal_assurance
from abrace_sysid.fitting.covariance import LEAST_PIECES
from abrace_sysid.fitting.likelihood import FASTEST
from abrace_sysid.fitting.maximum_likelihood import fit_again, fit_poles
from abrace_sysid.fitting.observation import Observation
from abrace_sysid.fitting.pole_estimate import TESTS
from abrace_sysid.fitting.residual_weights import weighed
from abrace_sysid.fitting.servo_forms import ServoForm, fit_rig, no_modes, rig_modes
from abrace_sysid.fitting.vector_fitting import modes_of, vector_fitting

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.options import IdentificationOptions
    from abrace_sysid.fitting.pole_estimate import PoleEstimate, PoleInterval
    from abrace_sysid.input_tests import InputTests
    from abrace_sysid.spectra.frequency_response import FrequencyResponse


NEIGHBOURS = 17
"""Lines over which the level of a fit's residual is averaged: 0.06 Hz for a record of 300 s."""


@dataclass(frozen=True)
class PoleFit:
    """The poles by one method.

    Parameters
    ----------
    table
        (2 modes,) A1: the building's poles from the table test [rad/s], conjugates too, slowest first.
    command
        (2 pairs,) A2: all pairs of the command test, in the same order.
    table_pairs, command_pairs, common_pairs
        Frequency and damping of the pairs with their standard deviations; NaN if the method gives none.
    building
        (2 floors,) the building's poles from the command test.
    estimate
        The modes of all tests; None by the paper's method.
    warnings
        On the modes, one sentence each.
    """

    table: NDArray[np.complex128]
    command: NDArray[np.complex128]
    table_pairs: tuple[PoleInterval, ...]
    command_pairs: tuple[PoleInterval, ...]
    common_pairs: tuple[PoleInterval, ...]
    building: NDArray[np.complex128]
    estimate: PoleEstimate | None = None
    warnings: tuple[str, ...] = ()

    @property
    def pairs(self) -> dict[str, tuple[PoleInterval, ...]]:
        """All pairs, by the keys of `TESTS`."""
        return dict(zip(TESTS, (self.table_pairs, self.command_pairs, self.common_pairs), strict=True))


def fit_modes(
    table: InputTests,
    commands: Sequence[InputTests],
    floors: int,
    options: IdentificationOptions,
    progress: Callable[[str, float], None],
) -> PoleFit:
    """Fit table and commands alone, then both with common modes: the commands', some of which the table shows.

    Parameters
    ----------
    table, commands
        The tests on the table, and of each command.
    floors
        Number of floors, and of the building's modes.
    options
        `method` and `modes` are used.
    progress
        Called with the step that begins and the fraction done.

    Raises
    ------
    AbraceError
        If a fit fails, a pole is unstable, or no mode of the building is among the poles.
    """
    responses = [data.responses[0] for data in commands]
    if len(table.together) > 1:
        progress("poles of both", 0.5)
        of_both = _of_tests_with_all_inputs(table, commands, options)
        of_table = of_command = of_both
    else:
        of_table, of_command, of_both = _of_tests_apart(table, commands, options, progress)
    building = building_modes(of_both, floors)
    if not len(building):
        raise AbraceError(f"{table.source}: no pair is a mode of the building, expected up to {floors}")
    in_table, in_command = (same_modes(of_both, building, other) for other in (of_table, of_command))
    heavy = no_modes(of_both, responses[0].omega)
    return PoleFit(
        _with_conjugates(of_table.poles[in_table[in_table >= 0]]),
        _with_conjugates(_upper(of_command.poles)),
        _pairs_at(of_table, in_table),
        tuple(of_command.pairs()),
        tuple(pair for pair in of_both.pairs() if pair not in heavy),
        _with_conjugates(of_command.poles[in_command[in_command >= 0]]),
        of_both,
        _remarks(table, of_both, building, in_table, heavy, floors),
    )


def _of_tests_with_all_inputs(
    table: InputTests, commands: Sequence[InputTests], options: IdentificationOptions
) -> PoleEstimate:
    """The modes of tests in which table and commands were excited at once by noise."""
    pairs, groups = options.modes, len(commands)
    tests = _observations([table])
    if options.method == "vector_fitting":
        response = side_by_side([data.responses[0] for data in (table, *commands)])
        return _vector_fitted(tests, response, 2 * groups, pairs)
    first = fit_rig(tests, _servos(groups), groups, pairs)
    tests, found = _with_noise_as_found(tests, first, pairs)
    return fit_poles(tests, found, spread="joint")


def _of_tests_apart(
    table: InputTests,
    commands: Sequence[InputTests],
    options: IdentificationOptions,
    progress: Callable[[str, float], None],
) -> tuple[PoleEstimate, PoleEstimate, PoleEstimate]:
    """The modes of the table tests, of the command tests, and of all tests together."""
    by_likelihood, groups, pairs = options.method == "maximum_likelihood", len(commands), options.modes
    top, highest = (data.responses[0].omega[-1] for data in (table, commands[0]))
    progress("poles of the table tests", 0.5)
    from_table = _observations([table])
    if by_likelihood:
        of_table = fit_rig(from_table, [ServoForm(1), ServoForm(0)])
        from_table, of_table = _with_noise_as_found(_without_decay([table], from_table, of_table), of_table)
    else:
        of_table = _vector_fitted(from_table, table.responses[0], 1)
    progress("poles of the command tests", 0.6)
    from_command = _observations(commands)
    if by_likelihood:
        of_command = fit_rig(from_command, _servos(groups), groups, pairs)
        undecayed = _without_decay(commands, from_command, of_command)
        from_command, of_command = _with_noise_as_found(undecayed, of_command, pairs)
    else:
        responses = [data.responses[0] for data in commands]
        # multisines share the lines: the lines of each are too far apart for interpolation
        response = responses[0] if commands[0].periodic else side_by_side(responses)
        of_command = _vector_fitted(from_command, response, 2 * groups, pairs)

    progress("poles of both tests", 0.75)
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
    if by_likelihood:
        return of_table, of_command, fit_poles(tests, poles, driven, spread="joint", delays=delays)
    return of_table, of_command, fit_poles(tests, poles, driven, most=0, spread="none", delays=delays)


def _vector_fitted(
    observations: Sequence[Observation], measured: FrequencyResponse, reals: int, given: int = 0
) -> PoleEstimate:
    """The modes with the poles of vector fitting of a response.

    `reals`: number of the servos' real poles; `given`: of modes; 0: as many as the observations have.
    """
    pairs = given or len(rig_modes(observations))
    fit = vector_fitting(measured, 2 * pairs + reals)
    modes = modes_of(fit, measured)[:pairs]
    real = _reals(fit.poles)
    real = real[(-real.real > measured.omega[0]) & (-real.real < FASTEST / measured.sample_period)]
    return fit_poles(observations, np.concatenate([_upper(modes), real]), most=0, spread="none")


def _with_noise_as_found(
    observations: Sequence[Observation], estimate: PoleEstimate, given: int = 0
) -> tuple[list[Observation], PoleEstimate]:
    """The tests with lines weighted by the residual of a first fit around them, and the fit of the weighted tests.

    The residual is larger at a resonance: noise of the measured input passes through the structure to all channels, and
    peaks are never exactly linear. The channels then contain less information than independent ones, and the weight of
    these tests among others is reduced by the increase of their poles' variance. A few multisines have too few lines
    around a resonance, and keep the noise levels from their periods. With more, these levels are not used: of each line
    they are known from a few others in between, and so uneven that some lines would count much too much.
    Pairs that are unstable or not sure with these weights are left out, unless their number is `given`.
    """
    found = list(observations)
    if observations[0].transient or len(observations) >= LEAST_PIECES:
        even = [one.with_noise(np.ones(len(one.z))) for one in observations]
        found = weighed(even, estimate, NEIGHBOURS)
    again = (fit_poles if given else fit_again)(found, estimate)
    return [replace(one, weight=1 / again.inflation) for one in found], again


def _servos(groups: int) -> list[ServoForm]:
    """Forms of the servos: with slow pole, lag and delay first, then simpler ones."""
    forms = [ServoForm(2, "delay", groups == 1), ServoForm(2, "lag", groups == 1), ServoForm(2)]
    return [*forms, *([ServoForm(2, "delay")] if groups > 1 else []), ServoForm(1), ServoForm(0)]


def _pairs_at(estimate: PoleEstimate, places: NDArray[np.int64]) -> tuple[PoleInterval, ...]:
    """Frequency and damping of the pairs at the indices `places` among the poles; -1: none."""
    frequencies = np.abs(estimate.poles[places[places >= 0]])
    return tuple(pair for pair in estimate.pairs() if np.isclose(pair.frequency, frequencies, rtol=1e-12).any())


def _remarks(
    table: InputTests,
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
        found.append(f"modes: the pairs at {'; '.join(named)} are no modes, and left out of the poles")
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


def _observations(tests: Sequence[InputTests]) -> list[Observation]:
    """Observations: of each test with noise its spectra with leakage, once; of a periodic test its responses."""
    found = []
    for data in tests:
        if data.periodic:
            both = zip(data.responses, data.tests, strict=True)
            found += [Observation.of_response(one, test.source) for one, test in both]
        elif data.input == data.together[0]:
            band = data.responses[0].band
            found += [Observation.of_test(test, data.together, band, data.outputs) for test in data.tests]
    return found


def _without_decay(
    tests: Sequence[InputTests], observations: list[Observation], estimate: PoleEstimate
) -> list[Observation]:
    """The observations of periodic tests without the free decay of the modes of a first fit; others as they are."""
    return _observations([data.without_decay(estimate.poles) for data in tests]) if tests[0].periodic else observations


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


ALIKE = 0.6
"""Greatest difference of both shapes, over the sum of their sizes, of a mode of the building."""


def building_modes(estimate: PoleEstimate, floors: int) -> NDArray[np.int64]:
    """(modes,) indices into `estimate.poles` of the building's pole pairs, slowest first.

    Parameters
    ----------
    estimate
        The fit; its outputs are displacements x1, x2 ... and accelerations a1, a2 ... of the same floors. Without
        these the slowest pairs are taken.
    floors
        Number of floors, which is the greatest number of modes.
    """
    pairs = np.flatnonzero(estimate.poles.imag > 0)
    pairs = pairs[np.argsort(np.abs(estimate.poles[pairs]))]
    names = estimate.outputs
    both = [f"{i + 1}" for i in range(floors) if f"x{i + 1}" in names and f"a{i + 1}" in names]
    if not both:
        return pairs[:floors]
    displacement, acceleration = (estimate.shapes[[names.index(kind + i) for i in both]] for kind in "xa")
    expected = displacement * estimate.poles**2
    difference, sizes = np.linalg.norm(acceleration - expected, axis=0), np.linalg.norm(acceleration, axis=0)
    unlike = (difference / np.maximum(sizes + np.linalg.norm(expected, axis=0), np.finfo(float).tiny))[pairs]
    chosen = np.argsort(unlike, kind="stable")[:floors]
    return pairs[np.sort(chosen[unlike[chosen] < ALIKE])]


def same_modes(estimate: PoleEstimate, wanted: NDArray[np.int64], other: PoleEstimate) -> NDArray[np.int64]:
    """(modes,) indices into `other.poles` of the modes `wanted` of `estimate`; -1: not found.

    Parameters
    ----------
    estimate, other
        Two fits with the same outputs.
    wanted
        (modes,) indices into `estimate.poles`, of pairs.
    """
    unit = np.sqrt(np.mean(np.abs(estimate.shapes[:, wanted]) ** 2, axis=1, keepdims=True))
    unit[unit == 0] = 1.0
    pairs = np.flatnonzero(other.poles.imag > 0)
    found = np.full(len(wanted), -1)
    alike = modal_assurance((estimate.shapes[:, wanted] / unit).T, (other.shapes[:, pairs] / unit).T)
    for i, j in match_modes(np.abs(estimate.poles[wanted]), np.abs(other.poles[pairs]), alike):
        found[i] = pairs[j]
    return found

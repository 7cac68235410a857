# SPDX-License-Identifier: Apache-2.0
"""Identification of a rig: from recorded table tests and command tests to state-space models (Eqs. 1 to 10).

transfer functions  of each input, estimated from all its tests together
poles               of the table tests (A1), of the command tests (A2), and one set common to both
consistent model    common poles for all inputs, numerators fitted for every channel, each pole once: for prediction
superposed model    Eqs. (6) and (7): poles A1, poles A2, and the building's poles again (A3); 24 states for 3 floors
reduced model       the consistent model after balanced truncation (Eq. 9): for design
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_core.run import Run
from abrace_sysid.fitting.options import FIT_METHODS, IdentificationOptions
from abrace_sysid.fitting.pole_fits import PoleFit, fit_poles_of, steady
from abrace_sysid.models.consistent import consistent_model, realize_together
from abrace_sysid.models.modal import modal_covariance, modal_model, servo_lags, without_lags
from abrace_sysid.models.realization import realize, superpose, unexplained
from abrace_sysid.models.reduction import Reduction, Scales, balanced_truncation, typical_scales
from abrace_sysid.recordings import prepare, require_at_rest
from abrace_sysid.spectra.estimation import frequency_responses
from abrace_sysid.spectra.fourier import held_input
from abrace_sysid.spectra.measured_tests import TestData
from abrace_sysid.spectra.periodic_response import find_period, periodic_response, same_realization

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_sysid.spectra.frequency_response import FrequencyResponse


LAG_DIFFERENCE = 0.5
"""A warning is given if a servo's identified lag differs from `servo_lag` by more than this share of `servo_lag`."""

POOR_FIT = 0.1
"""A warning is given if a channel's residual exceeds this share of its response (rms over the band)."""


@dataclass(frozen=True)
class Identification:
    """The identified models of a rig, and the transfer functions and poles from which they were computed.

    Parameters
    ----------
    table, commands
        The table tests, and the tests of each command, with their transfer functions.
    poles
        Poles of the table tests, of the command tests and of both together, with their uncertainty if the method
        estimates it.
    model
        The consistent model, for prediction. With maximum likelihood the servos' lags are states and their delays are
        input delays.
    superposed
        The paper's model, Eqs. (6) and (7).
    whole
        The consistent model before reduction, with each servo's lag and delay as the input delay of its command.
    reduction
        Eq. (9): the reduced model and the Hankel singular values of `whole`.
    scales
        The balancing units: rms of each input in the tests, and rms of each output under these inputs.
    warnings
        About the bags and the fit, one sentence each, without repetitions.
    covariance
        Of the parameters of `model`, ordered as in `abrace_core.model_ensemble`; None if the method estimates none.
    """

    table: TestData
    commands: tuple[TestData, ...]
    poles: PoleFit
    model: LinearModel
    superposed: LinearModel
    whole: LinearModel
    reduction: Reduction
    scales: Scales
    warnings: tuple[str, ...]
    covariance: NDArray[np.float64] | None = None

    @property
    def reduced(self) -> LinearModel:
        """The reduced model."""
        return self.reduction.model

    @property
    def table_response(self) -> FrequencyResponse:
        """Transfer functions from the table's acceleration (of the first table test, if they are periodic)."""
        return self.table.responses[0]

    @property
    def command(self) -> TestData:
        """The tests of the first command."""
        return self.commands[0]

    @property
    def command_response(self) -> FrequencyResponse:
        """Transfer functions from the first command (of its first test, if they are periodic)."""
        return self.command.responses[0]

    @property
    def hankel_singular_values(self) -> NDArray[np.float64]:
        """(states,) of the model before reduction, in balancing units, greatest first."""
        return self.reduction.hankel_singular_values


def identify(
    table: Run | Sequence[Run],
    command: Run | Sequence[Run],
    options: IdentificationOptions | None = None,
    progress: Callable[[str, float], None] = lambda _step, _fraction: None,
) -> Identification:
    """Identify the braced building.

    Parameters
    ----------
    table
        One or several table tests: noise or a multisine on the table, commands zero.
    command
        One or several command tests: noise or a multisine as command, the table at rest. Several brace groups are
        excited one after the other or all at once. If table and commands were excited at once, give the same tests
        twice. Inputs excited at once must be uncorrelated noise, or multisines that excite different lines.
    options
        By default those of `IdentificationOptions`.
    progress
        Called at the beginning of each step, with the step's name and the fraction of the work done.

    Raises
    ------
    AbraceError
        If a test or an option cannot be used, or a fitted pole is unstable.
    """
    options = options or IdentificationOptions()
    tables, commands = ((runs,) if isinstance(runs, Run) else tuple(runs) for runs in (table, command))
    progress("checking the tests", 0.0)
    _check_options(options)
    _check_rig(tables, commands, options)
    options = options.of_tests(tables, commands)
    names = tables[0].command_names
    same_tests = [run.source for run in tables] == [run.source for run in commands]
    if not same_tests:
        for run in tables:
            for name in names:
                require_at_rest(run, name, commands[0])
        for run in commands:
            require_at_rest(run, signals.GROUND, tables[0])
    progress("transfer functions from the table", 0.05)
    noise_on_both: tuple[str, ...] = ()
    if same_tests and not find_period(held_input(tables[0], signals.GROUND)):
        # the band that all inputs excite: estimated one by one, each response would contain the others' leakage
        low, high = (f(*edges) for f, *edges in zip((max, min), options.table_band, options.command_band, strict=True))
        together = _test_data(tables, (signals.GROUND, *names), (low, high), options)
        from_table, from_commands = together[0], together[1:]
        noise_on_both = (
            f"{tables[0].source}: noise on table and commands at once is used from {low:g} to {high:g} Hz",
        )
    else:
        others = names if same_tests else ()
        from_table = _test_data(tables, (signals.GROUND,), options.table_band, options, others)[0]
        progress("transfer functions from the command", 0.2)
        from_commands = _command_tests(commands, options, (signals.GROUND,) if same_tests else ())
    outputs = [name for name in from_table.outputs if all(name in data.outputs for data in from_commands)]
    from_table, from_commands = from_table.select(outputs), tuple(data.select(outputs) for data in from_commands)

    progress("poles", 0.5)
    floors = tables[0].floors
    poles = fit_poles_of(from_table, from_commands, floors, options, progress)
    progress("numerators", 0.85)
    if poles.estimate is not None:
        from_table = steady(from_table, poles.estimate)
        from_commands = tuple(steady(data, poles.estimate) for data in from_commands)
    tests = (from_table, *from_commands)
    provenance: dict[str, Any] = {
        "bags": {"table": [run.source for run in tables], "command": [run.source for run in commands]},
        "seconds": {
            name: [len(run.outputs) * run.sample_period for run in data.runs]
            for name, data in (("table", from_table), ("command", from_commands[0]))
        },
        "rig": tables[0].facts.get("rig", ""),
        "sample_period": tables[0].sample_period,
        "method": {"table": from_table.responses[0].method, "command": from_commands[0].responses[0].method},
        "options": asdict(options),
    }
    measured, delays = [one for data in tests for one in data.responses], dict.fromkeys(names, options.servo_lag)
    intensity = {data.input: _intensity(data) for data in tests}
    highest = float(from_commands[0].responses[0].omega[-1])
    if poles.estimate is not None:
        delays |= servo_lags(poles.estimate, highest)
    if "capacity" in tables[0].facts:
        provenance["force_limit"] = _capacity(tables[0])
    provenance["lags"] = delays
    if poles.estimate is not None:
        whole = modal_model(without_lags(poles.estimate, highest), provenance)
        model = modal_model(poles.estimate, {**provenance, "states": "modes of maximum likelihood, lags among them"})
    else:
        whole = realize_together(measured, poles.of_model, delays)
        merged = consistent_model(measured, poles.of_model, delays, options.command_band, intensity).model
        model = replace(merged, provenance={**provenance, **merged.provenance})
    superposed = _superposed(from_table, from_commands, poles, delays)
    superposed = replace(superposed, provenance={**provenance, "states": "superposed, Eqs. (6) and (7)"})
    progress("balanced reduction", 0.95)
    scales = typical_scales(whole, options.command_band, intensity)
    reduction = balanced_truncation(whole, options.reduced_order, scales)
    reduced = replace(reduction.model, provenance={**provenance, "states": "consistent, balanced, truncated, Eq. (9)"})
    progress("identified", 1.0)
    misfits = [sentence for data in tests for sentence in _misfits(model, data)]
    if poles.estimate is not None:
        misfits += _lags_that_differ(delays, from_commands, options)
    of_tests = (*(sentence for data in tests for sentence in data.warnings), *noise_on_both)
    warnings = tuple(dict.fromkeys([*of_tests, *poles.warnings, *misfits]))
    reduction = replace(reduction, model=reduced)
    covariance = None if poles.estimate is None else modal_covariance(poles.estimate)
    return Identification(
        from_table, from_commands, poles, model, superposed, whole, reduction, scales, warnings, covariance
    )


def _misfits(model: LinearModel, data: TestData) -> tuple[str, ...]:
    """A warning if a channel's residual exceeds POOR_FIT and twice its noise, each as a share of the response."""
    measured = data.responses[0]
    noise = np.sqrt(np.mean(measured.sigma**2, axis=0) / np.mean(np.abs(measured.response) ** 2, axis=0))
    left = unexplained(model, measured)
    poor = [
        f"{name} {share:.0%}"
        for name, share, least in zip(measured.outputs, left, noise, strict=True)
        if share > max(POOR_FIT, 2 * least)
    ]
    advice = "another fit, order or band may do better"
    found = f"{data.source}: the model leaves much of the response to {data.input} unexplained ({', '.join(poor)})"
    return (f"{found}: {advice}",) if poor else ()


def _lags_that_differ(
    lags: Mapping[str, float], commands: Sequence[TestData], options: IdentificationOptions
) -> list[str]:
    """A warning for each command whose identified servo lag is far from the bench test's (`servo_lag`)."""
    given = options.servo_lag
    return [
        f"{data.source}: {data.input} lags by {1e3 * lags[data.input]:.2g} ms, servo_lag is {1e3 * given:.2g} ms: the "
        "models have the measured lag; was servo_lag measured on this rig, in s?"
        for data in commands
        if given and abs(lags[data.input] - given) > LAG_DIFFERENCE * given
    ]


def _intensity(data: TestData) -> float:
    """Rms of an input over all its tests."""
    return float(np.sqrt(np.mean([np.mean(held_input(run, data.input) ** 2) for run in data.runs])))


def _superposed(
    table: TestData, commands: Sequence[TestData], poles: PoleFit, delays: Mapping[str, float]
) -> LinearModel:
    """Eqs. (3) to (7): one part for the table, and two for each command (accelerations; all other outputs)."""
    accelerations = [name for name in table.outputs if name.startswith("a")]
    others = [name for name in table.outputs if name not in accelerations]

    def of(data: TestData, outputs: Sequence[str]) -> list[FrequencyResponse]:
        return [response.select(outputs) for response in data.responses]

    building = poles.building
    parts = [realize(of(table, table.outputs), poles.table)]
    for command in commands:
        if accelerations:
            parts.append(realize(of(command, accelerations), poles.command, delays[command.input]))
        if others:
            parts.append(realize(of(command, others), building, delays[command.input]))
    return superpose(parts, (table.input, *(command.input for command in commands)), table.outputs)


def _command_tests(
    runs: tuple[Run, ...], options: IdentificationOptions, others: tuple[str, ...] = ()
) -> tuple[TestData, ...]:
    """The tests grouped by command; commands that were excited at once are estimated together.

    `others`: inputs that were excited as well, on other lines.
    """
    names = runs[0].command_names
    kinds: dict[tuple[str, ...], list[Run]] = {}
    for run in runs:
        excited = tuple(name for name in names if np.any(held_input(run, name))) or names[:1]
        kinds.setdefault(excited, []).append(run)
    found: dict[str, TestData] = {}
    for excited, same in kinds.items():
        for data in _test_data(tuple(same), excited, options.command_band, options, others):
            if data.input in found:
                sources = ", ".join(run.source for run in found[data.input].runs)
                raise AbraceError(
                    f"{data.source}: {data.input} is excited here in the set {' and '.join(excited)}, but in another "
                    f"set in {sources}; expected every command either alone or always with the same commands"
                )
            found[data.input] = data
    missing = [name for name in names if name not in found]
    if missing:
        sources = ", ".join(run.source for run in runs)
        raise AbraceError(f"{sources}: {' and '.join(missing)} zero throughout, expected a test of every command")
    return tuple(found[name] for name in names)


def _test_data(
    runs: tuple[Run, ...],
    names: tuple[str, ...],
    band: tuple[float, float],
    options: IdentificationOptions,
    others: tuple[str, ...] = (),
) -> tuple[TestData, ...]:
    """Check the tests of inputs that were excited at once, and estimate the transfer functions of each input."""
    periods = [max((find_period(held_input(run, name)) or 0 for name in names), default=0) or None for run in runs]
    periodic = [period is not None for period in periods]
    named = " and ".join(names)
    if any(periodic) and not all(periodic):
        raise AbraceError(f"tests of {named}: {periodic.count(True)} of {len(runs)} are periodic, expected all or none")
    recordings = [prepare(run, names, band, period, others) for run, period in zip(runs, periods, strict=True)]
    prepared = tuple(recording.run for recording in recordings)
    if all(periodic):
        responses = [tuple(periodic_response(run, name, band).frequency_response for run in prepared) for name in names]
    else:
        responses = [(one,) for one in frequency_responses(prepared, names, band, options.transfer_function)]
    outputs = [output for output in runs[0].names if all(output in recording.outputs for recording in recordings)]
    warnings = tuple(warning for recording in recordings for warning in recording.warnings)
    if all(periodic):
        warnings += _repeated_realizations(prepared, names)
    return tuple(
        TestData(name, prepared, tuple(one.select(outputs) for one in of_input), all(periodic), warnings, names)
        for name, of_input in zip(names, responses, strict=True)
    )


def _repeated_realizations(runs: Sequence[Run], names: Sequence[str]) -> tuple[str, ...]:
    """A warning if the multisines of two tests have the same phases."""
    for name in names:
        for one, other in combinations(runs, 2):
            if same_realization(held_input(one, name), held_input(other, name)):
                advice = "expected different seeds, or the intervals do not include nonlinear distortion"
                return (f"{one.source} and {other.source}: the same multisine of {name}; {advice}",)
    return ()


def _capacity(run: Run) -> list[float]:
    """The capacity of the rig's braces, of each group [N]: a fact of the test."""
    text = run.facts["capacity"]
    try:
        found = [float(force) for force in json.loads(text)]
    except (TypeError, ValueError):
        found = []
    if len(found) != run.groups or not all(0 < force < np.inf for force in found):
        raise AbraceError(
            f"{run.source}: fact capacity {text!r}, expected [N], one for each of {run.groups} brace groups"
        )
    return found


def _check_options(options: IdentificationOptions) -> None:
    if options.fit not in FIT_METHODS:
        raise AbraceError(f"identification: fit {options.fit!r}, expected one of {', '.join(FIT_METHODS)}")
    if not (options.servo_lag >= 0 and np.isfinite(options.servo_lag)):
        raise AbraceError(f"identification: servo_lag {options.servo_lag} s, expected a number >= 0")


def _check_rig(tables: Sequence[Run], commands: Sequence[Run], options: IdentificationOptions) -> None:
    """Check that there are table tests and command tests, all of the same rig.

    Raises
    ------
    AbraceError
        If not, or `command_order` is not possible.
    """
    for kind, runs in (("table", tables), ("command", commands)):
        if not runs:
            raise AbraceError(f"identification: no {kind} test, expected at least one")
    first = tables[0]
    for run in (*tables[1:], *commands):
        for what, one, other in (
            ("floors", first.floors, run.floors),
            ("brace groups", first.groups, run.groups),
            ("sample period", first.sample_period, run.sample_period),
            ("rig", first.facts.get("rig"), run.facts.get("rig")),
        ):
            if one != other and None not in (one, other):
                raise AbraceError(f"{run.source}: {what} {other}, but {one} in {first.source}: expected the same rig")
    of_data = options.command_order == 0 and (options.fit == "maximum_likelihood" or first.groups > 1)
    if not of_data and (options.command_order < 2 * first.floors or options.command_order % 2):
        expected = f"an even number of at least {2 * first.floors}"
        raise AbraceError(f"identification: command_order {options.command_order}, expected {expected}")

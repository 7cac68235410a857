# SPDX-License-Identifier: Apache-2.0
"""Identification of a rig: from recorded table tests and command tests to state-space models.

transfer functions  of each input, estimated from all its tests together
poles and models    by the paper's method, by vector fitting, or by maximum likelihood (`methods`)
reduced model       the model after balanced truncation (Eq. 9): for design
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_sysid.examination import prepared, require_at_rest, require_long, require_rig
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.input_tests import input_tests
from abrace_sysid.methods import fit
from abrace_sysid.models.reduction import Reduction, balanced_truncation, typical_scales
from abrace_sysid.recorded.test import Test, given_tests, of_one_rig

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_sysid.fitting.pole_fits import PoleFit
    from abrace_sysid.input_tests import InputTests
    from abrace_sysid.recorded.test import AnyTest
    from abrace_sysid.spectra.frequency_response import FrequencyResponse


@dataclass(frozen=True)
class Identification:
    """The identified models of a rig, and the transfer functions and poles from which they were computed.

    Parameters
    ----------
    tests
        All tests as recorded, examined; those on the table first.
    options
        With the bands that were used.
    table, commands
        The table tests, and the tests of each command, with their transfer functions.
    poles
        Poles of the table tests, of the command tests and of both together, with their uncertainty if the method
        estimates it.
    model
        The model for prediction: one for all inputs, the servos' lags are states and their delays input delays; by the
        paper's method that of Eqs. (6) and (7).
    superposed
        The model of Eqs. (6) and (7).
    reduction
        Eq. (9): the reduced model, and the `whole` one of which it is: `model` with each servo's lag and delay as the
        input delay of its command; its Hankel singular values.
    warnings
        About the bags and the fit, one sentence each, without repetitions.
    covariance
        Of the parameters of `model`, ordered as in `abrace_core.model.model_ensemble`; None: not estimated.
    """

    tests: tuple[Test, ...]
    options: IdentificationOptions
    table: InputTests
    commands: tuple[InputTests, ...]
    poles: PoleFit
    model: LinearModel
    superposed: LinearModel
    reduction: Reduction
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
    def command(self) -> InputTests:
        """The tests of the first command."""
        return self.commands[0]

    @property
    def command_response(self) -> FrequencyResponse:
        """Transfer functions from the first command (of its first test, if they are periodic)."""
        return self.command.responses[0]


def identify(
    table: AnyTest | Sequence[AnyTest],
    command: AnyTest | Sequence[AnyTest],
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
    tables, commands = (tuple(test.in_si_units() for test in given_tests(given)) for given in (table, command))
    options = options or IdentificationOptions()
    progress("checking the tests", 0.0)
    for test in (*tables, *commands):
        require_rig(test)
        require_long(test)
    of_one_rig((*tables, *commands), alike=())
    options.require_possible(tables[0].floors, tables[0].groups)
    options = options.of_tests(tables, commands)
    names = tables[0].commands
    noise_on_both: tuple[str, ...] = ()
    progress("transfer functions from the table", 0.05)
    if not is_both(tables, commands):
        for test in tables:
            for name in names:
                require_at_rest(test, name, commands[0])
        for test in commands:
            require_at_rest(test, signals.GROUND, tables[0])
        tables = tuple(prepared(test, {signals.GROUND: options.table_band}) for test in tables)
        (from_table,) = input_tests(tables, {signals.GROUND: options.table_band}, options)
        progress("transfer functions from the command", 0.2)
        excited = [test.moving or names[:1] for test in commands]
        commands = tuple(
            prepared(test, dict.fromkeys(each, options.command_band))
            for test, each in zip(commands, excited, strict=True)
        )
        from_commands = _command_tests(commands, options)
        tests = (*tables, *commands)
    elif tables[0].periods[signals.GROUND]:
        bands = {signals.GROUND: options.table_band}
        tests = tuple(
            prepared(test, bands | dict.fromkeys(test.moving or names[:1], options.command_band)) for test in tables
        )
        (from_table,) = input_tests(tests, bands, options)
        progress("transfer functions from the command", 0.2)
        from_commands = _command_tests(tests, options)
    else:
        # the band that all inputs excite: estimated one by one, each response would contain the others' leakage
        low, high = (f(*edges) for f, *edges in zip((max, min), options.table_band, options.command_band, strict=True))
        bands = dict.fromkeys((signals.GROUND, *names), (low, high))
        tests = tuple(prepared(test, bands) for test in tables)
        from_table, *rest = input_tests(tests, bands, options)
        from_commands = tuple(rest)
        source = tests[0].source
        noise_on_both = (f"{source}: noise on table and commands at once is used from {low:g} to {high:g} Hz",)
    outputs = [name for name in from_table.outputs if all(name in data.outputs for data in from_commands)]
    from_table, from_commands = from_table.select(outputs), tuple(data.select(outputs) for data in from_commands)

    found = fit(from_table, from_commands, tables[0].floors, options, progress)
    if found.poles.estimate is not None:
        from_table = from_table.without_decay(found.poles.estimate.poles)
        from_commands = tuple(data.without_decay(found.poles.estimate.poles) for data in from_commands)
    of_inputs = (from_table, *from_commands)
    provenance: dict[str, Any] = {
        "bags": {"table": [test.source for test in tables], "command": [test.source for test in commands]},
        "seconds": {
            name: [test.seconds for test in data.tests]
            for name, data in (("table", from_table), ("command", from_commands[0]))
        },
        "rig": tables[0].facts.get("rig", ""),
        "sample_period": tables[0].sample_period,
        "method": {"table": from_table.responses[0].method, "command": from_commands[0].responses[0].method},
        "options": options.model_dump(),
        "lags": found.lags,
    }
    if "capacity" in tables[0].facts:
        provenance["force_limit"] = _capacity(tables[0])
    model = replace(found.model, provenance={**provenance, "states": f"by {options.method}"})
    superposed = replace(found.superposed, provenance={**provenance, "states": "superposed, Eqs. (6) and (7)"})
    whole = replace(found.whole, provenance=provenance)
    progress("balanced reduction", 0.95)
    scales = typical_scales(whole, options.command_band, {data.input: _intensity(data) for data in of_inputs})
    reduction = balanced_truncation(whole, options.reduced_order, scales)
    reduced = replace(reduction.model, provenance={**provenance, "states": "balanced, truncated, Eq. (9)"})
    progress("identified", 1.0)
    of_tests = (*(sentence for data in of_inputs for sentence in data.warnings), *noise_on_both)
    warnings = tuple(dict.fromkeys([*of_tests, *found.poles.warnings]))
    reduction = replace(reduction, model=reduced)
    return Identification(
        tests,
        options,
        from_table,
        from_commands,
        found.poles,
        model,
        superposed,
        reduction,
        warnings,
        found.covariance,
    )


def is_both(tables: Sequence[Test], commands: Sequence[Test]) -> bool:
    """Whether tests on `tables` and with `commands` are the same, sample by sample: both were excited at once."""
    return len(tables) == len(commands) and all(map(Test.is_same, tables, commands))


def _intensity(data: InputTests) -> float:
    """Rms of an input over all its tests."""
    return float(np.sqrt(np.mean([np.mean(test.channel(data.input) ** 2) for test in data.tests])))


def _command_tests(tests: Sequence[Test], options: IdentificationOptions) -> tuple[InputTests, ...]:
    """The tests grouped by command; commands that were excited at once are estimated together."""
    names = tests[0].commands
    kinds: dict[tuple[str, ...], list[Test]] = {}
    for test in tests:
        kinds.setdefault(test.moving or names[:1], []).append(test)
    found: dict[str, InputTests] = {}
    for excited, same in kinds.items():
        for data in input_tests(same, dict.fromkeys(excited, options.command_band), options):
            if data.input in found:
                raise AbraceError(
                    f"{data.source}: {data.input} is excited here in the set {' and '.join(excited)}, but in another "
                    f"set in {found[data.input].source}; expected every command either alone or always with the same "
                    "commands"
                )
            found[data.input] = data
    missing = [name for name in names if name not in found]
    if missing:
        sources = ", ".join(test.source for test in tests)
        raise AbraceError(f"{sources}: {' and '.join(missing)} zero throughout, expected a test of every command")
    return tuple(found[name] for name in names)


def _capacity(test: Test) -> list[float]:
    """The capacity of the rig's braces, of each group [N]: a fact of the test."""
    text = test.facts["capacity"]
    try:
        found = [float(force) for force in json.loads(text)]
    except (TypeError, ValueError):
        found = []
    if len(found) != test.groups or not all(0 < force < np.inf for force in found):
        raise AbraceError(
            f"{test.source}: fact capacity {text!r}, expected [N], one for each of {test.groups} brace groups"
        )
    return found

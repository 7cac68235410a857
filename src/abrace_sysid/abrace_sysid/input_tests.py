# SPDX-License-Identifier: Apache-2.0
"""All tests of one input, with the transfer functions estimated from them: Figs. 3 to 5 of the paper."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

from abrace_core import AbraceError
from abrace_core.files.options import NOT_GIVEN
from abrace_core.model import signals
from abrace_sysid.examination import prepared
from abrace_sysid.recorded.series import same_realization
from abrace_sysid.recorded.test import of_one_rig
from abrace_sysid.spectra.bands import common_band
from abrace_sysid.spectra.estimation import frequency_responses
from abrace_sysid.spectra.frequency_response import mean_of
from abrace_sysid.spectra.periodic_response import periodic_response

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from abrace_sysid.recorded.test import AnyTest, Test
    from abrace_sysid.spectra.estimation import TransferFunctionOptions
    from abrace_sysid.spectra.frequency_response import FrequencyResponse

ROUNDING = 1e-9
"""By this share a band is widened, so that rounding leaves out no line at its edges."""


@dataclass(frozen=True)
class InputTests:
    """All tests of one input, prepared for fitting.

    Parameters
    ----------
    input
        Name of the input that was excited.
    tests
        The tests, examined, with trends removed.
    responses
        Transfer functions of the channels that respond: one from all tests with noise, or one from each periodic test.
    periodic
        Whether the tests were periodic.
    warnings
        About the tests, one sentence each.
    together
        Names of all inputs that were excited at once, including this one.
    """

    input: str
    tests: tuple[Test, ...]
    responses: tuple[FrequencyResponse, ...]
    periodic: bool
    warnings: tuple[str, ...]
    together: tuple[str, ...]

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the channels that respond."""
        return self.responses[0].outputs

    @property
    def source(self) -> str:
        """The tests' names."""
        return ", ".join(test.source for test in self.tests)

    def select(self, outputs: Sequence[str]) -> InputTests:
        """The same tests with only these outputs, in this order."""
        return replace(self, responses=tuple(response.select(outputs) for response in self.responses))

    def without_decay(self, poles: NDArray[np.complex128]) -> InputTests:
        """Periodic tests with the free decay of modes removed from the responses; tests with noise as they are.

        Parameters
        ----------
        poles
            Of the modes [rad/s], conjugates do not matter.
        """
        if not self.periodic:
            return self
        (low, high), upper = self.responses[0].band, poles[poles.imag > 0]
        edges = low * (1 - ROUNDING), high * (1 + ROUNDING)
        found = [periodic_response(test, self.input, edges, poles=upper) for test in self.tests]
        return replace(self, responses=tuple(one.select(self.outputs) for one in found))


def transfer_functions(
    given: AnyTest | Sequence[AnyTest],
    input_name: str = "",
    band: tuple[float, float] = NOT_GIVEN,
    options: TransferFunctionOptions | None = None,
) -> tuple[FrequencyResponse, tuple[str, ...]]:
    """The transfer functions from one input to all outputs that respond to it, and warnings about the tests.

    Parameters
    ----------
    given
        One test, or repeated ones, with noise or a multisine.
    input_name
        The input; empty: the only command that moves, the table where none does.
    band
        [Hz]; `NOT_GIVEN`: as far as the tests excite it.
    options
        Method and settings for tests with noise; by default those of `TransferFunctionOptions`.

    Raises
    ------
    AbraceError
        If it is not said which of several inputs is meant, or the tests cannot be used.
    """
    tests = of_one_rig(given)
    first = tests[0]
    moving = (first.moving or (signals.GROUND,)) if first.commands else first.inputs
    if not input_name and len(moving) > 1:
        raise AbraceError(f"{first.source}: {', '.join(moving)} move, expected the name of one of them as input")
    input_name = input_name or moving[0]
    if input_name not in first.inputs:
        raise AbraceError(f"{first.source}: input {input_name!r}, expected one of {', '.join(first.inputs)}")
    driving = tuple(dict.fromkeys((input_name, *moving)))
    own = driving if first.periods[input_name] is None else driving[:1]
    band = common_band(tests, own) if band == NOT_GIVEN else band
    tests = tuple(prepared(test, dict.fromkeys(own, band), driving[len(own) :]) for test in tests)
    found = input_tests(tests, dict.fromkeys(own, band), options)[0]
    return mean_of(found.responses), found.warnings


def input_tests(
    tests: Sequence[Test], bands: Mapping[str, tuple[float, float]], options: TransferFunctionOptions | None
) -> tuple[InputTests, ...]:
    """The tests with the transfer functions of each input.

    Parameters
    ----------
    tests
        Prepared, all of the same inputs.
    bands
        [Hz], by input that was excited.
    options
        Method and settings for tests with noise.

    Raises
    ------
    AbraceError
        If only some of the tests are periodic, or the tests are too short for the method.
    """
    names = tuple(bands)
    periodic = [any(test.periods[name] for name in names) for test in tests]
    if any(periodic) and not all(periodic):
        raise AbraceError(
            f"tests of {' and '.join(names)}: {periodic.count(True)} of {len(tests)} are periodic, expected all or none"
        )
    still = tuple(test.still for test in tests)
    if all(periodic):
        responses = [tuple(periodic_response(test, name, bands[name]) for test in still) for name in names]
    else:
        responses = [(one,) for one in frequency_responses(still, names, bands[names[0]], options)]
    outputs = [output for output in tests[0].names if not any(output in test.faults for test in tests)]
    warnings = tuple(warning for test in tests for warning in test.warnings)
    if all(periodic):
        warnings += _repeated_realizations(still, names)
    return tuple(
        InputTests(name, still, tuple(one.select(outputs) for one in of_input), all(periodic), warnings, names)
        for name, of_input in zip(names, responses, strict=True)
    )


def _repeated_realizations(tests: Sequence[Test], names: Sequence[str]) -> tuple[str, ...]:
    """A warning if the multisines of two tests have the same phases."""
    for name in names:
        for one, other in combinations(tests, 2):
            if same_realization(one.channel(name), other.channel(name)):
                advice = "expected different seeds, or the intervals do not include what nonlinear effects do"
                return (f"{one.source} and {other.source}: the same multisine of {name}; {advice}",)
    return ()

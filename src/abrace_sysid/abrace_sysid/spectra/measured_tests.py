# SPDX-License-Identifier: Apache-2.0
"""All tests of one input, with the transfer functions estimated from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_core.run import Run
    from abrace_sysid.spectra.frequency_response import FrequencyResponse


@dataclass(frozen=True)
class TestData:
    """All tests of one input, prepared for fitting.

    Parameters
    ----------
    input
        Name of the input that was excited.
    runs
        The tests, checked, with trends removed.
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
    runs: tuple[Run, ...]
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
        return ", ".join(run.source for run in self.runs)

    def select(self, outputs: Sequence[str]) -> TestData:
        """The same tests with only these outputs, in this order."""
        return replace(self, responses=tuple(response.select(outputs) for response in self.responses))

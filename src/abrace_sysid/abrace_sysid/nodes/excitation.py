"""The node `excitation`: banded white noise as brace commands, for identification."""

from __future__ import annotations

import numpy as np

from abrace_core.brace_commander import BraceCommander
from abrace_core.errors import AbraceError
from abrace_core.node import Parameter, run
from abrace_core.noise import banded_noise

PARAMETERS = [
    Parameter("sample_rate", 500.0, "Hz, of the rig", minimum=1.0),
    Parameter("duration", 300.0, "s of noise", minimum=2.0),
    Parameter("rms", 1800.0, "N, of the force of one brace", minimum=0.0),
    Parameter("band", [0.0, 30.0], "Hz, lowest and highest frequency", minimum=0.0),
    Parameter("seed", 2, "of the noise; brace group j has seed + j", minimum=0),
    Parameter("force_limit", [24500.0], "N, of one brace of each group", minimum=1.0),
]


class Excitation(BraceCommander):
    """Answers each sample with the next value of the noise."""

    def __init__(self) -> None:
        super().__init__("excitation", PARAMETERS)

    def configure(self) -> None:
        """Make the noise."""
        given = self.parameters
        if len(given.band) != 2:
            raise AbraceError(f"parameter band: {given.band}, expected two frequencies in Hz")
        samples, band = round(given.duration * given.sample_rate), (given.band[0], given.band[1])
        self.noise = np.column_stack(
            [
                banded_noise(samples, given.sample_rate, band, given.rms, given.seed + j)
                for j in range(len(given.force_limit))
            ]
        )
        self.nothing = np.zeros(len(given.force_limit))
        self.first = 0
        self.open_loop(1 / given.sample_rate, given.force_limit)

    def restart(self, sequence: int, floors: int, groups: int) -> None:
        """The noise begins with this sample."""
        self.first = sequence
        if groups != len(self.nothing):
            self.guard.fault(f"the rig has {groups} brace groups, expected {len(self.nothing)} (parameter force_limit)")

    def force(self, sequence: int, z: tuple[float, ...], lost: int) -> np.ndarray:
        """The noise of this sample; zero when it is over."""
        index = sequence - self.first
        return self.noise[index] if index < len(self.noise) else self.nothing


def main() -> int:
    """Entry point."""
    return run(Excitation)

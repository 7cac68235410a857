# SPDX-License-Identifier: Apache-2.0
"""The node `excitation`: banded white noise or a multisine as brace commands, for identification.

abrace run abrace_sysid excitation --ros-args -p rms:=1800 -p band:=[0,30] -p duration:=300
"""

from __future__ import annotations

import numpy as np

from abrace_core.errors import AbraceError
from abrace_core.multisine import LINES
from abrace_core.node import Parameter, run
from abrace_core.node.brace_commander import BraceCommander
from abrace_sysid.excitation_signal import excitation_signal

PARAMETERS = [
    Parameter("sample_rate", 500.0, "Hz, sample rate of the rig", minimum=1.0),
    Parameter("signal", "white_noise", "white_noise or multisine", choices=("white_noise", "multisine")),
    Parameter("duration", 300.0, "s of noise; a multisine has as many whole periods as fit", minimum=2.0),
    Parameter(
        "rms", [1800.0], "N, rms of the force of one brace: of all groups, or of each; 0: a group at rest", minimum=0.0
    ),
    Parameter("band", [0.0, 30.0], "Hz, lowest and highest frequency", minimum=0.0),
    Parameter("seed", 2, "seed of the signal; white noise of brace group j has seed + j", minimum=0),
    Parameter("period", 32.768, "s, period of a multisine", minimum=0.01),
    Parameter("lines", "odd", "frequency lines of a multisine; brace groups share them in turn", choices=LINES),
    Parameter("slope", 0.0, "of a multisine: power of the frequency with which amplitudes grow"),
    Parameter("force_limit", [24500.0], "N, greatest force of one brace of each group", minimum=1.0),
]


class Excitation(BraceCommander):
    """Publishes for each sample the command that is the next value of the signal."""

    def __init__(self) -> None:
        super().__init__("excitation", PARAMETERS)

    def configure(self) -> None:
        """Make the signal."""
        given = self.parameters
        if len(given.band) != 2:
            raise AbraceError(f"parameter band: {given.band}, expected two frequencies in Hz")
        groups = len(given.force_limit)
        self.signal = excitation_signal(given, groups)
        self.nothing = np.zeros(groups)
        self.first: int | None = None
        self.cancelled = ""
        self.played = 0
        self.create_topics(1 / given.sample_rate, given.force_limit)

    def activate(self) -> None:
        """Play the signal, from the first sample on."""
        super().activate()
        self.first, self.cancelled, self.played = None, "", 0
        self.played_in_run = -1

    def interrupt(self, cause: str) -> None:
        """End the signal after a fault or stop of the rig; it does not start again by itself after a reset."""
        if self.played < len(self.signal):
            self.cancelled = cause

    def restart(self, sequence: int, floors: int, groups: int) -> None:
        """Begin the signal with this sample, once in each run of the rig."""
        run = self.answering.watch.run
        if run != self.played_in_run:
            self.first, self.played, self.played_in_run = sequence, 0, run
        if groups != len(self.nothing):
            self.safety.fault(
                f"the rig has {groups} brace groups, expected {len(self.nothing)} (parameter force_limit)"
            )

    def force(self, sequence: int, z: tuple[float, ...], lost: int) -> np.ndarray:
        """The value of the signal at this sample; zero after its end."""
        if self.first is None or self.cancelled:
            return self.nothing
        index = sequence - self.first
        self.played = min(index + 1, len(self.signal))
        return self.signal[index] if index < len(self.signal) else self.nothing

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`, with the progress of the signal."""
        fault, message, values = super().diagnose()
        if self.configured and (self.first is not None or self.cancelled):
            rate, over = self.parameters.sample_rate, self.played == len(self.signal)
            values |= {
                "elapsed": self.played / rate,
                "duration": len(self.signal) / rate,
                "signal": "cancelled" if self.cancelled else "over" if over else "playing",
            }
            if self.cancelled and not fault:
                message = f"cancelled: {self.cancelled}; deactivate and activate it to play again"
        return fault, message, values


def main() -> int:
    """Entry point."""
    return run(Excitation)

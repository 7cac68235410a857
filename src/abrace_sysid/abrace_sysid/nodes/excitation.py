# SPDX-License-Identifier: Apache-2.0
"""The node `excitation`: banded white noise or a multisine as brace commands, for identification.

abrace run abrace_sysid excitation --ros-args -p rms:=1800 -p band:=[0,30] -p duration:=300
abrace play excitation
"""

from __future__ import annotations

import numpy as np
from std_srvs.srv import Trigger

from abrace_core import AbraceError
from abrace_core.model.multisine import LINES
from abrace_core.model.noise import LONGEST_SIGNAL
from abrace_node.commander import OVER, PLAYING, READY, BraceCommander
from abrace_node.parameters import Parameter
from abrace_node.process import run
from abrace_sysid.excitation_signal import excitation_signal

PARAMETERS = [
    Parameter("sample_rate", 500.0, "Hz, sample rate of the rig", minimum=1.0),
    Parameter("signal", "white_noise", "white_noise or multisine", choices=("white_noise", "multisine")),
    Parameter(
        "duration",
        300.0,
        "s of noise; a multisine has as many whole periods as fit",
        minimum=2.0,
        maximum=LONGEST_SIGNAL,
    ),
    Parameter(
        "rms", [1800.0], "N, rms of the force of one brace: of all groups, or of each; 0: a group at rest", minimum=0.0
    ),
    Parameter("band", [0.0, 30.0], "Hz, lowest and highest frequency", minimum=0.0),
    Parameter("seed", 2, "seed of the signal; white noise of brace group j has seed + j", minimum=0),
    Parameter("period", 32.768, "s, period of a multisine", minimum=0.01, maximum=LONGEST_SIGNAL),
    Parameter("lines", "odd", "frequency lines of a multisine; brace groups share them in turn", choices=LINES),
    Parameter("force_limit", [24500.0], "N, greatest force of one brace of each group", minimum=1.0),
]


class ExcitationNode(BraceCommander):
    """Publishes for each sample the command that is the next value of the signal."""

    signal = READY
    awaits_goal = True
    first: int | None = None
    """The sample with which the signal began."""
    played = 0
    """Values of the signal played so far."""

    def __init__(self) -> None:
        super().__init__("excitation", PARAMETERS)
        self.create_service(Trigger, "~/play", self.on_play)
        self.keep_endpoints()

    def configure(self) -> None:
        """Make the signal."""
        given = self.parameters
        if len(given.band) != 2:
            raise AbraceError(f"parameter band: {given.band}, expected two frequencies in Hz")
        groups = len(given.force_limit)
        self.forces = excitation_signal(given, groups)
        self.nothing = np.zeros(groups)
        self.create_topics(1 / given.sample_rate, given.force_limit)

    def play(self) -> None:
        """Begin the signal with the next sample."""
        self.begin_goal()
        self.first, self.played = None, 0

    def restart(self, sequence: int, floors: int, groups: int) -> None:
        """Check the rig's brace groups."""
        if groups != len(self.nothing):
            self.safety.fault(
                f"the rig has {groups} brace groups, expected {len(self.nothing)} (parameter force_limit)"
            )

    def force(self, sequence: int, z: tuple[float, ...], lost: int) -> np.ndarray:
        """The value of the signal at this sample; zero while none plays."""
        if self.signal != PLAYING:
            return self.nothing
        if self.first is None:
            self.first = sequence
        index = sequence - self.first
        self.played = min(index + 1, len(self.forces))
        if self.played == len(self.forces):
            self.signal = OVER
        return self.forces[index] if index < len(self.forces) else self.nothing

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`, with the progress of the signal."""
        fault, message, values = super().diagnose()
        if self.configured and self.signal != READY:
            rate = self.parameters.sample_rate
            values |= {"elapsed": self.played / rate, "duration": len(self.forces) / rate}
        return fault, message, values


def main() -> int:
    """Entry point."""
    return run(ExcitationNode)

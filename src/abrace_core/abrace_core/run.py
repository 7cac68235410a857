# SPDX-License-Identifier: Apache-2.0
"""A recorded test of the rig as arrays with named channels: the content of a bag's `response` topic."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import signals
from abrace_core.tables import data_frame

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Run:
    """A recorded test.

    Parameters
    ----------
    source
        Where it came from, for messages and provenance.
    sample_period
        Seconds.
    sequence
        (samples,) sample numbers.
    floors, groups
        Size of the rig.
    outputs
        (samples, channels): the recorded quantities z, named by `names`; a group's force is the mean of its braces'.
    ground_acceleration
        (samples,) [m/s^2].
    command
        (samples, groups) [N], in force until each sample.
    facts
        Of the run, from the bag's metadata: rig, controller, record, versions.
    clipped
        (samples,) bit i: channel i of the rig's `signals.channel_names` is at the end of its sensor's range; None
        where the bag does not say.
    braces
        (groups,) number of braces, each with a load cell; by default one in each group.
    forces
        (samples, braces) [N], of each brace, those of the first group first; None where only `outputs` has forces.
    """

    source: str
    sample_period: float
    sequence: NDArray[np.uint64]
    floors: int
    groups: int
    outputs: NDArray[np.float64]
    ground_acceleration: NDArray[np.float64]
    command: NDArray[np.float64]
    facts: dict[str, Any] = field(default_factory=dict)
    clipped: NDArray[np.uint64] | None = None
    braces: tuple[int, ...] = ()
    forces: NDArray[np.float64] | None = None

    def __repr__(self) -> str:
        rig = f"{self.floors} floors, {self.groups} brace group{'' if self.groups == 1 else 's'}"
        rate, samples = 1 / self.sample_period, len(self.sequence)
        return f"<Run {self.source}: {samples * self.sample_period:g} s at {rate:g} Hz, {rig}>"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels of `outputs`."""
        return signals.response_names(self.floors, self.groups)

    @property
    def command_names(self) -> tuple[str, ...]:
        """Names of the commands."""
        return signals.command_names(self.groups)

    @property
    def command_from_here(self) -> NDArray[np.float64]:
        """(samples, groups) [N], the command in force from each sample on: a held input, as models expect it."""
        return np.vstack([self.command[1:], self.command[-1:]])

    @property
    def time(self) -> NDArray[np.float64]:
        """(samples,) seconds since the rig's sample 0, which is not in a record that began late."""
        return self.sequence.astype(np.float64) * self.sample_period

    @property
    def clipped_samples(self) -> dict[str, int] | None:
        """By channel, how many samples are at the end of its sensor's range, where there are some; None: unknown."""
        if self.clipped is None:
            return None
        names = signals.channel_names(self.floors, self.braces or (1,) * self.groups)[:64]
        counts = {name: int(np.sum(self.clipped >> np.uint64(i) & np.uint64(1))) for i, name in enumerate(names)}
        return {name: count for name, count in counts.items() if count}

    def channels(self, names: Sequence[str]) -> NDArray[np.float64]:
        """(samples, len(names)) of these outputs, commands or the ground acceleration; `names` in either form.

        Raises
        ------
        AbraceError
            With all names that are not among them (`signals.positions`).
        """
        known = (*self.names, *self.command_names, signals.GROUND)
        chosen = signals.positions(names, known, f"{self.source}: no channel")
        return np.hstack([self.outputs, self.command, self.ground_acceleration[:, None]])[:, chosen]

    def to_pandas(self) -> pandas.DataFrame:
        """All channels as columns [SI units, in `attrs`], by the time since the first sample [s].

        Raises
        ------
        AbraceError
            If pandas is not installed.
        """
        names = (*self.names, *self.command_names, signals.GROUND)
        frame = data_frame(dict(zip(names, self.channels(names).T, strict=True)), "time [s]", self.time)
        frame.attrs["units"] = {name: signals.unit(name) for name in names}
        return frame

    def plot(self, channels: Sequence[str] = ()) -> Figure:
        """Time histories, an axis for each kind of quantity.

        Parameters
        ----------
        channels
            To draw, in either form; none: all.

        Raises
        ------
        AbraceError
            As in `channels`.
        """
        from abrace_core.signal_figure import time_histories

        all_names = (*self.names, *self.command_names, signals.GROUND)
        names = (channels,) if isinstance(channels, str) else tuple(channels) or all_names
        values = {
            name: (column, signals.unit(name)) for name, column in zip(names, self.channels(names).T, strict=True)
        }
        return time_histories(self.time, values, self.source)

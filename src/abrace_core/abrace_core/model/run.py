# SPDX-License-Identifier: Apache-2.0
"""A recorded test of the rig as arrays with named channels: the content of a bag's `response` topic."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.model.plotted import figure_of
from abrace_core.model.tabular import Tabular

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray


FLAGGED = 64
"""Number of channels that the flags of a response can name, the first ones of the rig."""


def clipped_counts(flags: NDArray[np.uint64], names: Sequence[str]) -> dict[str, int | None]:
    """How many samples of each channel are at the end of its sensor's range; None: the flags have no bit for it.

    Parameters
    ----------
    flags
        (samples,) bit i: the channel names[i].
    names
        The rig's `signals.channel_names`; those without such a sample are left out.
    """
    counts = {name: int(np.sum(flags >> np.uint64(i) & np.uint64(1))) for i, name in enumerate(names[:FLAGGED])}
    return {name: count for name, count in counts.items() if count} | dict.fromkeys(names[FLAGGED:])


@dataclass(frozen=True)
class Run(Tabular):
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
        (samples,) [m/s^2]; of a structure that is no rig the `disturbance`.
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
        (samples, load cells) [N], those of the first group first; None where only `outputs` has forces.
    without
        Those of the rig's `signals.channel_names` for which there is no sensor. They are not in `outputs` and `forces`;
        the table's acceleration is then NaN.
    signals
        Of a structure that is no rig, which has no floors: names of the outputs, of the disturbance and of the
        commands, in this order; none: those of a rig.
    units
        Of these, by name.
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
    signals: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    without: tuple[str, ...] = ()

    def __repr__(self) -> str:
        rig = f"{self.floors} floors, {self.groups} brace group{'' if self.groups == 1 else 's'}"
        if self.signals:
            rig = f"{', '.join((self.disturbance, *self.command_names))} to {', '.join(self.names)}"
        elif self.without:
            rig += f", {', '.join(self.without)} not measured"
        rate, samples = 1 / self.sample_period, len(self.sequence)
        clipped = [f"{name} {count} samples" for name, count in (self.clipped_samples or {}).items() if count]
        wrong = [f"STOPPED: {self.stopped}"] * bool(self.stopped) + [f"CLIPPED: {', '.join(clipped)}"] * bool(clipped)
        return (
            "; ".join([f"<Run {self.source}: {samples * self.sample_period:g} s at {rate:g} Hz, {rig}", *wrong]) + ">"
        )

    @property
    def stopped(self) -> str:
        """The cause for which the rig was stopped during the run; empty: it was not, or the bag does not say."""
        return str(self.facts.get("stopped", ""))

    def __getitem__(self, which: str | Sequence[str] | slice) -> Any:
        """`run["x3"]`: that channel (samples,), several (samples, channels); `run[10:20]`: the Run of these seconds.

        Seconds are those of `time`, the end excluded.
        """
        if isinstance(which, str):
            return self.channels(which)[:, 0]
        if isinstance(which, (list, tuple)):
            return self.channels(which)
        if not isinstance(which, slice) or which.step is not None:
            raise AbraceError(
                f"{self.source}: [{which!r:.40}], expected a channel or seconds, as run['x1'], run[10:20]"
            )
        try:
            first = -np.inf if which.start is None else float(which.start)
            last = np.inf if which.stop is None else float(which.stop)
        except (TypeError, ValueError) as error:
            raise AbraceError(f"{self.source}: {which.start!r} to {which.stop!r}, expected seconds") from error
        begin, end = np.searchsorted(self.time, [first, last])
        if not (first < last and begin < end):
            raise AbraceError(f"{self.source}: no sample of {which.start} to {which.stop} s, expected some")
        part = slice(int(begin), int(end))
        series = ("sequence", "outputs", "ground_acceleration", "command", "clipped", "forces")
        given = {name: getattr(self, name) for name in series}
        return replace(self, **{name: each[part] for name, each in given.items() if each is not None})

    def __getattr__(self, name: str) -> Any:
        hint = f", expected run[{name!r}] for the channel" if signals.meaning(name) != name else ""
        raise AttributeError(f"a Run has no attribute {name!r}{hint}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels of `outputs`."""
        if self.signals:
            return self.signals[: self.outputs.shape[1]]
        return signals.recorded_names(self.floors, self.braces or (1,) * self.groups, self.without)

    @property
    def command_names(self) -> tuple[str, ...]:
        """Names of the commands."""
        return self.signals[self.outputs.shape[1] + 1 :] if self.signals else signals.command_names(self.groups)

    @property
    def disturbance(self) -> str:
        """Name of what disturbs: of a rig `w`."""
        return self.signals[self.outputs.shape[1]] if self.signals else signals.GROUND

    @property
    def all_names(self) -> tuple[str, ...]:
        """Names of the outputs, of the commands, and of the disturbance if it is measured."""
        return (*self.names, *self.command_names, *({self.disturbance} - {*self.without}))

    @property
    def command_from_here(self) -> NDArray[np.float64]:
        """(samples, groups) [N], the command in force from each sample on: a held input, as models expect it."""
        return np.vstack([self.command[1:], self.command[-1:]])

    @property
    def time(self) -> NDArray[np.float64]:
        """(samples,) seconds since the rig's sample 0, which is not in a record that began late."""
        return self.sequence.astype(np.float64) * self.sample_period

    @property
    def clipped_samples(self) -> dict[str, int | None] | None:
        """By channel, how many samples are at the end of its sensor's range, where there are some; None: unknown."""
        if self.clipped is None:
            return None
        return clipped_counts(self.clipped, signals.channel_names(self.floors, self.braces or (1,) * self.groups))

    def is_same(self, other: Run) -> bool:
        """Whether the `other` is the same test: every sample of every channel is equal, whatever the tests' names."""
        series = ("sequence", "outputs", "ground_acceleration", "command")
        return self is other or all(np.array_equal(getattr(self, one), getattr(other, one)) for one in series)

    def channels(self, names: Sequence[str]) -> NDArray[np.float64]:
        """(samples, len(names)) of these outputs, commands or the disturbance; `names` in either form.

        Raises
        ------
        AbraceError
            With all names that are not among them (`signals.positions`).
        """
        chosen = signals.positions(names, self.all_names, f"{self.source}: no channel")
        return np.hstack([self.outputs, self.command, self.ground_acceleration[:, None]])[:, chosen]

    def to_pandas(self) -> pandas.DataFrame:
        """All channels as columns [SI units, in `attrs`], by the time since the rig's sample 0 [s] (`time`)."""
        import pandas

        names = self.all_names
        frame = pandas.DataFrame(
            dict(zip(names, self.channels(names).T, strict=True)), index=pandas.Index(self.time, name="time [s]")
        )
        frame.attrs["units"] = {name: self.unit(name) for name in names}
        return frame

    def unit(self, name: str) -> str:
        """SI unit of the channel `name`; "-": it is not known."""
        return self.units.get(name) or signals.unit(name)

    def plot(self, channels: Sequence[str] = ()) -> Figure:
        """Time histories, an axis for each kind of quantity.

        Parameters
        ----------
        channels
            Channels to draw, in either form; none: all.

        Raises
        ------
        AbraceError
            As in `channels`.
        """
        return figure_of(self, "plot", channels)

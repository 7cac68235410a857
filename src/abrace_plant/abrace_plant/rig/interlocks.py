# SPDX-License-Identifier: Apache-2.0
"""Interlocks: limits on the readings of a rig's sensors, checked at every sample, whichever node commands.

Each interlock of `limits.limit_table` watches every channel of its kind. It acts when its value has been exceeded for
its time without a break; a reading that is not a number trips at once. Some watch quantities of `detectors`, three the
readings themselves: `stuck` (the same to the last bit), `dead` (less than its own noise) and `clipped` (at the end of
the sensor's range). `stuck` and `dead` take longer than their time where the sensor's own noise may repeat a reading so
often: at low sample rates. A sensor whose noise is less than a step of its converter is not watched for them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_core.model import signals
from abrace_core.model.compiled import compiled
from abrace_plant.rig.detectors import OSCILLATION_TIME, Quantity, detectors
from abrace_plant.rig.limits import FORCES, INTERLOCKS, cell_limits, limit_table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig
    from abrace_plant.rig.sensors import Sensor

NUMBER = "number"
"""What `Trip` names as the interlock where a reading or the command is not a number."""
NEVER = 2**62
"""Samples after which a channel that is not watched would trip."""
RARELY = 1e-12
"""Greatest probability that a sensor's noise alone repeats a reading so often that it counts as stuck or dead."""


class Trip(NamedTuple):
    """What an interlock found; as text, a sentence with its key in the rig file.

    Parameters
    ----------
    interlock
        Its key in the rig file.
    channel
        The first channel that exceeded it.
    name
        Of the quantity, as in messages.
    value, limit
        At the sample at which it acted, and the interlock's; SI units, see `limits.INTERLOCKS`. Of `stuck`, `dead` and
        `clipped` the value is the reading.
    time
        For which the limit was exceeded [s].
    """

    interlock: str
    channel: str
    name: str
    value: float
    limit: float
    time: float

    def __str__(self) -> str:
        span = f"for {1e3 * self.time:.4g} ms"
        if self.interlock == NUMBER:
            return f"{self.name}: {self.value}, expected a number"
        if self.interlock in STATES:
            return f"{self.name} at {_short(self.value)} {span} (interlocks.{self.interlock})"
        _, unit = INTERLOCKS[self.interlock]
        found = f"{self.name}: {_short(self.value)} {unit} {span}"
        return f"{found}, limit {_short(self.limit)} (interlocks.{self.interlock})"


def _short(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


STATES = {
    "dead": "{}: less than its own noise,",
    "stuck": "{}: stuck",
    "clipped": "{}: at the end of its range,",
}
"""Interlocks on the readings themselves, and how a message names them."""


class Interlocks:
    """The interlocks of a rig.

    Parameters
    ----------
    rig
        The rig.

    Attributes
    ----------
    table
        Every interlock of the rig by its key, in the order in which they are asked.
    warnings
        What the interlocks with the action "warn" found at the last sample.
    trips
        By interlock, how often it has acted so far.
    """

    def __init__(self, rig: Rig) -> None:
        found = detectors(rig)
        self.table = limit_table(rig, found.noise)
        sensors, names = rig.channel_sensors, rig.channel_names
        self._channels = count = len(sensors)
        self._names = (*names, *signals.command_names(rig.groups), "displacement of the table", "velocity of the table")
        self._quantities = (
            *found.quantities,
            *(Quantity(state, name, text.format(name)) for state, text in STATES.items() for name in names),
        )
        kinds = [self.table[quantity.interlock] for quantity in self._quantities]
        self._stops = [kind.action == "stop" for kind in kinds]
        self._period = 1 / rig.sample_rate
        needed = [max(1, math.ceil(kind.time * rig.sample_rate - 1e-9)) for kind in kinds]
        linear = len(found.quantities)
        share = self.table["dead"].value
        repeats = [_repeats(sensor, share) for sensor in sensors] + [_repeats(sensor, 0.0) for sensor in sensors]
        self._needed = np.array(needed)
        self._needed[linear : linear + 2 * count] = np.maximum(needed[linear : linear + 2 * count], repeats)
        of_cells = {
            name: cell_limits(rig, self.table[name], found.noise.get(name, 0.0))
            for name in FORCES
            if name in self.table
        }
        self._limits = np.array(
            [
                of_cells[each.interlock][each.channel] if each.interlock in FORCES else kind.value
                for each, kind in zip(found.quantities, kinds, strict=False)
            ]
        )
        settles = np.array([one.interlock == "implausible_acceleration" for one in found.quantities])
        self._settling = found.settling
        states = len(found.at_rest)
        self._at_rest = found.at_rest
        self._vector = np.zeros(found.step.shape[1])
        self._sample = np.zeros((1, len(self._vector) - states))
        self._inputs = self._sample[0]
        self._reading = self._inputs[:count]
        self._command = self._inputs[count : count + rig.groups]
        self._sizes, self._greatest = np.zeros(linear), np.zeros(linear)
        oscillates = np.array([one.interlock == "oscillation" for one in found.quantities])
        self._power = np.zeros(linear)
        self._clipped = np.zeros((1, count), dtype=np.bool_)
        band = share * np.array([sensor.noise for sensor in sensors])
        self._references = np.zeros((2, count))
        self._exceeded = np.zeros(len(self._quantities), dtype=np.int64)
        self._longest = self._exceeded.copy()
        self._arrays = (
            np.ascontiguousarray(found.step.T),
            self._vector,
            np.zeros(len(found.step)),
            self._limits,
            settles,
            np.where(oscillates, 1 / (OSCILLATION_TIME * rig.sample_rate), 0.0),
            self._power,
            self._sizes,
            self._greatest,
            band,
            self._references,
            self._needed,
            self._exceeded,
            self._longest,
        )
        _look(0, self._sample, self._clipped, *self._arrays)  # compiled now, and not between two samples
        self._longest[:] = 0
        self.trips = dict.fromkeys(self.table, 0)
        self.warnings: list[Trip] = []
        self.reset()

    def reset(self) -> None:
        """Restart, with a new run or after a person has cleared a stop: all times count from the next sample."""
        self._samples = 0
        self._exceeded[:] = 0
        self._clipped[:] = 0
        self._was_clipped = 0
        self.warnings = []

    def check(
        self,
        reading: NDArray[np.float64],
        command: Sequence[float] | NDArray[np.float64],
        table_velocity: float,
        stopping_place: float,
        clipped: int,
    ) -> Trip | None:
        """Check a sample; to be called at every one.

        Parameters
        ----------
        reading
            (channels,) [displacements, strokes, accelerations, forces, ground acceleration], SI units.
        command
            (groups,) [N], in force until this sample, for one brace of each group.
        table_velocity, stopping_place
            Of the commanded motion: its velocity [m/s]; and the displacement at which the table can come to a
            standstill at the earliest [m], as from `TableGuard.turning_point`.
        clipped
            Bit i: channel i is at the end of its range, as from `OverRange`.

        Returns
        -------
        Trip or None
            The interlock that requires a protective stop, the first in the order of the table, as long as its value is
            exceeded. Interlocks that only warn are in `warnings`.
        """
        np.positive(reading, self._reading)  # an assignment in NumPy 1 lets other threads have the interpreter
        self._command[:] = command
        self._inputs[-2], self._inputs[-1] = stopping_place, table_velocity
        if not math.isfinite(sum(self._inputs.tolist())):  # because one of the inputs is not, or is absurd
            return self._not_a_number()
        if not self._samples:
            self._begin()
        settling = self._settling - self._samples
        self._samples += settling > 0
        if clipped != self._was_clipped:
            self._was_clipped = clipped
            self._clipped[:] = [clipped >> i & 1 for i in range(self._channels)]
        if _look(settling, self._sample, self._clipped, *self._arrays) == 0:
            return self._report()
        if self.warnings:
            self.warnings = []
        return None

    def first_trip(self, inputs: NDArray[np.float64], clipped: NDArray[np.bool_]) -> tuple[int, Trip] | None:
        """The first sample of a whole test that requires a protective stop, and the interlock; None: there is none.

        Parameters
        ----------
        inputs
            (samples, channels + groups + 2): of each sample what `check` takes, reading, command, place and velocity.
        clipped
            (samples, channels): whether a channel is at the end of its range.
        """
        finite = np.isfinite(inputs.sum(axis=1))
        count = len(inputs) if finite.all() else int(np.argmin(finite))
        first = 0
        while first < count:
            self._inputs[:] = inputs[first]
            if not first:
                self._begin()
            first += _look(self._settling - first, inputs[first:count], clipped[first:count], *self._arrays)
            if first < count:
                self._inputs[:] = inputs[first]
                if trip := self._report():
                    return first, trip
            first += 1
        if count < len(inputs):
            self._inputs[:] = inputs[count]
            return count, self._not_a_number()
        return None

    def utilisation(self) -> dict[str, float]:
        """By interlock, the greatest value so far over its limit, of the channel that came nearest.

        Of `stuck`, `dead` and `clipped` it is the longest time over theirs. It is kept over `reset`.
        """
        shares = np.concatenate([self._greatest / self._limits, (self._longest / self._needed)[len(self._greatest) :]])
        found = dict.fromkeys(self.table, 0.0)
        for quantity, share in zip(self._quantities, shares.tolist(), strict=True):
            found[quantity.interlock] = max(found[quantity.interlock], share)
        return found

    def greatest(self) -> dict[str, float]:
        """By interlock, the greatest value so far, 0 for those on the readings themselves; it is kept over `reset`."""
        found = dict.fromkeys(self.table, 0.0)
        for quantity, value in zip(self._quantities, self._greatest.tolist(), strict=False):
            found[quantity.interlock] = max(found[quantity.interlock], value)
        return found

    def _begin(self) -> None:
        """The first sample: filters start in steady state."""
        self._vector[: len(self._at_rest)] = self._at_rest @ self._inputs
        self._references[:] = self._reading
        self._power[:] = 0.0

    def _not_a_number(self) -> Trip:
        place = int(np.argmax(np.where(np.isfinite(self._inputs), np.abs(self._inputs), np.inf)))
        return Trip(NUMBER, self._names[place], self._names[place], float(self._inputs[place]), math.inf, self._period)

    def _report(self) -> Trip | None:
        stop: Trip | None = None
        self.warnings = []
        for i in np.flatnonzero(self._exceeded >= self._needed).tolist():
            quantity, samples = self._quantities[i], int(self._exceeded[i])
            if samples == self._needed[i]:
                self.trips[quantity.interlock] += 1
            linear = len(self._sizes)
            value = self._sizes[i] if i < linear else self._reading[(i - linear) % self._channels]
            limit = self._limits[i] if i < linear else self.table[quantity.interlock].value
            trip = Trip(*quantity, float(value), float(limit), samples * self._period)
            if not self._stops[i]:
                self.warnings.append(trip)
            elif stop is None:
                stop = trip
        return stop


def _repeats(sensor: Sensor, share: float) -> int:
    """Samples in a row within a `share` of its noise from one of them that a `sensor` has RARELY; NEVER: it may."""
    if sensor.noise < sensor.step:
        return NEVER
    chance = math.erf((share + sensor.step / 2 / sensor.noise) / math.sqrt(2))
    return math.ceil(math.log(RARELY) / math.log(chance))


@compiled
def _look(
    settling: int,
    inputs: NDArray[np.float64],
    clipped: NDArray[np.bool_],
    step: NDArray[np.float64],
    vector: NDArray[np.float64],
    result: NDArray[np.float64],
    limits: NDArray[np.float64],
    settles: NDArray[np.bool_],
    shares: NDArray[np.float64],
    power: NDArray[np.float64],
    sizes: NDArray[np.float64],
    greatest: NDArray[np.float64],
    band: NDArray[np.float64],
    references: NDArray[np.float64],
    needed: NDArray[np.int64],
    exceeded: NDArray[np.int64],
    longest: NDArray[np.int64],
) -> int:
    """Advance the filters through samples, and all that counts them; returns the first one at which an interlock acts.

    That is the number of samples where none does. Of `inputs` and `clipped` each row is a sample.
    result = vector step, where `result` is [next states; quantities] and `vector` [states; inputs]. Of quantities with
    a share the rms counts, of those that settle nothing for so many samples. `exceeded` counts samples of [quantities;
    dead; stuck; clipped], whose `references` are the readings from which the later ones are counted.
    """
    quantities, channels = len(sizes), len(band)
    states = len(result) - quantities
    reading = vector[states : states + channels]
    for k in range(len(inputs)):
        vector[states:] = inputs[k]
        result[:] = 0.0
        for j in range(len(vector)):
            for i in range(len(result)):
                result[i] += step[j, i] * vector[j]
        vector[:states] = result[:states]
        acts = False
        for i in range(len(exceeded)):
            if i < quantities:
                size = abs(result[states + i])
                if settling > k and settles[i]:
                    size = 0.0
                if shares[i]:
                    power[i] += shares[i] * (size * size - power[i])
                    size = math.sqrt(power[i])
                sizes[i] = size
                greatest[i] = max(greatest[i], size)
                within = size <= limits[i]
            else:
                kind, channel = (i - quantities) // channels, (i - quantities) % channels
                if kind == 2:
                    within = not clipped[k, channel]
                else:
                    within = abs(references[kind, channel] - reading[channel]) > (0.0 if kind else band[channel])
                    if within:
                        references[kind, channel] = reading[channel]
            exceeded[i] = 0 if within else exceeded[i] + 1
            longest[i] = max(longest[i], exceeded[i])
            acts = acts or exceeded[i] >= needed[i]
        if acts:
            return k
    return len(inputs)

# SPDX-License-Identifier: Apache-2.0
"""Check of the sensors by their readings: at rest by their noise, in motion by comparing the signals of each floor.

A floor's accelerometer reads the second derivative of its displacement plus the table's acceleration, for any
building; a brace's stroke is `cosine` times the drift of its storey. So with enough motion in a record every channel
can be predicted from others. A channel that agrees with another floor's prediction, but not with its own, is swapped;
one that agrees with reversed sign has the wrong sign. The table's accelerometer is one for all floors: where every
floor that follows it tells the same gain, it is that one's. Both are compared in the frequency domain, each frequency
weighted by the noise that the two sides have there. The braces of a group have the same command and the same drift:
their load cells read the same force.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_plant.rig.sensors import OverRange

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from abrace_plant.rig.model import Rig

DEAD_TIME = 1.0
"""Seconds after which an unchanged reading means a dead channel: noise would change the last bits."""
NOISY = 3.0
"""Times the noise of the rig file."""
LOWEST = 0.3
"""Hz below which drift and the ends of the record dominate."""
MOTION = 10.0
"""Times the noise that signals must be, in root mean square, to be compared."""
FITS, BETTER = 0.3, 4.0
"""Share of a signal's power that a prediction which fits may leave; how many times less than one that does not."""
GAIN_ERROR = 0.1
"""Share by which two sensors' sizes may differ."""
LEAST_SAMPLES = 100
"""Samples of a record, at least."""
FINEST = 1e-12
"""Share of the range that is the least expected noise: a simulated sensor may have neither noise nor steps."""


@dataclass(frozen=True)
class ChannelCheck:
    """What one channel reads.

    Parameters
    ----------
    name, unit
        Of the channel; its SI unit.
    mean
        Of the record.
    noise
        Standard deviation of what is white in it, from fourth differences, which slow motion hardly enters.
    expected_noise
        Of the rig file, with that of the converter's steps.
    range_use
        Greatest reading over the end of the range on its side.
    drift
        Change over the record of the straight line through it.
    faults
        The faults found, as texts; empty: none.
    """

    name: str
    unit: str
    mean: float
    noise: float
    expected_noise: float
    range_use: float
    drift: float
    faults: tuple[str, ...]


@dataclass(frozen=True)
class SensorCheck:
    """The state of the sensors, from a record.

    Parameters
    ----------
    channels
        In the order of a reading.
    judged
        Whether there was enough motion to find channels that are swapped or have the wrong sign; None: no two sensors
        measure the same, which nothing could tell.
    """

    channels: tuple[ChannelCheck, ...]
    judged: bool | None

    @property
    def well(self) -> bool:
        """Whether no channel has a fault."""
        return not any(channel.faults for channel in self.channels)

    def text(self) -> str:
        """A table, a line for each channel."""
        lines = [f"{'':4} {'unit':6} {'mean':>11} {'noise':>10} {'expected':>10} {'range %':>8} {'drift':>11}"]
        for c in self.channels:
            row = f"{c.name:4} {c.unit:6} {c.mean:11.4g} {c.noise:10.3g} {c.expected_noise:10.3g}"
            row += f" {100 * c.range_use:8.2f} {c.drift:11.3g}  {'; '.join(c.faults)}"
            lines.append(row.rstrip())
        if not self.judged:
            why = "no two sensors measure the same" if self.judged is None else "the rig hardly moved"
            lines.append(f"Swapped channels and signs: not checked, {why}.")
        return "\n".join(lines)


def check_sensors(
    rig: Rig, readings: ArrayLike, clipped: Sequence[int] | None = None, ranges: ArrayLike | None = None
) -> SensorCheck:
    """Check the sensors of a rig by a record.

    Parameters
    ----------
    rig
        Its sensors' noise and range, its floors and braces.
    readings
        (samples, channels) as a device or a bag gives them.
    clipped
        (samples,) bits as in `Reading.clipped` and `Run.clipped`: the channels at the end of their range. None:
        unknown. Readings at the end of the rig file's range are found in any case.
    ranges
        (channels, 2) lower and upper end of the channels' ranges in SI units, if narrower than those of the rig file.

    Raises
    ------
    AbraceError
        If the record has another number of channels, is too short, or not finite.
    """
    names = rig.channel_names
    values = np.asarray(readings, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] != len(names) or len(values) < LEAST_SAMPLES:
        raise AbraceError(
            f"readings of shape {values.shape}, expected at least {LEAST_SAMPLES} samples of {len(names)} channels"
        )
    if not np.isfinite(values).all():
        bad = names[int(np.flatnonzero(~np.isfinite(values).all(axis=0))[0])]
        raise AbraceError(f"readings of {bad} are not finite")
    sensors = rig.channel_sensors
    high = np.array([sensor.range for sensor in sensors])
    low = -high
    if ranges is not None:
        low, high = np.maximum(low, np.asarray(ranges)[:, 0]), np.minimum(high, np.asarray(ranges)[:, 1])
    over_range = OverRange(sensors)
    at_end = (values < over_range.lowest) | (values > over_range.highest)
    if clipped is not None:
        at_end |= np.array([[bits >> i & 1 for i in range(len(names))] for bits in clipped], dtype=np.bool_)
    upper = values > (low + high) / 2
    ends = (("lower", low, at_end & ~upper), ("upper", high, at_end & upper))
    expected = np.array([np.hypot(sensor.noise, sensor.step / np.sqrt(12)) for sensor in sensors])
    expected = np.maximum(expected, FINEST * np.array([sensor.range for sensor in sensors]))
    # the fourth difference of white noise has the variance 1 + 16 + 36 + 16 + 1 of its own
    noise = np.diff(values, 4, axis=0).std(axis=0) / np.sqrt(70)
    use = np.maximum(values.max(axis=0) / high, values.min(axis=0) / low)
    time = np.linspace(-0.5, 0.5, len(values))
    drift = time @ values / (time @ time)
    moves = values.std(axis=0) > MOTION * expected
    faults: list[list[str]] = [[] for _ in names]
    for i, column in enumerate(values.T):
        same = _longest_constant(column)
        # without noise a reading may stay the same, unless others of its kind move
        alike = [moves[j] for j, sensor in enumerate(sensors) if sensor is sensors[i] and j != i]
        noisy = sensors[i].noise >= sensors[i].step / 2
        if same >= min(len(column), DEAD_TIME * rig.sample_rate) and (noisy or any(alike)):
            faults[i].append(f"dead: the same reading for {same / rig.sample_rate:.3g} s")
        for end, limit, where in ends:
            if count := int(where[:, i].sum()):
                samples = f"{count} sample{'s' if count > 1 else ''}"
                faults[i].append(
                    f"clipped: {samples} at the {end} end of the range, {limit[i]:.4g} {signals.unit(names[i])}"
                )
        if noise[i] > NOISY * expected[i]:
            faults[i].append(f"noisy: {noise[i] / expected[i]:.1f} times the rig file's noise")
    judged = _compare(rig, values, expected, names, faults)
    means = values.mean(axis=0)
    checks = [
        ChannelCheck(
            name,
            signals.unit(name),
            float(means[i]),
            float(noise[i]),
            float(expected[i]),
            float(use[i]),
            float(drift[i]),
            tuple(faults[i]),
        )
        for i, name in enumerate(names)
    ]
    return SensorCheck(tuple(checks), judged)


def _longest_constant(column: NDArray[np.float64]) -> int:
    """Samples of the longest stretch with one value."""
    changes = np.flatnonzero(np.diff(column) != 0) + 1
    return int(np.diff([0, *changes.tolist(), len(column)]).max())


def _compare(
    rig: Rig, values: NDArray[np.float64], noise: NDArray[np.float64], names: Sequence[str], faults: list[list[str]]
) -> bool | None:
    """Compare accelerations with displacements, strokes with drifts, and load cells of one group, as far as there are.

    Returns whether there was motion enough; None: nothing can be compared.
    """
    place = {name: i for i, name in enumerate(names)}
    window = np.hanning(len(values))[:, None]
    spectra = np.fft.rfft((values - values.mean(axis=0)) * window, axis=0)
    frequencies = np.fft.rfftfreq(len(values), 1 / rig.sample_rate)
    spectra, frequencies = spectra[frequencies > LOWEST], frequencies[frequencies > LOWEST]
    squares = ((2 * np.pi * frequencies) ** 2)[:, None]
    power, judged = float((window**2).sum()), list[bool]()
    floors = [i for i in range(1, rig.floors + 1) if f"x{i}" in place and f"a{i}" in place and signals.GROUND in place]
    if floors:
        of_x, of_a = ([place[f"{kind}{i}"] for i in floors] for kind in "xa")
        x, a, table = spectra[:, of_x], spectra[:, of_a], spectra[:, [place[signals.GROUND]]]
        weight = 1 / (power * (noise[of_a[0]] ** 2 + (squares * noise[of_x[0]]) ** 2))
        if np.vdot(table, table).real >= NOISY**2 * noise[-1] ** 2 * power * len(table):
            table = table / _table_gain(table, a, squares * x, weight, names[-1], faults[-1])
        own, others = ([names[i] for i in each] for each in (of_a, of_x))
        judged.append(_judge(a, table - squares * x, weight, own, others, [faults[i] for i in of_a]))
    of_floor = {
        0: np.zeros(len(spectra)),
        **{i: spectra[:, place[f"x{i}"]] for i in range(1, rig.floors + 1) if f"x{i}" in place},
    }
    braces = [
        (place[name], group)
        for name, group in zip(signals.numbered("xf", rig.groups), rig.braces, strict=True)
        if name in place and group.floor in of_floor and group.floor - 1 in of_floor
    ]
    if braces:
        of_stroke = [i for i, _ in braces]
        drifts = [one.cosine * (of_floor[one.floor] - of_floor[one.floor - 1]) for _, one in braces]
        storeys = [f"the drift of storey {one.floor}" for _, one in braces]
        even = np.full_like(
            squares, 1 / (power * (noise[of_stroke[0]] ** 2 + 2 * noise[place[f"x{braces[0][1].floor}"]] ** 2))
        )
        own = [names[i] for i in of_stroke]
        judged.append(
            _judge(spectra[:, of_stroke], np.column_stack(drifts), even, own, storeys, [faults[i] for i in of_stroke])
        )
    cells = iter(signals.load_cell_names(rig.braces_in_group))
    for count in rig.braces_in_group:
        if there := [place[name] for name in itertools.islice(cells, count) if name in place]:
            _compare_cells(
                spectra[:, there], noise[there[0]] ** 2 * power, [names[i] for i in there], [faults[i] for i in there]
            )
    return all(judged) if judged else None


def _table_gain(
    table: NDArray[np.complex128],
    a: NDArray[np.complex128],
    restoring: NDArray[np.complex128],
    weight: NDArray[np.float64],
    name: str,
    faults: list[str],
) -> float:
    """How many times the table's acceleration its sensor reads, by the floors that follow it; 1: well, or not known.

    `table` (frequencies, 1) is its reading; `a` and `restoring`, -x'' (frequencies, floors), add up to what it should
    read, also where all accelerometers read in another unit.
    """
    own = float(np.sum(weight * np.abs(table) ** 2))
    for scale in (1.0, *signals.OTHER_UNITS["a"].values()):
        seen = a / scale + restoring
        factors = np.real(np.sum(weight * table.conj() * seen, axis=0)) / (own or 1.0)
        left = np.sum(weight * np.abs(seen - factors * table) ** 2, axis=0)
        size = np.sum(weight * np.abs(seen) ** 2, axis=0)
        factors = factors[(left < FITS * size) & (size >= MOTION**2 * len(seen))]
        if len(factors):
            break
    if not len(factors) or np.ptp(factors) > GAIN_ERROR * np.abs(factors).min():
        return 1.0
    gain = float(1 / np.median(factors))
    if abs(gain - 1) <= GAIN_ERROR:
        return 1.0
    others = "what the floors' displacements and accelerations tell"
    if gain < 0:
        faults.append(f"wrong sign: {name} against {others}")
    if unit := signals.read_as(name, gain):
        faults.append(f"unit: {name} reads as if in {unit}, {abs(gain):.3g} times {others}")
    elif abs(abs(gain) - 1) > GAIN_ERROR:
        faults.append(f"gain: {abs(gain):.3g} times {others}")
    return gain


def _compare_cells(
    forces: NDArray[np.complex128], noise: float, names: Sequence[str], faults: Sequence[list[str]]
) -> None:
    """Compare each load cell of a group (frequencies, cells) with the mean of the others; `noise`: power of a line."""
    cells, sums = forces.shape[1], forces.sum(axis=1)
    if cells == 1 or any("dead" in text for each in faults[:cells] for text in each):
        return
    for i in range(cells):
        own, others = forces[:, i], (sums - forces[:, i]) / (cells - 1)
        sizes = [float(np.vdot(one, one).real) for one in (own, others)]
        if max(sizes) < MOTION**2 * noise * len(own):
            continue
        cross = float(np.vdot(others, own).real)
        who = " and ".join(name for j, name in enumerate(names[:cells]) if j != i)
        if cross**2 < (1 - FITS) * sizes[0] * sizes[1]:
            faults[i].append(f"apart: does not follow {who} of the same brace group")
        elif cross < 0:
            faults[i].append(f"wrong sign: {names[i]} against {who}")
        elif abs(gain := cross / sizes[1] - 1) > GAIN_ERROR:
            faults[i].append(f"gain: {1 + gain:.3g} times that of {who}")


def _judge(
    measured: NDArray[np.complex128],
    predicted: NDArray[np.complex128],
    weight: NDArray[np.float64],
    names: Sequence[str],
    sources: Sequence[str],
    faults: list[list[str]],
) -> bool:
    """Fit each signal `measured` (frequencies, signals) by one `predicted`; returns whether there was motion enough."""

    def products(one: NDArray[np.complex128], other: NDArray[np.complex128]) -> NDArray[np.float64]:
        return np.real((weight * one).conj().T @ other)

    own, other = np.diag(products(measured, measured)), np.diag(products(predicted, predicted))
    cross = products(measured, predicted)
    # in a greater unit a signal has little power, and follows all the same
    alike = np.diag(cross) ** 2 > (1 - FITS) * own * other
    moves = (own >= MOTION**2 * len(measured)) | alike
    if other.min() < MOTION**2 * len(measured) or not moves.all() or any("dead" in t for each in faults for t in each):
        return False
    left = (own[:, None] + other[None, :] - 2 * np.abs(cross)) / own[:, None]
    rows, columns = linear_sum_assignment(left)
    for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
        if j != i and left[i, j] < FITS and left[i, i] > BETTER * left[i, j]:
            faults[i].append(f"swapped: agrees with {sources[j]}, expected {sources[i]}")
            j_or_i = j
        else:
            j_or_i = i
        gain = cross[i, j_or_i] / other[j_or_i]
        # in another unit a signal leaves more than its power, however well it follows
        follows = left[i, j_or_i] < 1 or cross[i, j_or_i] ** 2 > (1 - FITS) * own[i] * other[j_or_i]
        if gain < 0 and follows:
            faults[i].append(f"wrong sign: {names[i]} against {sources[j_or_i]}")
        pair = (names[i], gain), (sources[j_or_i], 1 / gain)
        units = [f"{name} reads as if in {unit}" for name, factor in pair if (unit := signals.read_as(name, factor))]
        if follows and units:
            faults[i].append(f"unit: {units[0]}, {abs(gain):.3g} times that of {sources[j_or_i]}")
        elif abs(abs(gain) - 1) > GAIN_ERROR and follows:
            faults[i].append(f"gain: {abs(gain):.3g} times that of {sources[j_or_i]}")
    return True

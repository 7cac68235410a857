# SPDX-License-Identifier: Apache-2.0
"""The sample period of stamps that a clock gave: one slope of all, and what is wrong with single stamps.

The stamps of evenly taken samples are a line over the samples' numbers, plus jitter. Clocks that are set and counters
that wrap move all later stamps, samples that are stamped late move a few. So the stamps are divided where their
distance from the line changes for good, and one slope is fitted to all parts, each with an offset of its own, by least
squares without the stamps that depart from their neighbours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

LEAST_FAULT = 0.5
"""Departure of a stamp from even ones that is a fault, in periods, where jitter does not hide it."""
JITTER = 6.0
"""Departure that jitter explains, in standard deviations of the jitter."""
_HALF_WINDOW = 7
"""Samples on either side, whose median is the level at a sample."""
_BLOCK = 100_000
"""Samples whose levels are computed at once."""
_PAIRS = 10_000
"""Pairs of stamps of one distance from which a slope is taken."""
_UNEVEN = 0.3
"""Share of stamps that depart, beyond which the stamps are not those of even samples."""
_COUNTERS = {
    bits**power * unit: f"a counter of 2^{power} {name}"
    for bits, power in ((2, 16), (2, 24), (2, 32))
    for unit, name in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns"))
} | {86400.0: "the time of the day"}
"""What may wrap, by its range [s]."""

Kind = Literal["step", "wrap", "late", "early", "repeated", "impossible", "drift", "uneven"]


@dataclass(frozen=True)
class StampFault:
    """What is wrong with one stamp or several of a kind.

    Parameters
    ----------
    kind
        step: from here on all stamps are moved; wrap: they are moved by a counter's range, which was added; drift: the
        rate changes; uneven: no rate is known.
    sample
        Index of the first stamp that is wrong.
    size
        Greatest departure from even stamps [s].
    text
        The fault in words, with the sample's number.
    count
        How many stamps are wrong in this way.
    """

    kind: Kind
    sample: int
    size: float
    text: str
    count: int = 1


@dataclass(frozen=True)
class SampleTimes:
    """What stamps say of the samples' times.

    Parameters
    ----------
    period
        Seconds between two samples; nan where stamps do not rise with the numbers.
    jitter, step_error
        Greatest departure of a stamp that is no fault from even ones, and of a step between two of them [s].
    hidden
        Departure up to which a stamp is no fault [s].
    span
        Seconds of the longest part without a step.
    faults
        In the order of their samples.
    """

    period: float
    jitter: float = 0.0
    step_error: float = 0.0
    hidden: float = 0.0
    span: float = 0.0
    faults: tuple[StampFault, ...] = ()

    @property
    def whole(self) -> float:
        """The period, or that of the whole number of samples a second that lies within the jitter."""
        rate = round(1 / self.period) if self.period > 0 else 0
        within = 2 * min(self.jitter, self.period) / self.span + 1e-9 if self.span else 0.0
        return 1 / rate if rate and abs(rate * self.period - 1) <= within else self.period


def sample_times(
    times: NDArray[np.float64], numbers: NDArray[np.int64] | None = None, resolution: float = 0.0
) -> SampleTimes:
    """Find the sample period of stamps, and their faults.

    Parameters
    ----------
    times
        (samples,) stamps [s], of any origin; may have values that are not finite.
    numbers
        (samples,) the samples' numbers: one that is left out is a sample that is missing, one that does not rise begins
        a new run. None: samples follow each other, and a step may be samples that are missing.
    resolution
        To which stamps are rounded [s].
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return _Stamps(times, numbers, resolution).fit()


class _Stamps:
    """Finite stamps `t` [s] at the places `k` on the line, `index` in those given."""

    def __init__(self, times: NDArray[np.float64], numbers: NDArray[np.int64] | None, resolution: float) -> None:
        self.given, self.numbers, self.resolution = times, numbers, resolution
        self.index = np.flatnonzero(np.isfinite(times))
        rise = np.ones(max(len(times) - 1, 0)) if numbers is None else np.diff(numbers).astype(np.float64)
        self.restarts = set((np.flatnonzero(rise <= 0) + 1).tolist())
        self.k = np.concatenate([[0.0], np.cumsum(np.where(rise > 0, rise, 1.0))])[self.index]
        self.t = times[self.index].astype(np.float64)
        self.faults: list[StampFault] = []

    def fit(self) -> SampleTimes:
        lost = np.setdiff1d(np.arange(len(self.given)), self.index)
        self._departing(lost, np.full(len(lost), np.inf))
        if len(self.t) < 2:
            return SampleTimes(math.nan, faults=tuple(self.faults))
        self._unwrap()
        usual = _usual_step(self.t, self.k)
        if not 0 < usual < math.inf:
            return SampleTimes(math.nan, faults=tuple(self.faults))
        off = self.t - usual * self.k
        off -= np.median(off)
        level, limit = off, LEAST_FAULT * usual
        if self.resolution and abs((usual / self.resolution + 0.5) % 1 - 0.5) > 1e-6:
            limit = max(limit, 1.1 * self.resolution)
        part = np.zeros(len(off), dtype=np.intp)
        if np.ptp(off) > limit:
            level = _levels(off)
            limit = max(limit, JITTER * 1.4826 * float(np.median(np.abs(off - level))))
            part = self._parts(off, level, limit, usual)
        used = part >= 0
        if used.mean() < 1 - _UNEVEN or used.sum() < 2:
            return self._uneven(off)
        numbers = np.unique(part[used])
        k, t = self.k.copy(), self.t.copy()
        for one in numbers:
            inside = part == one
            k[inside] -= k[inside].mean()
            t[inside] -= t[inside].mean()
        period = float(k[used] @ t[used] / (k[used] @ k[used]))
        left = t - period * k
        jitter = float(np.abs(left[used]).max())
        joined = used[1:] & (part[1:] == part[:-1])
        step_error = float(np.abs(np.diff(left))[joined].max(initial=0.0))
        span = max(float(np.ptp(self.k[part == one])) for one in numbers) * period
        # what is left of the levels is neither jitter nor a step: the clock's rate changes
        drift = np.where(used, left - (off - level), 0.0)
        if np.abs(drift).max() > max(period, limit):
            worst = int(np.argmax(np.abs(drift)))
            what = f"the clock's rate changes: the stamp of sample {self._number(worst)} is {_seconds(drift[worst])}"
            self._add("drift", worst, float(np.abs(drift[worst])), f"{what} from those of an even rate")
        faults = sorted(self.faults, key=lambda fault: fault.sample)
        period = period if 0 < period < math.inf else math.nan
        return SampleTimes(period, jitter, step_error, limit, span, tuple(faults))

    def _unwrap(self) -> None:
        """Add the range of a counter where it wraps."""
        steps, rise = np.diff(self.t), np.diff(self.k)
        if not (steps < 0).any():
            return
        usual = float(np.median(steps / rise)) or _usual_step(self.t, self.k)
        if not 0 < usual < math.inf:
            return
        room = max(LEAST_FAULT * usual, 1.4826 * float(np.median(np.abs(steps / rise - usual))))
        falls = np.flatnonzero(steps < 0)
        ranges = usual * rise[falls] - steps[falls]
        usual_range = float(np.median(ranges))
        same = np.abs(ranges - usual_range) <= room
        begins = self.t[falls + 1][same]
        low, high = np.quantile(self.t, [0.01, 0.99])
        of_own = same.sum() > 1 and same.mean() > LEAST_FAULT and np.ptp(begins) < 2 * usual + room
        known = dict(_COUNTERS)
        if of_own and all(abs(usual_range - each) > room for each in known):
            known[usual_range] = f"a counter of {usual_range:.6g} s"
        added = np.zeros(len(self.t))
        wraps: dict[float, list[int]] = {}
        for fall, size in zip(falls.tolist(), ranges.tolist(), strict=True):
            found = next((each for each in known if abs(size - each) <= room and usual < each / 2), None)
            if found is not None and high - low <= found + room:
                wraps.setdefault(found, []).append(fall)
                added[fall + 1] = found
        # a single stamp that is wrong by this range comes back
        for size, places in wraps.items():
            if len(places) == 1 and (steps[places[0] + 1 : places[0] + 2] > size / 2).any():
                added[places[0] + 1] = 0.0
                continue
            again = f" ({len(places)} times)" if len(places) > 1 else ""
            text = f"{self._fall(places[0])}: {known[size]} wraps{again}"
            self._add("wrap", places[0] + 1, size, text, len(places))
        self.t = self.t + np.cumsum(added)

    def _parts(
        self, off: NDArray[np.float64], level: NDArray[np.float64], limit: float, usual: float
    ) -> NDArray[np.intp]:
        """(samples,) the part without a step to which each stamp belongs, -1 for one that departs from it."""
        count = len(off)
        least = min(2 * _HALF_WINDOW + 1, max(3, count // 4))
        bounds = np.concatenate([[0], np.flatnonzero(np.abs(np.diff(level)) > limit) + 1, [count]])
        lengths = np.diff(bounds)
        parts = np.full(count, -1, dtype=np.intp)
        departure = off - level
        long = np.flatnonzero(lengths >= least)
        last_end, last_level, number = 0, math.nan, 0
        for one in long.tolist():
            begin, end = int(bounds[one]), int(bounds[one + 1])
            first_level = float(np.median(off[begin : begin + least]))
            size = first_level - last_level
            if abs(size) > limit:
                near = slice(max(last_end - 1 - _HALF_WINDOW, 0), begin + _HALF_WINDOW)
                place = near.start + int(np.argmax(np.sign(size) * np.diff(off[near]))) + 1
                self._step(place, size, usual)
                parts[begin:place] = number
                departure[place:begin] = off[place:begin] - first_level
                number, begin = number + 1, place
            departure[last_end:begin] = off[last_end:begin] - (first_level if math.isnan(last_level) else last_level)
            parts[begin:end] = number
            last_end, last_level = end, float(np.median(off[end - least : end]))
        departure[last_end:] = off[last_end:] - last_level
        wrong = (np.abs(departure) > limit) | (parts < 0)
        parts[wrong] = -1
        kept, span = np.flatnonzero(parts >= 0), usual * float(np.ptp(self.k))
        if self.numbers is None and len(kept):
            # at an end nothing tells a few stamps that depart from samples that are missing before or behind them
            for outer, place in ((slice(0, kept[0]), kept[0]), (slice(kept[-1] + 1, count), kept[-1] + 1)):
                if wrong[outer].any() and abs(departure[outer]).max() <= span:
                    self._step(int(place), float(self.t[place] - self.t[place - 1]) - usual, usual)
                    wrong[outer] = False
        if len(kept):
            self._departing(self.index[wrong], departure[wrong], span)
        return parts

    def _step(self, place: int, size: float, usual: float) -> None:
        before = self._number(place - 1)
        if self.index[place] in self.restarts:
            return
        if self.numbers is not None:
            text = f"the clock jumps {'ahead' if size > 0 else 'back'} by {abs(size):.4g} s after sample {before}"
        elif self.t[place] < self.t[place - 1]:
            text = f"{self._fall(place - 1)}: did a counter wrap, or was the clock set back?"
        else:
            step = self.t[place] - self.t[place - 1]
            text = f"time step {step:.6g} s, expected equal steps of {usual:.4g} s, after sample {before}"
            text += ": samples are missing, or the clock was set" if size > 0 else ""
        self._add("step", place, abs(size), text)

    def _departing(self, samples: NDArray[np.intp], departure: NDArray[np.float64], span: float = 0.0) -> None:
        """Name stamps that depart alone, of each kind the first."""
        kinds: dict[Kind, list[tuple[int, float]]] = {}
        for sample, by in zip(samples.tolist(), departure.tolist(), strict=True):
            kind: Kind = "late" if by > 0 else "early"
            if not abs(by) <= span:
                kind = "impossible"
            elif sample and self.given[sample] == self.given[sample - 1]:
                kind = "repeated"
            kinds.setdefault(kind, []).append((sample, by))
        for kind, found in kinds.items():
            sample, by = found[0]
            number = sample if self.numbers is None else int(self.numbers[sample])
            size = max(abs(each) for _, each in found)
            more = f", and those of {len(found) - 1} more" if len(found) > 1 else ""
            what = {"repeated": "is that of the sample before", "impossible": "is impossible"}.get(kind, "")
            what = what or f"is {abs(by):.4g} s {'too late' if by > 0 else 'too early'}"
            self.faults.append(StampFault(kind, sample, size, f"the stamp of sample {number} {what}{more}", len(found)))

    def _uneven(self, off: NDArray[np.float64]) -> SampleTimes:
        """Stamps of which no line can be told: their mean rate."""
        worst = int(np.argmax(np.abs(np.diff(off)))) + 1
        period = float((self.t[-1] - self.t[0]) / (self.k[-1] - self.k[0]))
        step = self.t[worst] - self.t[worst - 1]
        text = f"time step {step:.6g} s, expected equal steps of {period:.4g} s, after sample {self._number(worst - 1)}"
        self.faults = [fault for fault in self.faults if fault.kind in ("wrap", "impossible")]
        self._add("uneven", worst, float(np.abs(np.diff(off)).max()), text)
        return SampleTimes(period if 0 < period < math.inf else math.nan, faults=tuple(self.faults))

    def _fall(self, place: int) -> str:
        text = f"time falls after sample {self._number(place)}"
        if self.numbers is not None:
            return f"{text} by {self.t[place] - self.t[place + 1]:.6g} s"
        before, after = (self.given[self.index[at]] for at in (place, place + 1))
        return f"{text}, from {before:.6g} to {after:.6g} s"

    def _number(self, place: int) -> int:
        sample = int(self.index[place])
        return sample if self.numbers is None else int(self.numbers[sample])

    def _add(self, kind: Kind, place: int, size: float, text: str, count: int = 1) -> None:
        self.faults.append(StampFault(kind, int(self.index[place]), size, text, count))


def _seconds(departure: float) -> str:
    return f"{abs(departure):.4g} s {'late' if departure > 0 else 'early'}"


def _usual_step(t: NDArray[np.float64], k: NDArray[np.float64]) -> float:
    """The slope of most stamps: of the median slopes at several distances that which fits most distances best.

    Rounded stamps have no slope from one to the next, steps spoil those far apart.
    """
    rises, steps = [], []
    lag = 1
    while lag <= max(len(t) // 4, 1):
        every = max((len(t) - lag) // _PAIRS, 1)
        rises.append((k[lag:] - k[:-lag])[::every])
        steps.append((t[lag:] - t[:-lag])[::every])
        lag *= 2
    slopes = [float(np.median(step / rise)) for step, rise in zip(steps, rises, strict=True)]
    misfits = [
        float(np.median([np.median(np.abs(step - slope * rise)) for step, rise in zip(steps, rises, strict=True)]))
        for slope in slopes
    ]
    return slopes[int(np.argmin(misfits))]


def _levels(off: NDArray[np.float64]) -> NDArray[np.float64]:
    """(samples,) medians of the neighbours of each."""
    half = min(_HALF_WINDOW, max((len(off) - 1) // 4, 1))
    padded = np.pad(off, half, "edge")
    levels = np.empty_like(off)
    for begin in range(0, len(off), _BLOCK):
        block = padded[begin : begin + _BLOCK + 2 * half]
        found = np.median(np.lib.stride_tricks.sliding_window_view(block, 2 * half + 1), axis=1)
        levels[begin : begin + _BLOCK] = found
    return levels

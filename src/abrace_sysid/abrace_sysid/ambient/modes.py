# SPDX-License-Identifier: Apache-2.0
"""Modes of a structure from an ambient test: the poles that stay the same as the model order rises."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import Field
from scipy import signal

from abrace_core import AbraceError
from abrace_core.files.options import NOT_GIVEN, Band, Names
from abrace_core.model import signals
from abrace_core.model.modes import modal_assurance
from abrace_sysid.ambient.band import band_of, mode_spectrum
from abrace_sysid.ambient.subspace import OutputCovariances, SubspaceModes
from abrace_sysid.fitting.pole_estimate import PoleInterval
from abrace_sysid.recorded.test import TableOptions, given_tests, of_one_rig

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.recorded.test import Test

OVERSAMPLING = 2.56
"""Least sample rate after decimation, as a multiple of the band's upper end."""
WIDEST = 1500
"""Greatest number of rows of the Hankel matrix."""
LEAST_PIECES, MOST_PIECES = 8, 40
PERIODS = 30.0
"""Least length of a piece, in periods of the band's lower end."""
FREQUENCY, SHAPE = 0.02, 0.05
"""A pole is the same mode as one of a lower order if their frequencies differ by less than FREQUENCY (relative) and 1
minus their modal assurance criterion is below SHAPE."""
HEAVY_DAMPING = 0.2
"""Poles with at least this damping ratio are not taken as modes of a structure."""
UNCERTAIN = 0.02
"""Poles are discarded if their frequency's relative standard deviation reaches this, or their damping ratio's 1."""
LEAST_SHARE = 0.35
"""A mode must be found at this share of all orders at least."""


@dataclass(frozen=True)
class AmbientMode:
    """One mode of the structure.

    Parameters
    ----------
    frequency, damping
        [rad/s] and damping ratio.
    covariance
        (2, 2) covariance of frequency and damping ratio.
    shape
        (channels,) complex mode shape, its greatest entry 1.
    orders
        Number of orders at which the mode was found.
    """

    frequency: float
    damping: float
    covariance: NDArray[np.float64]
    shape: NDArray[np.complex128]
    orders: int

    @property
    def interval(self) -> PoleInterval:
        """Frequency and damping ratio with their standard deviations."""
        return PoleInterval(self.frequency, self.damping, *np.sqrt(np.diag(self.covariance)).tolist())


@dataclass(frozen=True)
class AmbientTest:
    """The result of an ambient test.

    Parameters
    ----------
    source
        Origin of the records.
    band
        In which modes were searched [Hz].
    modes
        Modes of the structure, lowest frequency first.
    candidates
        Poles of all orders, for the stabilisation diagram.
    pieces
        Number of pieces of the records from which the covariances are estimated; these have one degree of freedom
        less.
    seconds
        Total length of the records.
    spectrum
        (lines, 2) frequency [Hz] and first singular value of the spectral matrix of the scaled channels.
    """

    source: str
    channels: tuple[str, ...]
    band: tuple[float, float]
    modes: tuple[AmbientMode, ...]
    candidates: tuple[SubspaceModes, ...]
    pieces: int
    seconds: float
    spectrum: NDArray[np.float64]


class AmbientOptions(TableOptions):
    """Options of an identification from ambient tests."""

    who: ClassVar[str] = "ambient test"

    channels: Names = Field(
        default=(), description="outputs to use, as a1; none: all accelerations, of a table all columns"
    )
    band: Band = Field(
        default=NOT_GIVEN,
        description="Hz, lowest and highest frequency of modes; 0, 0: 0.3 to 20 times the slowest resonance, that of "
        "`before` where it is given",
    )
    highest_order: Annotated[int, Field(ge=4, le=200)] = Field(
        default=40, description="greatest number of poles that is tried"
    )

    def read(self, given: Any) -> tuple[Test, ...]:
        """The tests `given`: bags, Runs, Tests, and tables: files, arrays by name, DataFrames."""
        table = {"inputs": None, "outputs": self.channels, "sample_rate": self.sample_rate, "time": self.time}
        return given_tests(given, table)

    def require_possible(self, names: Sequence[str], sample_rate: float) -> None:
        """Check that tests with these channels `names`, sampled at `sample_rate` [Hz], can be used with these options.

        Raises
        ------
        AbraceError
            If not.
        """
        low, high = self.band
        if self.band != NOT_GIVEN and not 0 < low < high <= sample_rate / 2:
            raise AbraceError(
                f"ambient test: band {low:g} to {high:g} Hz, expected within 0 to {sample_rate / 2:g} Hz, the lower "
                "above 0"
            )
        chosen = signals.positions(self.channels, names, "ambient test: no channel")
        if len(set(chosen)) < len(self.channels):
            raise AbraceError(f"ambient test: channels {', '.join(self.channels)}, expected each channel once")


def ambient_test(tests: Sequence[Test], options: AmbientOptions) -> AmbientTest:
    """Modes from recorded tests without commands.

    Parameters
    ----------
    tests
        Tests of one rig.
    options
        Channels, band and highest order.

    Raises
    ------
    AbraceError
        If a command is not zero, the rigs differ, or as in `ambient_modes`.
    """
    first = tests[0]
    names = options.channels or tuple(name for name in first.names if name[0] == "a" or not first.floors)
    options.require_possible((*first.names, signals.GROUND), 1 / first.sample_period)
    for test in of_one_rig(tests):
        for command in test.moving:
            greatest = float(np.abs(test.channel(command)).max())
            raise AbraceError(
                f"{test.source}: {command} up to {greatest:g} N, expected 0: an ambient test is without commands"
            )
    source, records = ", ".join(dict.fromkeys(test.source for test in tests)), [test.channels(names) for test in tests]
    return ambient_modes(source, records, names, 1 / first.sample_period, options)


def ambient_modes(
    source: str,
    records: Sequence[NDArray[np.float64]],
    channels: Sequence[str],
    sample_rate: float,
    options: AmbientOptions | None = None,
) -> AmbientTest:
    """Modes of a structure from its responses to an excitation that was not measured.

    Parameters
    ----------
    source
        Origin of the records, for messages.
    records
        Each (samples, channels), any units.
    sample_rate
        [Hz].
    options
        Of these the band and the highest order are used; by default those of `AmbientOptions`.

    Raises
    ------
    AbraceError
        If the band is not within 0 to half the sample rate, a value is not finite, a channel never changes, the records
        are too short, or no band is given and no resonance found.
    """
    options = options or AmbientOptions()
    options.require_possible(channels, sample_rate)
    band, highest_order = options.band, options.highest_order
    for record in records:
        for name, column in zip(channels, record.T, strict=True):
            if not np.isfinite(column).all():
                raise AbraceError(f"{source}: channel {name} has values that are not finite")
            if not np.ptp(column):
                raise AbraceError(f"{source}: channel {name} never changes from {column[0]:g}")
    low, high = band = band_of(source, records, sample_rate) if band == NOT_GIVEN else band
    factor = max(1, math.floor(sample_rate / (OVERSAMPLING * high)))
    rate = sample_rate / factor
    prepared = [_prepared(record, sample_rate, factor, low) for record in records]
    size = np.sqrt(np.mean(np.concatenate(prepared) ** 2, axis=0))
    prepared = [record / size for record in prepared]
    lags = min(math.ceil(rate / (2 * low)), WIDEST // len(channels))
    lags = max(lags, math.ceil((highest_order + len(channels)) / len(channels)))
    length = sum(len(record) - 2 * lags for record in prepared)
    longest = max(PERIODS * rate / low, 4.0 * lags)
    pieces = min(max(int(length / longest), LEAST_PIECES), MOST_PIECES)
    try:
        covariances = OutputCovariances(prepared, lags, pieces)
    except AbraceError as error:
        raise AbraceError(
            f"{source}: {error} at {rate:g} Hz: use a longer record, or raise the lower end of the band"
        ) from error
    candidates = covariances.modes(range(2, highest_order + 1, 2), 1 / rate)
    modes = [replace_shape(mode, size) for mode in _tracked(candidates, band)]
    return AmbientTest(
        source,
        tuple(channels),
        band,
        tuple(modes),
        tuple(candidates),
        covariances.pieces,
        sum(len(record) for record in records) / sample_rate,
        mode_spectrum(prepared, rate, min(max(len(record) for record in prepared) // 8, 4096)),
    )


def replace_shape(mode: AmbientMode, size: NDArray[np.float64]) -> AmbientMode:
    """The `mode` with its shape in the channels' units; the channels were divided by their `size` for the fit."""
    shape = mode.shape * size
    return AmbientMode(
        mode.frequency, mode.damping, mode.covariance, shape / shape[np.argmax(np.abs(shape))], mode.orders
    )


def _prepared(record: NDArray[np.float64], sample_rate: float, factor: int, low: float) -> NDArray[np.float64]:
    """The record after high-pass filter, anti-alias filter and decimation by `factor`."""
    high_pass = signal.butter(2, low / 2, "highpass", fs=sample_rate, output="sos")
    still = signal.sosfiltfilt(high_pass, signal.detrend(record, axis=0, type="constant"), axis=0)
    if factor > 1:
        low_pass = signal.butter(8, 0.4 * sample_rate / factor, fs=sample_rate, output="sos")
        still = signal.sosfiltfilt(low_pass, still, axis=0)[::factor]
    return np.ascontiguousarray(still)


def _tracked(candidates: Sequence[SubspaceModes], band: tuple[float, float]) -> list[AmbientMode]:
    """The modes that recur as the order rises; of each the estimate with the smallest covariance."""
    tracks: list[list[tuple[int, AmbientMode]]] = []
    low, high = (2 * np.pi * end for end in band)
    for level, found in enumerate(candidates):
        relative = np.sqrt(found.covariance[:, 0, 0]) / found.frequency
        undamped = found.damping < np.sqrt(found.covariance[:, 1, 1])
        fit = (found.frequency >= low) & (found.frequency <= high)
        fit &= (found.damping > 0) & (found.damping < HEAVY_DAMPING) & (relative < UNCERTAIN) & ~undamped
        new = [
            AmbientMode(*values, orders=1)
            for values in zip(
                found.frequency[fit].tolist(),
                found.damping[fit].tolist(),
                found.covariance[fit],
                found.shapes[fit],
                strict=True,
            )
        ]
        for mode in new:
            near = [track for track in tracks if track[-1][0] < level and _same(track[-1][1], mode)]
            if near:
                min(near, key=lambda track: abs(track[-1][1].frequency - mode.frequency)).append((level, mode))
            else:
                tracks.append([(level, mode)])
    modes: list[AmbientMode] = []
    for track in sorted(tracks, key=len, reverse=True):
        best = min((mode for _, mode in track), key=lambda mode: float(np.linalg.det(mode.covariance)))
        # at high orders a mode may appear twice
        if len(track) >= LEAST_SHARE * len(candidates) and not any(_same(best, mode) for mode in modes):
            modes.append(AmbientMode(best.frequency, best.damping, best.covariance, best.shape, len(track)))
    return sorted(modes, key=lambda mode: mode.frequency)


def _same(one: AmbientMode, other: AmbientMode) -> bool:
    if abs(one.frequency / other.frequency - 1) > FREQUENCY:
        return False
    return bool(1 - modal_assurance(one.shape[None], other.shape[None])[0, 0] < SHAPE)

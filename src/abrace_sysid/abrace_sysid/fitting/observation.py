# SPDX-License-Identifier: Apache-2.0
"""The frequency lines of one test in the likelihood of its poles, from spectra or from transfer functions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import fft

from abrace_core import AbraceError
from abrace_sysid.fitting.pole_basis import Sampling, combined, sides_of
from abrace_sysid.spectra.fourier import lines_within

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.recorded.test import Test
    from abrace_sysid.spectra.frequency_response import FrequencyResponse

ENDS = (0, 1, 2, -1, -2, -3)
"""Samples at the ends of a record that can be left free."""


AFTER, FROM_LAST, ORDER = 64, 400, 16
"""Samples by which an input is continued, fading out, from so many last ones by linear prediction of an order."""


class Record(NamedTuple):
    """The inputs of a record with so many `samples`, as they were from the first one on, nothing before.

    Parameters
    ----------
    samples
    z
        (steps,) exp(i w T) of all steps of the transform of a longer record, in its order.
    excitation
        (steps, inputs) transform of the inputs, continued and then zero.
    """

    samples: int
    z: NDArray[np.complex128]
    excitation: NDArray[np.complex128]

    @classmethod
    def of(cls, inputs: NDArray[np.float64]) -> Record:
        """Of (samples, inputs)."""
        samples = len(inputs)
        steps = fft.next_fast_len(samples + 2 * AFTER)
        longer = np.zeros((steps, inputs.shape[1]))
        longer[:samples] = inputs
        for column in longer.T:
            _continue(column, samples)
        return cls(samples, np.exp(2j * np.pi * np.arange(steps) / steps), fft.fft(longer, axis=0))


def _continue(column: NDArray[np.float64], samples: int) -> None:
    """Continue the first samples of a column, fading out: without a jump, which a band-limited input cannot have."""
    last = column[max(0, samples - FROM_LAST) : samples]
    order = min(ORDER, len(last) // 4)
    before = np.lib.stride_tricks.sliding_window_view(last, order)
    factors = np.linalg.lstsq(before[:-1], last[order:], rcond=1e-8)[0] if order else np.zeros(0)
    most, fade = float(np.abs(last).max()), np.cos(np.linspace(0, np.pi / 2, AFTER)) ** 2
    for i in range(AFTER):
        column[samples + i] = np.clip(factors @ column[samples + i - order : samples + i], -most, most)
    column[samples : samples + AFTER] *= fade


def names_of(observations: Sequence[Observation]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """All inputs and all outputs of `observations`, in the order of their first appearance."""
    inputs, outputs = (
        tuple(dict.fromkeys(name for one in observations for name in getattr(one, kind)))
        for kind in ("inputs", "outputs")
    )
    return inputs, outputs


@dataclass(frozen=True)
class Observation:
    """One test in the likelihood; made by `of_test` or `of_response`.

    Parameters
    ----------
    source
        Name of the test, for messages.
    outputs
        Names of the channels.
    omega
        (lines,) [rad/s], rising.
    excitation
        (lines, inputs) transforms of the inputs, or ones if `measured` are transfer functions.
    measured
        (lines, channels) transforms of the outputs, or transfer functions.
    noise_level
        (lines,) standard deviation of the noise, relative from line to line.
    samplings
        How each input moves between samples.
    transient
        Whether the leakage of a finite record is in `measured`.
    poles
        The poles that are excited in this test, as indices into those of all tests; None: all poles.
    free_ends
        Whether the first and last samples (`ENDS`) are left free: the transform of a finite record continues a
        band-limited input periodically, which is wrong there.
    from_rest
        Whether the structure is at rest when the record begins: then its state at the end, and the leakage, are known
        from `record`.
    record
        The inputs from the first sample on; None: not known to begin from rest.
    weight
        Weight of the test among others: less than 1 if its channels' noise is correlated, because correlated channels
        contain less information than independent ones.
    """

    source: str
    outputs: tuple[str, ...]
    omega: NDArray[np.float64]
    excitation: NDArray[np.complex128]
    measured: NDArray[np.complex128]
    noise_level: NDArray[np.float64]
    inputs: tuple[str, ...]
    samplings: tuple[Sampling, ...]
    transient: bool
    poles: tuple[int, ...] | None = None
    free_ends: bool = False
    from_rest: bool = False
    record: Record | None = None
    weight: float = 1.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.measured).all() and np.isfinite(self.excitation).all()):
            raise AbraceError(f"{self.source}: a frequency line has a value that is not finite")
        dead = [name for name, column in zip(self.outputs, self.measured.T, strict=True) if not np.any(column)]
        if dead:
            raise AbraceError(f"{self.source}: channel {', '.join(dead)} is zero throughout, expected a response")

    @cached_property
    def z(self) -> NDArray[np.complex128]:
        """(lines,) exp(i w T)."""
        return np.exp(1j * self.omega * self.samplings[0].sample_period)

    @property
    def seconds(self) -> float:
        """Length of the record, from the distance of its lines."""
        return 2 * np.pi / float(np.median(np.diff(self.omega)))

    @property
    def is_record(self) -> bool:
        """Whether the lines are those of a finite record, not transfer functions."""
        return self.transient or self.from_rest

    def shown(self, poles: NDArray[np.complex128]) -> tuple[int, ...]:
        """The indices into `poles` of those that are excited in this test."""
        return tuple(range(len(poles))) if self.poles is None else self.poles

    def in_units(self, unit: Mapping[str, float]) -> Observation:
        """The same test with its inputs in other units; `unit` is the size of each by name."""
        sizes = np.array([unit[name] for name in self.inputs])
        record = self.record and self.record._replace(excitation=self.record.excitation / sizes)
        return replace(self, excitation=self.excitation / sizes, record=record)

    def state(
        self, pole: complex, number: int, delay: float = 0.0
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """(lines,) state of a pole under one input, without a free decay, and its derivative by the pole.

        The state is that of the periodic continuation of the record, or, from rest, the one that the input alone makes.

        Parameters
        ----------
        pole
            [rad/s].
        number
            Of the input.
        delay
            Of a held input [s].
        """
        sampling = self.samplings[number]
        if not self.from_rest or self.record is None:
            response, slope = sampling.response(pole, self.z, delay)
            return self.excitation[:, number] * response, self.excitation[:, number] * slope
        samples, z, drive = self.record.samples, self.record.z, self.record.excitation[:, number]
        state, its_slope = (fft.ifft(drive * part) for part in sampling.response(pole, z, delay))
        time = np.arange(samples) * sampling.sample_period
        decay = np.exp(pole * time)
        from_rest = state[:samples] - decay * state[0]
        slope = its_slope[:samples] - decay * (its_slope[0] + time * state[0])
        lines = np.rint(self.omega * samples * sampling.sample_period / (2 * np.pi)).astype(np.int64)
        found, found_slope = (fft.fft(series)[lines] / np.sqrt(samples) for series in (from_rest, slope))
        return found, found_slope

    def states(
        self, poles: NDArray[np.complex128], delays: NDArray[np.float64] | None = None
    ) -> list[NDArray[np.complex128]]:
        """The states of poles under each input alone, as columns (lines,) with real coefficients: two of a pair.

        Parameters
        ----------
        poles
            [rad/s], of each pair the one above the real axis, and real ones.
        delays
            (inputs,) [s]; None: none.
        """
        columns, later = [], np.zeros(len(self.inputs)) if delays is None else delays
        for pole in poles:
            for number, delay in enumerate(later):
                sides = [self.state(side, number, delay)[0][:, None] for side in sides_of(pole)]
                columns += combined(sides, np.ones(1))
        return columns

    def thinned(self, lines: int) -> Observation:
        """The same test at every second, third ... line, so that about `lines` are left; the model is the same."""
        chosen = slice(None, None, max(1, len(self.omega) // lines))
        of_lines = {name: getattr(self, name)[chosen] for name in ("omega", "excitation", "measured", "noise_level")}
        return replace(self, **of_lines)

    def with_noise(self, level: NDArray[np.float64]) -> Observation:
        """The same test with another noise `level` (lines,)."""
        return replace(self, noise_level=level)

    @classmethod
    def of_test(
        cls, test: Test, inputs: Sequence[str], band: tuple[float, float], outputs: Sequence[str] | None = None
    ) -> Observation:
        """The observation of a whole test with noise, leakage included.

        Parameters
        ----------
        test, inputs
            The test, and all inputs that were excited.
        band
            Lowest and highest frequency [Hz]; the inputs must be excited throughout.
        outputs
            None: all of the test.

        Raises
        ------
        AbraceError
            If a name is unknown or the band has no line.
        """
        lines, omega = lines_within(test, len(test.outputs), band)
        names = tuple(test.names if outputs is None else outputs)
        excitation, measured = test.spectra(inputs)[lines], test.spectra(names)[lines]
        samplings = tuple(Sampling(test.sample_period, test.hold_of(name)) for name in inputs)
        return cls(test.source, names, omega, excitation, measured, np.ones(len(lines)), tuple(inputs), samplings, True)

    @classmethod
    def of_response(cls, measured: FrequencyResponse, source: str) -> Observation:
        """The observation of a test from a measured transfer function, of a periodic test or averaged.

        The lines should be independent. Neighbouring lines of the local polynomial method are not: the poles are still
        right, but their intervals are too narrow.

        Parameters
        ----------
        measured
            The transfer function, hold and delay included; its standard deviation gives the lines' relative noise.
        source
            Name of the test, for messages.
        """
        relative = measured.sigma / np.maximum(np.median(measured.sigma, axis=0), np.finfo(float).tiny)
        level = np.sqrt(np.mean(relative**2, axis=1))
        known = level > 0
        level = np.where(known, level, level[known].min()) if known.any() else np.ones(len(level))
        sampling = Sampling(measured.sample_period, measured.held)
        ones = np.ones((len(level), 1), dtype=np.complex128)
        return cls(
            source,
            measured.outputs,
            measured.omega,
            ones,
            measured.response,
            level,
            (measured.input,),
            (sampling,),
            False,
        )

# SPDX-License-Identifier: Apache-2.0
"""The spectrum of an ambient test, and the band in which modes are searched if none is given.

The band is that of the building, not of the record: from LOWEST to HIGHEST times its slowest resonance, at most to what
the sample rate shows. The slowest resonance is the first peak that rises out of the spectrum's scatter: sensor noise
and drift have none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

LOWEST, HIGHEST = 0.3, 20.0
"""Ends of the band, divided by the slowest resonance. The first three modes of a cantilever are at 1, 6.3, 17.5."""

HIGHEST_OF_RATE = 0.4
"""Greatest frequency of the band, divided by the sample rate: filters of the sensors act above."""

SEGMENTS = 16
"""Segments into which the longest record is cut, half overlapping."""

STANDS_OUT = 10.0
"""Least height of a peak above the valleys on both sides of it [dB]; the spectrum of noise scatters by 0.9 dB rms."""


def mode_spectrum(records: Sequence[NDArray[np.float64]], rate: float, segment: int) -> NDArray[np.float64]:
    """(lines, 2) frequency and first singular value of the spectral matrix of the longest record, by Welch's method.

    Parameters
    ----------
    records
        Each (samples, channels), the channels of similar size.
    rate
        Sample rate [Hz].
    segment
        Samples in a segment.
    """
    record = max(records, key=len)
    frequency, _, parts = signal.stft(record.T, rate, nperseg=segment, boundary=None)
    matrices = np.einsum("aft,bft->fab", parts, parts.conj()) / parts.shape[-1]
    return np.column_stack([frequency, np.linalg.svd(matrices, compute_uv=False)[:, 0]])


def band_of(source: str, records: Sequence[NDArray[np.float64]], rate: float) -> tuple[float, float]:
    """The band of a building [Hz], from its responses to an excitation that was not measured.

    Parameters
    ----------
    source
        Origin of the records, for messages.
    records
        Each (samples, channels), any units, finite and not constant.
    rate
        Sample rate [Hz].

    Raises
    ------
    AbraceError
        If no peak stands out of the spectrum.
    """
    size = np.std(np.concatenate(records), axis=0)
    segment = max(len(record) for record in records) // SEGMENTS
    frequency, value = mode_spectrum([record / size for record in records], rate, segment)[1:].T
    peaks, _ = signal.find_peaks(10 * np.log10(value), prominence=STANDS_OUT)
    peaks = peaks[frequency[peaks] < HIGHEST_OF_RATE * rate]
    if not len(peaks):
        raise AbraceError(
            f"{source}: no resonance stands out of the spectrum by {STANDS_OUT:g} dB: give the band, or use a longer "
            "record or more sensitive sensors"
        )
    slowest = float(frequency[peaks[0]])
    return LOWEST * slowest, min(HIGHEST * slowest, HIGHEST_OF_RATE * rate)

# SPDX-License-Identifier: Apache-2.0
"""The resampling of records, and their measures and response spectra against eqsig's."""

from __future__ import annotations

from typing import Any

import eqsig
import numpy as np
from claims import Claim

from abrace_plant.records.files import read_record
from abrace_plant.records.measures import STANDARD_GRAVITY, intensity, response_spectrum
from abrace_plant.records.record import Record
from abrace_plant.records.treatment import prepare


def resampling_error() -> float:
    """Worst departure of a resampled sinusoid from itself, of its amplitude, up to 30 Hz and 0.8 of half the rate."""
    worst_error = 0.0
    for rate in (100 / 3, 50.0, 100.0, 200.0, 256.0):
        for frequency in np.linspace(0.5, min(30.0, 0.4 * rate), 12):
            samples = round(20 * rate)
            record = Record("sine", 1 / rate, np.sin(2 * np.pi * frequency * np.arange(samples) / rate))
            motion = prepare(record, 500.0)
            exact = np.sin(2 * np.pi * frequency * np.arange(len(motion)) / 500.0)
            # half a second at each end, where the sinusoid begins and ends, is no matter of the pass band
            inside = slice(1500, len(motion) - 1500)
            worst_error = max(worst_error, float(np.abs(motion - exact)[inside].max()))
    return worst_error


def verify_records() -> tuple[dict[str, Any], list[Claim]]:
    """Resampling, and the measures and spectra of El Centro against those of eqsig."""
    record = read_record("el_centro")
    peer = eqsig.AccSignal(record.acceleration, record.sample_period)
    periods = np.geomspace(40 * record.sample_period, 5.0, 60)
    peer.generate_response_spectrum(response_times=periods, xi=0.05)
    spectrum = response_spectrum(record, periods, (0.05,))
    ours = intensity(record)
    arias = float(eqsig.im.calc_arias_intensity(peer)[-1]) * 9.81 / STANDARD_GRAVITY
    values = {
        "resampling_error": resampling_error(),
        "spectrum_difference": float(np.abs(spectrum.displacement[0] / peer.s_d - 1).max()),
        "arias_difference": abs(ours.arias_intensity / arias - 1),
    }
    claims = [
        Claim("resampling to 500 Hz, sinusoids below 30 Hz", values["resampling_error"], 1e-5, "the sinusoids"),
        Claim("response spectrum, El Centro, 5 %", values["spectrum_difference"], 1e-6, "eqsig"),
        Claim("Arias intensity, El Centro", values["arias_difference"], 1e-9, "eqsig"),
    ]
    return values, claims

"""Accuracy claims, measured: `make verify`. Writes results/verify.json, prints a table, ends with 1 if one is missed.

rig       the paper's rig against the numbers that the paper prints, and its limited motion against finer substeps
records   the resampling of records, and their response spectra against eqsig
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import eqsig
import numpy as np

from abrace_bringup.table import Table
from abrace_core.files import write_text
from abrace_core.node import find_file
from abrace_plant import published
from abrace_plant.characteristics import characterize
from abrace_plant.ground_motion import prepare
from abrace_plant.intensity import STANDARD_GRAVITY, intensity
from abrace_plant.record_files import Record, read_record
from abrace_plant.response_spectrum import response_spectrum
from abrace_plant.rig_file import load_rig
from abrace_plant.rig_motion import RigMotion

if TYPE_CHECKING:
    from abrace_plant.rig import Rig

RESULTS = Path("results/verify.json")


@dataclass(frozen=True)
class Claim:
    """A number that is asked for: `reached` has to be at most `asked` (or at least, where `least`)."""

    name: str
    reached: float
    asked: float
    peer: str
    least: bool = False

    @property
    def holds(self) -> bool:
        """Whether what was asked for is reached."""
        return self.reached >= self.asked if self.least else self.reached <= self.asked


def worst(found: Any, asked: Any, column: int) -> float:
    """Greatest relative error among pairs of (frequency, damping ratio)."""
    ours, theirs = np.array(found)[:, column], np.array(asked)[:, column]
    return float(np.abs(ours / theirs - 1).max())


def limited_motion(rig: Rig) -> tuple[float, float]:
    """Error at the rig's own substeps, of the peak, and order of convergence, for an actuator at its capacity."""
    group = rig.braces[0]
    weak = replace(rig, braces=(replace(group, actuator=replace(group.actuator, capacity=8000.0)),))
    time = np.arange(1500) / rig.sample_rate
    ground = 3.0 * np.sin(7.3 * time) + np.sin(23.0 * time)

    def motion(refinement: int) -> np.ndarray:
        stepped = RigMotion(weak, refinement)
        return np.array([stepped.outputs(acceleration, np.zeros(1)) for acceleration in ground])

    exact = motion(512)
    refinements = [1, 2, 4, 8, 16]
    peak = np.abs(exact).max(axis=0)
    errors = [float(np.sqrt(np.mean(((motion(r) - exact) / peak) ** 2))) for r in refinements]
    return errors[0], float(-np.polyfit(np.log(refinements), np.log(errors), 1)[0])


def verify_rig() -> tuple[dict[str, Any], list[Claim]]:
    """The paper's rig, measured as the paper measured its building."""
    rig = load_rig(find_file(published.RIG, "abrace_plant", "config", ".yaml", "rig"))
    found = characterize(rig)
    (brace,) = found.braces
    error, order = limited_motion(rig)
    antiresonances = found.antiresonance_error()
    shape = np.abs(np.array(found.shape[:2]) - published.SHAPE[:2])
    values = {
        "bare": found.bare,
        "zero_command": found.zero_command,
        "extra": found.extra,
        "bench_gain_error": brace.bench_gain_error,
        "bench_lag_ms": 1e3 * brace.bench_lag,
        "antiresonance_error": antiresonances,
        "shape": found.shape[:2],
        "stroke_ratio": brace.stroke_ratio,
        "limited_motion_error": error,
        "limited_motion_order": order,
    }
    claims = [
        Claim("bare frame: frequencies, worst of 3", worst(found.bare, published.BARE, 0), 0.001, "paper"),
        Claim("bare frame: damping, worst of 3", worst(found.bare, published.BARE, 1), 0.10, "paper"),
        Claim(
            "zero command: frequencies, worst of 3",
            worst(found.zero_command, published.ZERO_COMMAND, 0),
            0.001,
            "paper",
        ),
        Claim("zero command: damping, worst of 3", worst(found.zero_command, published.ZERO_COMMAND, 1), 0.05, "paper"),
        Claim("further pairs of A2: frequencies", worst(found.extra, published.EXTRA, 0), 0.001, "paper, A2"),
        Claim("further pairs of A2: damping", worst(found.extra, published.EXTRA, 1), 0.001, "paper, A2"),
        Claim("bench: gain from 1, 0 to 30 Hz", brace.bench_gain_error, 0.01, "paper, Fig. 2"),
        Claim("bench: lag from 0.8 ms", abs(brace.bench_lag / published.BENCH_LAG - 1), 0.01, "paper, Fig. 2"),
        Claim("f/U: antiresonances, worst of 3", max(antiresonances), 0.01, "paper, Fig. 3"),
        Claim("first mode: shape, greatest difference", float(shape.max()), 0.05, "paper, Table 1"),
        Claim("first mode: xf/x1", abs(brace.stroke_ratio / published.STROKE_RATIO - 1), 0.01, "paper, Table 1"),
        Claim("limited motion: error at the rig's substeps", error, 1e-4, "512 times finer"),
        Claim("limited motion: order of convergence", order, 1.7, "theory: 2", least=True),
    ]
    return values, claims


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
    """Resampling, and the measures and spectra of El Centro beside those of eqsig."""
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


def main() -> int:
    """Measure, write, print."""
    rig, claims = verify_rig()
    records, more = verify_records()
    claims += more
    write_text(RESULTS, json.dumps({"rig": rig, "records": records}, indent=1) + "\n")
    rows = tuple(
        (
            claim.name,
            f"{claim.reached:.3g}",
            f"{'>=' if claim.least else '<='} {claim.asked:g}",
            claim.peer,
            "" if claim.holds else "MISSED",
        )
        for claim in claims
    )
    print(Table("Accuracy (relative errors, unless said)", ("claim", "reached", "asked", "peer", ""), rows).text())
    print(f"wrote {RESULTS}")
    return 0 if all(claim.holds for claim in claims) else 1


if __name__ == "__main__":
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""A fragility study carried out: its loops computed or found computed, its curves fitted, its files written."""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import AbraceError
from abrace_core.figures.saving import save_figure
from abrace_core.files.writing import write_json, write_rows
from abrace_core.model import signals
from abrace_core.model.tabular import Tabular
from abrace_studies.batches.compute import compute_missing
from abrace_studies.batches.parts import read_parts
from abrace_studies.fragility.curves import fragility_curve
from abrace_studies.fragility.figures import Subject, fragility_figure
from abrace_studies.fragility.loops import compute_batch
from abrace_studies.fragility.study import INTACT

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import pandas
    import pyarrow
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from abrace_studies.fragility.curves import FragilityCurve
    from abrace_studies.fragility.study import FragilityStudy

LOOPS = "loops"
"""Folder of the results of all loops."""
FILE_FORMAT = "abrace fragility 1"


@dataclass(frozen=True)
class Fragility(Tabular):
    """What a fragility study found.

    Parameters
    ----------
    folder
        Folder of its files; `loops` in it has a row for each loop.
    limits
        Limits by quantity [SI unit].
    intensities
        [m/s^2].
    subjects
        A controller with a fault each: its curve for each limit, and what it took.
    disturbance
        Name of the input whose peak is the intensity.
    units
        SI units of the disturbance and the limits that are no rig's, by name; of drifts m.
    """

    folder: Path
    limits: dict[str, float]
    intensities: tuple[float, ...]
    subjects: tuple[Subject, ...]
    disturbance: str = signals.GROUND
    units: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        loops = sum(int(next(iter(subject.curves.values())).loops.sum()) for subject in self.subjects)
        return f"<Fragility: {loops} loops, {', '.join(self.limits)}, in {self.folder}>"

    def to_pandas(self) -> pandas.DataFrame:
        """The fitted curves: a row for each controller, fault and limit."""
        import pandas

        return pandas.DataFrame(_rows(self)).rename_axis("curve")

    def loops(self) -> pandas.DataFrame:
        """Every loop: peak and rms of each quantity, saturation."""
        return read_parts(self.folder / LOOPS).to_pandas()

    def plot(self) -> Figure:
        """The curves of the intact controllers with their bands, and the fractions."""
        limits = {f"{name} above {limit:g} {self.unit(name)}": name for name, limit in self.limits.items()}
        peak = "peak ground acceleration" if self.disturbance == signals.GROUND else f"peak of {self.disturbance}"
        return fragility_figure(self.subjects, limits, peak, self.unit(self.disturbance))

    def unit(self, name: str) -> str:
        """SI unit of a limit's quantity or the disturbance `name`; "-": it is not known."""
        return self.units.get(name) or signals.unit(name)

    def text(self) -> str:
        """The curves in words, one a line."""
        lines, of_peak = [], self.unit(self.disturbance)
        for row in _rows(self):
            name = row["controller"] + (f", {row['fault']}" if row["fault"] != INTACT else "")
            limit = f"{row['quantity']} above {row['limit']:g} {self.unit(row['quantity'])}"
            if np.isfinite(row["median"]):
                end = "or more" if np.isinf(row["high"]) else f"to {row['high']:.3g}"
                interval = f"{row['low']:.3g} {end}" if np.isfinite(row["low"]) else "one ground motion: no interval"
                found = f"median {row['median']:.3g} {of_peak} ({interval}), dispersion {row['dispersion']:.2f}"
            elif 0 < row["exceeded"] < row["loops"]:
                low, high = row["low"], row["high"]
                found = f"between {low:g} and {high:g}" if np.isfinite(high) else f"above {low:g}"
                found = f"median {found} {of_peak}, dispersion not known: intensities closer together would tell"
            else:
                found = f"{row['exceeded'] / row['loops']:.0%} of {row['loops']} loops, no curve"
            lines.append(f"{name}: {limit}: {found}")
        return "\n".join(lines)


def run_study(
    study: FragilityStudy,
    limits: Mapping[str, float],
    folder: Path | str,
    *,
    scheduler: str = "",
    workers: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Fragility:
    """Compute the loops that are not in the folder yet, fit the curves, write all files.

    Parameters
    ----------
    study
        What is varied.
    limits
        Limits of the quantities that are judged, by name [SI unit].
    folder
        Folder of the results. Batches that are there already are kept, if they are of the same study.
    scheduler, workers
        As for `compute_missing`.
    progress
        Called with the numbers of finished batches and of all.

    Raises
    ------
    AbraceError
        If a limit is of no quantity, or the folder has results of another study.
    """
    plant = study.plant(0)
    known = (*plant.outputs, *plant.inputs[1:])
    numbers = {name: value for name, value in limits.items() if isinstance(value, Real) and 0 < value < np.inf}
    if not limits or not set(numbers) <= set(known) or len(numbers) < len(limits):
        shown = (
            f"{name}={value:g}" if isinstance(value, Real) else f"{name}={value!r}" for name, value in limits.items()
        )
        raise AbraceError(
            f"limits {', '.join(shown) or 'none'}: expected a value above 0 for some of {', '.join(known)}"
        )
    folder = Path(folder)
    compute_missing(
        compute_batch,
        study,
        study.batches(),
        folder / LOOPS,
        scheduler=scheduler,
        workers=workers,
        progress=progress,
    )
    found = assess(study, limits, folder)
    save(found)
    return found


def assess(study: FragilityStudy, limits: Mapping[str, float], folder: Path) -> Fragility:
    """Fit the curves to the loops of a `study` in a folder, for each of the `limits`; arguments as for `run_study`."""
    commands = study.models[0].inputs[1:]
    wanted = [f"peak_{name}" for name in dict.fromkeys([*limits, *commands])]
    rms = [f"rms_{name}" for name in commands]
    kept = ["controller", "fault", "motion", "intensity", "saturated", *wanted, *rms]
    table = read_parts(folder / LOOPS, kept)
    columns = {name: _numbers(table[name]) for name in kept}
    levels = np.searchsorted(study.intensities, columns["intensity"])
    controllers, faults = (_names(table[name]) for name in ("controller", "fault"))
    subjects = []
    pairs = np.unique(np.stack([columns["controller"], columns["fault"]]), axis=1).T
    for controller, fault in pairs:
        own = (columns["controller"] == controller) & (columns["fault"] == fault)
        place = columns["motion"][own] * len(study.intensities) + levels[own]
        shape = (len(study.motion_names), len(study.intensities))
        loops = np.bincount(place, minlength=shape[0] * shape[1]).reshape(shape)
        curves = {}
        for name, limit in limits.items():
            beyond = place[~(columns[f"peak_{name}"][own] <= limit)]
            exceeded = np.bincount(beyond, minlength=loops.size).reshape(shape)
            curves[name] = fragility_curve(np.array(study.intensities), loops, exceeded)
        force = np.sqrt(np.mean([columns[name][own] ** 2 for name in rms], axis=0)) if rms else np.zeros(own.sum())
        subjects.append(
            Subject(
                controllers[controller],
                faults[fault],
                curves,
                _mean_by_level(force, levels[own], shape[1]),
                _mean_by_level(columns["saturated"][own] > 0, levels[own], shape[1]),
            )
        )
    plant = study.plant(0)
    units = {name: plant.unit(name) for name in (*limits, plant.inputs[0])}
    return Fragility(folder, dict(limits), study.intensities, tuple(subjects), plant.inputs[0], units)


def save(found: Fragility) -> None:
    """Write `fragility.json`, `fragility.csv` and the figure of what was `found`."""
    rows = _rows(found)
    content = {
        "format": FILE_FORMAT,
        "limits": found.limits,
        "intensities": found.intensities,
        "curves": [
            row | {"fractions": subject.curves[row["quantity"]].fractions.tolist()}
            for row, subject in zip(rows, (s for s in found.subjects for _ in found.limits), strict=True)
        ],
        "commands": [
            {
                "controller": subject.controller,
                "fault": subject.fault,
                "rms": subject.force.tolist(),
                "saturated": subject.saturated.tolist(),
            }
            for subject in found.subjects
        ],
    }
    write_rows(found.folder / "fragility.csv", rows)
    write_json(found.folder / "fragility.json", content)
    save_figure(found.plot(), found.folder / "fragility.svg")


def _rows(found: Fragility) -> list[dict[str, Any]]:
    return [
        _row(subject, name, found.limits[name], curve)
        for subject in found.subjects
        for name, curve in subject.curves.items()
    ]


def _row(subject: Subject, quantity: str, limit: float, curve: FragilityCurve) -> dict[str, Any]:
    low, high = curve.median_interval()
    return {
        "controller": subject.controller,
        "fault": subject.fault,
        "quantity": quantity,
        "limit": limit,
        "median": curve.median,
        "low": low,
        "high": high,
        "dispersion": curve.dispersion,
        "loops": int(curve.loops.sum()),
        "exceeded": int(curve.exceeded.sum()),
    }


def _numbers(column: pyarrow.ChunkedArray) -> NDArray[Any]:
    """A column as numbers; of texts their places among the names."""
    whole = column.combine_chunks()
    return np.asarray(whole.indices if hasattr(whole, "indices") else whole)


def _names(column: pyarrow.ChunkedArray) -> list[str]:
    return list(column.combine_chunks().dictionary.to_pylist())


def _mean_by_level(values: NDArray, levels: NDArray[np.intp], count: int) -> NDArray[np.float64]:
    """(count,) means of `values` by their `levels`."""
    return np.asarray(np.bincount(levels, values, count) / np.maximum(np.bincount(levels, minlength=count), 1))

"""Tests to models, and models against tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace.interactive.given import controller_of, model_of, runs_of, warn
from abrace_core.errors import AbraceError
from abrace_core.tables import data_frame
from abrace_sysid import data_identification, identification, validation
from abrace_sysid.data_identification import DataOptions
from abrace_sysid.figures import identification as figures
from abrace_sysid.figures.data import figures_of_data
from abrace_sysid.figures.validation import time_histories
from abrace_sysid.figures.validity import validity_figure
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.identification_results import write_identification
from abrace_sysid.measured_data import MeasuredData, read_data
from abrace_sysid.validity.judgement import judge
from abrace_sysid.validity.prediction import predicted
from abrace_sysid.validity_results import write_validity

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from abrace.interactive.given import AnyController, AnyModel, AnyRun
    from abrace_core.linear_model import LinearModel
    from abrace_sysid.data_identification import DataIdentification
    from abrace_sysid.fitting.pole_estimate import PoleInterval
    from abrace_sysid.identification import Identification
    from abrace_sysid.measured_data import DataHold
    from abrace_sysid.validation import Comparison
    from abrace_sysid.validity.finding import Finding, Validity
    from abrace_sysid.validity.judgement import Judgement

DEFAULTS = IdentificationOptions()


@dataclass(frozen=True)
class Identified:
    """The models of a rig, and whether they can be trusted.

    Parameters
    ----------
    found
        The whole identification: transfer functions, poles, reduction.
    judged
        What was found of sensors, rig and model.
    """

    found: Identification
    judged: Judgement

    def __repr__(self) -> str:
        tests = ", ".join(
            dict.fromkeys(run.source for data in (self.found.table, *self.found.commands) for run in data.runs)
        )
        states = f"{self.model.order} states, reduced to {self.reduced.order}"
        return f"<Identified: {states}, from {tests}: {self.validity.verdict.words}>"

    @property
    def model(self) -> LinearModel:
        """The model for prediction."""
        return self.found.model

    @property
    def reduced(self) -> LinearModel:
        """The model for design."""
        return self.found.reduced

    @property
    def superposed(self) -> LinearModel:
        """The paper's model."""
        return self.found.superposed

    @property
    def validity(self) -> Validity:
        """All findings; `print(validity.text())` has them in words."""
        return self.judged.validity

    def to_pandas(self) -> pandas.DataFrame:
        """The pole pairs of both tests, slowest first, with 95 % confidence intervals."""
        return _pairs(self.found.poles.common_pairs)

    def plot(self, what: str = "transfer_functions") -> Figure:
        """A figure.

        Parameters
        ----------
        what
            "transfer_functions": measured and of the model, from the table, to the top floor and the first
            acceleration; "commands": the same from the first command; "residuals"; "confidence"; "validity";
            "reduction".

        Raises
        ------
        AbraceError
            If it is none of these.
        """
        found = self.found
        measured = [found.table_response, *(data.responses[0] for data in found.commands)]
        floors = [name for name in found.model.outputs if name[0] == "x" and name[1:].isdigit()]
        shown = floors[-1:] + [name for name in found.model.outputs if name[0] == "a"][:1] or found.model.outputs[:1]
        pairs = {
            "table": found.poles.table_pairs,
            "command": found.poles.command_pairs,
            "both": found.poles.common_pairs,
        }
        drawn = {
            "transfer_functions": lambda: figures.transfer_functions(measured[0], shown, found.model),
            "commands": lambda: figures.transfer_functions(measured[1], shown, found.model),
            "residuals": lambda: figures.residuals(measured, found.model),
            "confidence": lambda: figures.confidence(pairs),
            "validity": lambda: validity_figure(self.validity, self.judged.residuals),
            "reduction": lambda: figures.hankel_singular_values(found.hankel_singular_values, found.reduced.order),
        }
        if what not in drawn:
            raise AbraceError(f"figure {what!r} of an identification: expected one of {', '.join(drawn)}")
        return drawn[what]()

    def save(self, folder: Path | str) -> Path:
        """Write models, poles and validity into a `folder`, as the node `identify` does; returns it."""
        write_identification(self.found, Path(folder))
        write_validity(self.judged, Path(folder))
        return Path(folder)


def identify(
    table: AnyRun | Sequence[AnyRun],
    command: AnyRun | Sequence[AnyRun],
    *,
    table_band: tuple[float, float] = DEFAULTS.table_band,
    command_band: tuple[float, float] = DEFAULTS.command_band,
    reduced_order: int = DEFAULTS.reduced_order,
    servo_lag: float = DEFAULTS.servo_lag,
    fit: str = DEFAULTS.fit,
) -> Identified:
    """Identify a rig from recorded tests. Hold and delays are taken into account, the servos' lags are measured.

    Parameters
    ----------
    table, command
        Tests (Runs or bags, one or several) with noise or a multisine on the table, and as command; the same ones where
        both were excited at once.
    table_band, command_band
        [Hz], within which the tests are used.
    reduced_order
        States of the reduced model; 0: as many as count.
    servo_lag
        [s] of a bench test, to compare with; 0: none was made.
    fit
        Of the poles: "maximum_likelihood", "vector_fitting", "sk" or "paper".

    Returns
    -------
    Identified
        With `model`, `reduced`, `validity`. Warnings on tests and fit are given as Python warnings.

    Raises
    ------
    AbraceError
        If a test or an option cannot be used.
    """
    options = IdentificationOptions(
        fit=fit, table_band=table_band, command_band=command_band, servo_lag=servo_lag, reduced_order=reduced_order
    )
    tables, commands = runs_of(table), runs_of(command)
    found = identification.identify(tables, commands, options)
    warn(found.warnings)
    return Identified(found, judge(tables, commands, options, found))


@dataclass(frozen=True)
class IdentifiedData:
    """The model of a structure from measured data.

    Parameters
    ----------
    found
        The whole identification.
    """

    found: DataIdentification

    def __repr__(self) -> str:
        low, high = self.found.band
        return f"<Identified: {len(self.found.pairs)} modes, {low:.3g} to {high:.3g} Hz, from {self.found.data.source}>"

    @property
    def model(self) -> LinearModel:
        """The continuous model."""
        return self.found.model

    def to_pandas(self) -> pandas.DataFrame:
        """The modes, slowest first, with 95 % confidence intervals."""
        return _pairs(self.found.pairs)

    def plot(self, what: str | None = None) -> Figure:
        """A figure.

        Parameters
        ----------
        what
            `transfer_functions_NAME` of an input, "residuals" or "confidence"; None: the first input's.

        Raises
        ------
        AbraceError
            If it is none of these.
        """
        drawn = figures_of_data(self.found)
        chosen = what or next(iter(drawn))
        if chosen not in drawn:
            raise AbraceError(f"figure {chosen!r} of an identification: expected one of {', '.join(drawn)}")
        return drawn[chosen]


def identify_data(
    data: MeasuredData | Mapping[str, ArrayLike] | pandas.DataFrame | Path | str,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    *,
    sample_rate: float = 0.0,
    time: str = "",
    units: Mapping[str, str] | None = None,
    hold: DataHold = "band",
    band: tuple[float, float] | None = None,
) -> IdentifiedData:
    """Identify any structure from measured inputs and outputs.

    Parameters
    ----------
    data
        A file (.mat, .npz, .npy, .csv), a DataFrame or arrays by name.
    inputs, outputs
        Names of columns; no outputs: all others.
    sample_rate
        [Hz]; 0: from the column `time`.
    time
        Name of a column of times [s].
    units
        By column, for figures.
    hold
        "band": inputs and outputs sampled alike, below half the sample rate; "zero": inputs held between samples.
    band
        [Hz] that is used; None: ten lines to half the sample rate.

    Raises
    ------
    AbraceError
        If the data cannot be used, with all columns that are missing.
    """
    given = data if isinstance(data, MeasuredData) else read_data(data, inputs, outputs, sample_rate, time, units, hold)
    found = data_identification.identify_data(given, DataOptions(band=band))
    warn(found.warnings)
    return IdentifiedData(found)


@dataclass(frozen=True)
class Validated:
    """A test beside its simulation by a model.

    Parameters
    ----------
    comparison
        Measured and simulated.
    finding
        Of the channel that is predicted worst.
    """

    comparison: Comparison
    finding: Finding

    def __repr__(self) -> str:
        worst = f"worst {self.finding.where}, {100 * self.finding.value:.2g} % beyond its noise"
        return f"<Validated: {self.comparison.source}: {worst}: {self.finding.verdict.words}>"

    def to_pandas(self) -> pandas.DataFrame:
        """Of each channel peak and rms, measured and simulated [SI units], correlation and relative errors."""
        comparison, names = self.comparison, self.comparison.names
        measured, simulated = comparison.measured_peak_rms(), comparison.simulated_peak_rms()
        columns = {
            "peak measured": [measured[name].peak for name in names],
            "peak simulated": [simulated[name].peak for name in names],
            "rms measured": [measured[name].rms for name in names],
            "rms simulated": [simulated[name].rms for name in names],
        }
        for title, values in (
            ("correlation", comparison.correlation()),
            ("rms error / rms", comparison.normalised_rms_error()),
            ("without sensor noise", comparison.noise_free_error()),
        ):
            columns[title] = [values.get(name, np.nan) for name in names]
        return data_frame(columns, "channel", names)

    def plot(self, channels: Sequence[str] = ()) -> Figure:
        """Measured and simulated over time.

        Parameters
        ----------
        channels
            One row each; none: the top floor's displacement and the first acceleration.
        """
        names = self.comparison.names
        floors = [name for name in names if name[0] == "x" and name[1:].isdigit()]
        return time_histories(self.comparison, tuple(channels) or (*floors[-1:], "a1"))


def validate(test: AnyRun, model: AnyModel, *, controller: AnyController | None = None) -> Validated:
    """Compare a recorded test with its simulation by a model.

    Parameters
    ----------
    test
        A Run or its bag.
    model
        A model, its file, an identification (or its folder), a rig, a StateSpace of python-control.
    controller
        Of the test, which then closes the loop around the model; None: the recorded command drives it.

    Raises
    ------
    AbraceError
        If test, model and controller are not of the same rig, or the test has a gap.
    """
    (run, *more) = runs_of(test)
    if more:
        raise AbraceError(f"{run.source}: {1 + len(more)} runs, expected one")
    law: Any = None
    limit, correction = np.full(run.groups, np.inf), None
    if controller is not None:
        given = controller_of(controller)
        law, limit, correction = given.law, given.force_limit, given.correction
    comparison = validation.compare(run, model_of(model), law, limit, correction)
    return Validated(comparison, predicted(comparison))


def _pairs(pairs: Sequence[PoleInterval]) -> pandas.DataFrame:
    """Pole pairs with their intervals."""
    hertz = 2 * np.pi
    columns = {
        "frequency [Hz]": [pair.frequency / hertz for pair in pairs],
        "frequency low": [pair.frequency_interval[0] / hertz for pair in pairs],
        "frequency high": [pair.frequency_interval[1] / hertz for pair in pairs],
        "damping ratio": [pair.damping for pair in pairs],
        "damping low": [pair.damping_interval[0] for pair in pairs],
        "damping high": [pair.damping_interval[1] for pair in pairs],
    }
    return data_frame(columns, "pole pair", range(1, len(pairs) + 1))

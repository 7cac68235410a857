# SPDX-License-Identifier: Apache-2.0
"""Tests of a rig to its models."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from abrace.interactive.given import band_of, runs_of, warn
from abrace_core.errors import AbraceError
from abrace_core.one_thread import one_thread
from abrace_core.tables import data_frame
from abrace_sysid import identification
from abrace_sysid.figures import identification as figures
from abrace_sysid.figures.poles import confidence
from abrace_sysid.figures.validity import validity_figure
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.identification_results import write_identification
from abrace_sysid.nonlinear.identified import elements_of_tests
from abrace_sysid.validity.judgement import judge
from abrace_sysid.validity_results import write_validity

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas
    from matplotlib.figure import Figure

    from abrace.interactive.given import AnyRun
    from abrace_core.linear_model import LinearModel
    from abrace_sysid.fitting.pole_estimate import PoleInterval
    from abrace_sysid.identification import Identification
    from abrace_sysid.validity.finding import Validity
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
        """All findings; `print(validity.text())` shows them as text."""
        return self.judged.validity

    def to_pandas(self) -> pandas.DataFrame:
        """The pole pairs of both tests, slowest first, with 95 % confidence intervals."""
        return pole_intervals(self.found.poles.common_pairs)

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
            "table test": found.poles.table_pairs,
            "command test": found.poles.command_pairs,
            "both tests": found.poles.common_pairs,
        }
        drawn = {
            "transfer_functions": lambda: figures.transfer_functions(measured[0], shown, found.model),
            "commands": lambda: figures.transfer_functions(measured[1], shown, found.model),
            "residuals": lambda: figures.residuals(measured, found.model),
            "confidence": lambda: confidence(pairs),
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


@one_thread()
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
        [Hz], within which the tests are used; (0, 0): all that they excite.
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
        fit=fit,
        table_band=band_of(table_band),
        command_band=band_of(command_band),
        servo_lag=servo_lag,
        reduced_order=reduced_order,
    )
    tables, commands = runs_of(table), runs_of(command)
    found = identification.identify(tables, commands, options)
    warn(found.warnings)
    judged = judge(tables, commands, options, found)
    elements = elements_of_tests(found, options, judged.validity.causes)
    if elements is not None:
        found = replace(found, model=elements.noted_in(found.model))
    return Identified(found, judged)


def pole_intervals(pairs: Sequence[PoleInterval]) -> pandas.DataFrame:
    """The pole `pairs` with their 95 % intervals, a row each."""
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

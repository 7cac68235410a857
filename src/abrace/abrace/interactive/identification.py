# SPDX-License-Identifier: Apache-2.0
"""Tests of a rig to its models."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace.interactive.given import several, takes, warn
from abrace_core import AbraceError
from abrace_core.files.options import NOT_GIVEN
from abrace_core.model.one_thread import one_thread
from abrace_core.model.plotted import draws
from abrace_core.model.signals import most_telling
from abrace_core.model.tabular import Tabular
from abrace_sysid import identification, input_tests
from abrace_sysid.figures import identification as figures
from abrace_sysid.figures.poles import confidence
from abrace_sysid.figures.validity import validity_figure
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.results import write_identification, write_validity
from abrace_sysid.spectra.estimation import TransferFunctionOptions
from abrace_sysid.spectra.frequency_response import FrequencyResponse
from abrace_sysid.validity.judgement import judge

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_sysid.fitting.pole_estimate import PoleInterval
    from abrace_sysid.identification import Identification
    from abrace_sysid.recorded.test import AnyTest
    from abrace_sysid.validity.finding import Validity
    from abrace_sysid.validity.judgement import Judgement


@dataclass(frozen=True)
class Identified(Tabular):
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
        tests = ", ".join(dict.fromkeys(test.source for test in self.found.tests))
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

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles of the model for prediction, as `LinearModel.poles`; with their intervals: `to_pandas`."""
        return self.model.poles

    A, B, C, D = (property(attrgetter(f"model.{name}"), doc=f"As `model.{name}`.") for name in "abcd")

    def to_pandas(self) -> pandas.DataFrame:
        """The pole pairs of both tests, slowest first, with 95 % confidence intervals."""
        return pole_intervals(self.found.poles.common_pairs)

    def plot(self, what: str = "transfer_functions") -> Figure:
        """A figure.

        Parameters
        ----------
        what
            "transfer_functions": measured and of the model, from the table, to the top floor and the first
            acceleration; "commands": the same from the first command; "confidence"; "validity"; "reduction".

        Raises
        ------
        AbraceError
            If it is none of these.
        """
        found = self.found
        measured = [found.table_response, *(data.responses[0] for data in found.commands)]
        shown = most_telling(found.model.outputs)
        drawn = {
            "transfer_functions": lambda: figures.transfer_functions(measured[0], shown, found.model).figure(),
            "commands": lambda: figures.transfer_functions(measured[1], shown, found.model).figure(),
            "confidence": lambda: confidence(found.poles.pairs),
            "validity": lambda: validity_figure(self.validity, self.judged.residuals),
            "reduction": lambda: figures.hankel_singular_values(found.reduction),
        }
        if what not in drawn:
            raise AbraceError(f"figure {what!r} of an identification: expected one of {', '.join(drawn)}")
        return drawn[what]()

    def save(self, folder: Path | str) -> Path:
        """Write models, poles and validity into a `folder`, as the node `identify` does; returns it."""
        write_identification(self.found, Path(folder))
        write_validity(self.judged, Path(folder))
        return Path(folder)


@takes(IdentificationOptions)
@one_thread()
def identify(table: AnyTest | Sequence[AnyTest], command: AnyTest | Sequence[AnyTest], **options: Any) -> Identified:
    """Identify a rig from recorded tests. Hold and delays are taken into account, the servos' lags are measured.

    Parameters
    ----------
    table, command
        Tests (`abrace.Test`, Runs or bags, one or several) with noise or a multisine on the table, and as command; the
        same ones where both were excited at once.
    **options
        As `IdentificationOptions` has them.

    Returns
    -------
    Identified
        With `model`, `reduced`, `validity`. Warnings on tests and fit are given as Python warnings.

    Raises
    ------
    AbraceError
        If a test or an option cannot be used.
    """
    found = identification.identify(table, command, IdentificationOptions.of(options))
    warn(found.warnings)
    return Identified(found, judge(found))


@takes(TransferFunctionOptions)
@one_thread()
def transfer_functions(
    tests: AnyTest | Sequence[AnyTest],
    input: str = "",  # noqa: A002 - as a test and a control.FRD name it
    *,
    band: tuple[float, float] = NOT_GIVEN,
    **options: Any,
) -> FrequencyResponse:
    """Estimate the transfer functions from one input to all outputs that respond to it, with their noise.

    Parameters
    ----------
    tests
        One or several repeated tests (`abrace.Test`, Runs or bags) with noise or a multisine; of a multisine the
        transfer functions are those of its lines, whatever the method.
    input
        `w`, `U`, ...; empty: the only command that moves, the table where none does.
    band
        [Hz]; (0, 0): as far as the tests excite it.
    **options
        As `TransferFunctionOptions` has them.

    Returns
    -------
    FrequencyResponse
        `omega` [rad/s], `response` and `sigma` (lines, outputs); `plot`, `to_pandas`, `to_csv`, `to_mat`, `to_control`.

    Raises
    ------
    AbraceError
        If the tests or an option cannot be used, or it is not said which of several inputs is meant.
    """
    found, warnings = input_tests.transfer_functions(tests, input, band, TransferFunctionOptions.of(options))
    warn(warnings)
    return found


@draws(FrequencyResponse)
def _of_response(response: FrequencyResponse, channels: Sequence[str] = ()) -> Figure:
    return figures.transfer_functions(response, several(channels) or response.outputs).figure()


def pole_intervals(pairs: Sequence[PoleInterval]) -> pandas.DataFrame:
    """The pole `pairs` with their 95 % intervals, a row each."""
    import pandas

    hertz = 2 * np.pi
    columns = {
        "frequency [Hz]": [pair.frequency / hertz for pair in pairs],
        "frequency low": [pair.frequency_interval[0] / hertz for pair in pairs],
        "frequency high": [pair.frequency_interval[1] / hertz for pair in pairs],
        "damping ratio": [pair.damping for pair in pairs],
        "damping low": [pair.damping_interval[0] for pair in pairs],
        "damping high": [pair.damping_interval[1] for pair in pairs],
    }
    return pandas.DataFrame(columns, index=pandas.Index(range(1, len(pairs) + 1), name="pole pair"))

# SPDX-License-Identifier: Apache-2.0
"""Any structure's measured inputs and outputs to a model; an ambient test to modes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from abrace.interactive.given import several, takes, warn
from abrace.interactive.identification import pole_intervals
from abrace_core import AbraceError
from abrace_core.figures.chart import Chart
from abrace_core.model.one_thread import one_thread
from abrace_core.model.tabular import Tabular
from abrace_sysid.ambient.change import compared_tests
from abrace_sysid.ambient.modes import AmbientOptions, ambient_test
from abrace_sysid.data_identification import DataOptions
from abrace_sysid.figures.ambient import ambient_stabilization
from abrace_sysid.figures.identification import figures_of_data
from abrace_sysid.results import write_data_results, write_validity
from abrace_sysid.validity.judgement import identify_and_judge

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from abrace_core.model.linear_model import LinearModel
    from abrace_sysid.ambient.change import BuildingChange
    from abrace_sysid.ambient.modes import AmbientTest
    from abrace_sysid.data_identification import DataIdentification
    from abrace_sysid.fitting.output_delays import Delay
    from abrace_sysid.recorded.test import AnyTest, Test
    from abrace_sysid.validity.finding import Validity
    from abrace_sysid.validity.judgement import Judgement

    AnyData: TypeAlias = Test | Mapping[str, ArrayLike] | pandas.DataFrame | Path | str


@dataclass(frozen=True)
class IdentifiedData(Tabular):
    """The model of a structure from measured data.

    Parameters
    ----------
    found
        The whole identification.
    held_out
        The records that were not used, moved in time; may be none.
    judged
        What was found of data and model.
    """

    found: DataIdentification
    held_out: tuple[Test, ...]
    judged: Judgement

    def __repr__(self) -> str:
        low, high = self.found.band
        return f"<Identified: {len(self.found.pairs)} modes, {low:.3g} to {high:.3g} Hz, from {self.found.source}>"

    @property
    def model(self) -> LinearModel:
        """The continuous model."""
        return self.found.model

    @property
    def validity(self) -> Validity:
        """All findings; `print(validity.text())` shows them as text."""
        return self.judged.validity

    @property
    def delays(self) -> Mapping[str, Delay]:
        """By output [s], against the inputs, with standard deviation; those that are certain."""
        return self.found.delays

    def to_pandas(self) -> pandas.DataFrame:
        """The modes, slowest first, with 95 % confidence intervals."""
        return pole_intervals(self.found.pairs)

    def plot(self, what: str | None = None) -> Figure:
        """A figure.

        Parameters
        ----------
        what
            `transfer_functions_NAME` of an input, or "confidence"; None: the first input's.

        Raises
        ------
        AbraceError
            If it is none of these.
        """
        drawn = figures_of_data(self.found)
        chosen = what or next(iter(drawn))
        if chosen not in drawn:
            raise AbraceError(f"figure {chosen!r} of an identification: expected one of {', '.join(drawn)}")
        figure = drawn[chosen]
        return figure.figure() if isinstance(figure, Chart) else figure

    def save(self, folder: Path | str) -> Path:
        """Write model, poles, prediction and validity into a `folder`, as the node `identify_data`; returns it."""
        write_data_results(self.found, self.held_out, Path(folder))
        write_validity(self.judged, Path(folder))
        return Path(folder)


@takes(DataOptions)
@one_thread()
def identify_data(
    data: AnyData | Sequence[AnyData],
    inputs: str | Sequence[str],
    outputs: Sequence[str] = (),
    *,
    validation: AnyData | Sequence[AnyData] = (),
    **options: Any,
) -> IdentifiedData:
    """Identify any structure from measured inputs and outputs.

    Parameters
    ----------
    data
        A file (MATLAB, NumPy, text), a DataFrame, arrays by name, or an `abrace.Test`; or several records.
    inputs, outputs
        Names of columns; no outputs: all others.
    validation
        Other records of the structure, that are only predicted.
    **options
        As `DataOptions` has them.

    Raises
    ------
    AbraceError
        If the data cannot be used, with all columns that are missing.
    """
    checked = DataOptions.of({"inputs": inputs, "outputs": outputs, **options})
    others = () if isinstance(validation, (list, tuple)) and not validation else checked.read(validation)
    found, held_out, judged = identify_and_judge(checked.read(data), checked, validation=others)
    warn(found.warnings)
    return IdentifiedData(found, held_out, judged)


@dataclass(frozen=True)
class IdentifiedModes(Tabular):
    """The modes of a building from an ambient test.

    Parameters
    ----------
    found
        Modes with shapes, and what the stabilisation diagram shows.
    change
        What has changed since the tests `before`; None: there were none.
    """

    found: AmbientTest
    change: BuildingChange | None = None

    def __repr__(self) -> str:
        hertz = ", ".join(f"{mode.frequency / (2 * np.pi):.3f}" for mode in self.found.modes)
        return f"<Modes: {hertz} Hz, from {self.found.seconds:g} s of {', '.join(self.found.channels)}>"

    def to_pandas(self) -> pandas.DataFrame:
        """The modes, slowest first, with 95 % confidence intervals."""
        return pole_intervals([mode.interval for mode in self.found.modes])

    def plot(self) -> Figure:
        """The stabilisation diagram."""
        return ambient_stabilization(self.found)


@takes(AmbientOptions)
@one_thread()
def identify_ambient(
    test: AnyTest | Sequence[AnyTest],
    channels: Sequence[str] = (),
    *,
    before: AnyTest | Sequence[AnyTest] = (),
    **options: Any,
) -> IdentifiedModes:
    """Find a building's modes from tests without commands, whatever moves the table.

    Parameters
    ----------
    test
        Tests (`abrace.Test`, Runs, bags, tables), one or several of one state of the building.
    channels
        Outputs to use; none: all accelerations.
    before
        Earlier tests, to find what has changed since; none: nothing is compared.
    **options
        As `AmbientOptions` has them.

    Raises
    ------
    AbraceError
        If there is a command, the tests are too short, or no band is given and no resonance found.
    """
    checked = AmbientOptions.of({"channels": channels, **options})
    tests = checked.read(test)
    change, earlier = None, (before,) if hasattr(before, "keys") else several(before)
    reference = checked.read(earlier) if earlier else ()
    warn(warning for one in (*tests, *reference) for warning in one.warnings)
    if earlier:
        found, _, change = compared_tests(tests, reference, checked)
    else:
        found = ambient_test(tests, checked)
    return IdentifiedModes(found, change)

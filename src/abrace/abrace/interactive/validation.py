# SPDX-License-Identifier: Apache-2.0
"""Models against tests."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace.interactive.given import controller_of, model_of, several, takes
from abrace_core.model.one_thread import one_thread
from abrace_core.model.signals import most_telling
from abrace_core.model.tabular import Tabular
from abrace_sysid import validation
from abrace_sysid.figures.validation import time_histories
from abrace_sysid.validation import ValidateOptions, read_test

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas
    from matplotlib.figure import Figure

    from abrace.interactive.data import AnyData
    from abrace.interactive.given import AnyController, AnyModel
    from abrace_sysid.recorded.test import AnyTest
    from abrace_sysid.validation import Comparison
    from abrace_sysid.validity.finding import Finding


@dataclass(frozen=True)
class Validated(Tabular):
    """Comparison of a test with its simulation by a model.

    Parameters
    ----------
    comparison
        Measured and simulated.
    finding
        The finding of the channel that is predicted worst.
    """

    comparison: Comparison
    finding: Finding

    def __repr__(self) -> str:
        return f"<Validated: {self.comparison.source}: {self.finding.verdict.words}: {self.finding.meaning}>"

    def to_pandas(self) -> pandas.DataFrame:
        """Of each channel peak and rms, measured and simulated [SI units], correlation and relative errors."""
        import pandas

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
        return pandas.DataFrame(columns, index=pandas.Index(names, name="channel"))

    def plot(self, channels: Sequence[str] = ()) -> Figure:
        """Measured and simulated over time.

        Parameters
        ----------
        channels
            One row each; none: the top floor's displacement and the first acceleration.
        """
        return time_histories(self.comparison, several(channels) or most_telling(self.comparison.names)).figure()


@takes(ValidateOptions)
@one_thread()
def validate(
    test: AnyTest | AnyData, model: AnyModel, *, controller: AnyController | None = None, **options: Any
) -> Validated:
    """Compare a recorded test with its simulation by a model.

    Parameters
    ----------
    test
        A test (`abrace.Test`, Run or bag); for a model of measured data also a file with columns, a DataFrame, or
        arrays by name.
    model
        A model, its file, an identification (or its folder), a rig, a StateSpace of python-control.
    controller
        Of the test, which then closes the loop around the model; None: the recorded command drives it.
    **options
        As `ValidateOptions` has them.

    Raises
    ------
    AbraceError
        If test, model and controller are not of the same structure, or the test has a gap. Channels that the model
        does not have are not compared, and named.
    """
    linear = model_of(model)
    tests = read_test(test, linear, ValidateOptions.of(options))
    law: tuple[Any, Any, Any] = (None, None, None)
    if controller is not None:
        given = controller_of(controller, linear.provenance.get("force_limit", ()))
        law = given.law, given.force_limit, given.correction
    comparison = validation.compare(tests, linear, *law)
    return Validated(comparison, validation.predicted(comparison))

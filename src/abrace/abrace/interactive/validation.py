# SPDX-License-Identifier: Apache-2.0
"""Models against tests."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace.interactive.given import controller_of, model_of, runs_of, several
from abrace_core.errors import AbraceError
from abrace_core.one_thread import one_thread
from abrace_core.tables import data_frame
from abrace_sysid import validation
from abrace_sysid.figures.validation import time_histories
from abrace_sysid.nonlinear.elements import Nonlinearity

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas
    from matplotlib.figure import Figure

    from abrace.interactive.given import AnyController, AnyModel, AnyRun
    from abrace_sysid.validation import Comparison
    from abrace_sysid.validity.finding import Finding


@dataclass(frozen=True)
class Validated:
    """Comparison of a test with its simulation by a model.

    Parameters
    ----------
    comparison
        Measured and simulated.
    finding
        Of the channel that is predicted worst.
    not_linear
        The same with what the model's tests showed of friction, joints, deadband and backlash; None: nothing.
    """

    comparison: Comparison
    finding: Finding
    not_linear: Comparison | None = None

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
        return time_histories(self.comparison, several(channels) or (*floors[-1:], "a1"))


@one_thread()
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
    linear = model_of(model)
    comparison, elements = validation.compare(run, linear, law, limit, correction), Nonlinearity.of_model(linear)
    other = None if elements is None else validation.compare(run, linear, law, limit, correction, elements)
    return Validated(comparison, validation.predicted(comparison), other)

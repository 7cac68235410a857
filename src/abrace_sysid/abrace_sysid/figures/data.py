# SPDX-License-Identifier: Apache-2.0
"""The figures of an identification from measured data."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_sysid.figures import identification as figures
from abrace_sysid.figures.poles import confidence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from abrace_sysid.data_identification import DataIdentification

SHOWN = 3
"""Number of outputs whose transfer functions are drawn."""


def figures_of_data(found: DataIdentification) -> dict[str, Figure]:
    """The figures of `found` by name: transfer functions from each input, residuals, and intervals of the modes."""
    shown = found.model.outputs[:SHOWN]
    drawn = {
        f"transfer_functions_{response.input}": figures.transfer_functions(
            response, shown, found.model, found.data.units
        )
        for response in found.responses
    }
    drawn["residuals"] = figures.residuals(found.responses, found.model)
    drawn["confidence"] = confidence({"data": found.pairs})
    return drawn

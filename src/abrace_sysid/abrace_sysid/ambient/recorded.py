# SPDX-License-Identifier: Apache-2.0
"""Recorded tests of a rig as ambient tests: only the responses are used, commands are zero, the table may move."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_sysid.ambient.modes import AmbientTest, ambient_modes
from abrace_sysid.recordings import longest_piece
from abrace_sysid.spectra.fourier import held_input

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.run import Run


def ambient_test(
    runs: Sequence[Run], channels: Sequence[str], band: tuple[float, float] | None, highest_order: int
) -> tuple[AmbientTest, tuple[str, ...]]:
    """Modes from recorded tests without commands, and a warning for each test of which only a piece is used.

    Parameters
    ----------
    runs
        Tests of one rig; the longest piece without a gap of each is used.
    channels
        Names of the outputs to use; empty: the accelerations.
    band, highest_order
        As for `ambient_modes`.

    Raises
    ------
    AbraceError
        If a command is not zero, the rigs differ, or as in `ambient_modes`.
    """
    first = runs[0]
    names = tuple(channels) or tuple(name for name in first.names if name[0] == "a")
    records: list[NDArray[np.float64]] = []
    warnings: list[str] = []
    for run in runs:
        if (run.names, run.sample_period) != (first.names, first.sample_period):
            raise AbraceError(f"{run.source}: another rig or sample period than {first.source}, expected the same")
        for command in run.command_names:
            greatest = float(np.abs(held_input(run, command)).max())
            if greatest:
                raise AbraceError(
                    f"{run.source}: {command} up to {greatest:g} N, expected 0: an ambient test is without commands"
                )
        piece, found = longest_piece(run)
        warnings += found
        records.append(piece.channels(names))
    source = ", ".join(dict.fromkeys(run.source for run in runs))
    return ambient_modes(source, records, names, 1 / first.sample_period, band, highest_order), tuple(warnings)

# SPDX-License-Identifier: Apache-2.0
"""The shake table in a rig file, read without the rest: that needs SciPy, whose import would double a node's start."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import pydantic

from abrace_core.config_file import Checked, read_config
from abrace_core.safety.table_stop import Table
from abrace_plant.rig.checks import Positive

if TYPE_CHECKING:
    from pathlib import Path


class TableDynamicsContent(Checked):
    """The key `table.dynamics` of a rig file."""

    mass: Positive
    frequency: Positive
    damping_ratio: Annotated[float, pydantic.Field(gt=0, lt=2)]


class TableContent(Checked):
    """The key `table` of a rig file."""

    peak_acceleration: Positive
    peak_jerk: Positive
    peak_velocity: Positive
    peak_displacement: Positive
    dynamics: TableDynamicsContent | None = None

    def table(self) -> Table:
        """The table's limits."""
        return Table(**self.model_dump(exclude={"dynamics"}))


class TableOfRig(Checked):
    """The keys of a rig file that a player of ground motions needs; the rig checks the others."""

    model_config = pydantic.ConfigDict(extra="ignore")

    name: str
    sample_rate: Positive
    table: TableContent


def load_table(path: Path | str) -> TableOfRig:
    """Read and check the table and the sample rate in a rig file.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    return read_config(path, TableOfRig, "rig")

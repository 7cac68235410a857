# SPDX-License-Identifier: Apache-2.0
"""The shake table in a rig file, read without the rest: that needs SciPy, whose import would double a node's start."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import pydantic

from abrace_core.files.config_file import Checked, read_config
from abrace_core.files.quantity import Quantity
from abrace_core.safety.table_stop import Table
from abrace_plant.rig.checks import Positive, SampleRate
from abrace_plant.rig.table_dynamics import TableDynamics

if TYPE_CHECKING:
    from pathlib import Path


NOT_DRIVEN = (
    "the table is driven by its own controller (table.driven: false in the rig file): start the motion there, "
    "abrace triggers nothing"
)


class TableContent(Checked):
    """The key `table` of a rig file."""

    peak_acceleration: Annotated[float, pydantic.Field(ge=1, le=100), Quantity("m/s^2")]
    peak_jerk: Annotated[Positive, Quantity("m/s^3")]
    peak_velocity: Annotated[float, pydantic.Field(ge=0.03, le=10), Quantity("m/s")]
    peak_displacement: Annotated[Positive, Quantity("m")]
    dynamics: TableDynamics | None = None
    driven: bool = True

    def table(self) -> Table:
        """The table's limits."""
        return Table(**self.model_dump(exclude={"dynamics", "driven"}))


class TableOfRig(Checked):
    """The keys of a rig file that a player of ground motions needs; the rig checks the others."""

    model_config = pydantic.ConfigDict(extra="ignore")

    name: str
    sample_rate: SampleRate
    table: TableContent


def load_table(path: Path | str) -> TableOfRig:
    """Read and check the table and the sample rate in a rig file.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    return read_config(path, TableOfRig, "rig")

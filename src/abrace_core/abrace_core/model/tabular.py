# SPDX-License-Identifier: Apache-2.0
"""Results that have a table: written to files of other programs, and shown by a notebook."""

from __future__ import annotations

import html
import re
from typing import TYPE_CHECKING

from abrace_core import AbraceError
from abrace_core.files.writing import write_atomically, write_json, write_text

if TYPE_CHECKING:
    from pathlib import Path

    import pandas

SHOWN_ROWS = 20
"""Rows of a table in a notebook; of a longer one the first and the last."""


class Tabular:
    """Base of results with `to_pandas()`: the same table as files, index included."""

    def to_pandas(self) -> pandas.DataFrame:
        """The result as a table [SI units]."""
        raise NotImplementedError

    def to_csv(self, path: Path | str) -> None:
        """Write the table as comma-separated values; the name of the file ends in .csv."""
        write_text(_ending(path, ".csv"), self.to_pandas().to_csv())

    def to_json(self, path: Path | str) -> None:
        """Write the table as JSON, a list for each column; the name of the file ends in .json."""
        frame = self.to_pandas().reset_index()
        write_json(_ending(path, ".json"), {str(name): frame[name].tolist() for name in frame})

    def to_mat(self, path: Path | str) -> None:
        """Write the table to a MATLAB file, a variable for each column; the name of the file ends in .mat."""
        from scipy.io import savemat

        frame = self.to_pandas().reset_index()
        columns = {re.sub(r"\W+", "_", str(name)).strip("_"): frame[name].to_numpy() for name in frame}
        with write_atomically(_ending(path, ".mat")) as temporary:
            savemat(
                str(temporary),
                {
                    name: each.astype(object) if each.dtype.kind not in "fiub" else each
                    for name, each in columns.items()
                },
                long_field_names=True,
                oned_as="column",
            )

    def _repr_html_(self) -> str:
        """What a notebook shows: the line, and the table."""
        table = self.to_pandas().to_html(max_rows=SHOWN_ROWS, float_format="{:.5g}".format)
        return f"<p>{html.escape(repr(self))}</p>{table}"


def _ending(path: Path | str, ending: str) -> Path | str:
    if not str(path).endswith(ending):
        raise AbraceError(f"file {path}: expected a name that ends in {ending}")
    return path

# SPDX-License-Identifier: Apache-2.0
"""Results of a long computation as a folder of Parquet files, one for each batch. Existing files are complete and kept.

A file is written under a temporary name and renamed, so that a killed computation continues after its last batches.
Each file has a checksum of the inputs that it was computed from: results of other inputs are refused, never mixed.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow
from pyarrow import parquet

from abrace_core import AbraceError
from abrace_core.files.writing import write_atomically

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

INPUTS = b"abrace_inputs"
"""Key of the checksum among a file's metadata."""
PATTERN = "part-*.parquet"


class Parts:
    """A folder of finished batches, `count` in all; `inputs`: checksum of what they are computed from.

    Raises
    ------
    AbraceError
        If the folder has results of other inputs.
    """

    def __init__(self, folder: Path | str, inputs: str, count: int) -> None:
        self.folder, self.count = Path(folder), count
        self._inputs = inputs.encode()
        for path in self.folder.glob(PATTERN):
            found = _metadata(path).get(INPUTS)
            if found != self._inputs:
                raise AbraceError(
                    f"{path}: computed from other inputs, expected the same ones, or a folder without results"
                )

    def path(self, number: int) -> Path:
        """Path of the file of the batch with this `number`."""
        return self.folder / f"part-{number:06d}.parquet"

    def missing(self) -> list[int]:
        """Numbers of the batches that are not there yet."""
        return [number for number in range(self.count) if not self.path(number).exists()]

    def write(self, number: int, table: pyarrow.Table) -> None:
        """Write the `table` of the batch with this `number`; the same table gives the same bytes."""
        named = table.replace_schema_metadata({INPUTS: self._inputs})
        with write_atomically(self.path(number)) as temporary:
            parquet.write_table(named, temporary, compression="zstd", compression_level=1, use_dictionary=_words(named))

    def clean(self) -> None:
        """Remove half-written files, which processes that were killed have left."""
        for path in self.folder.glob(f".*.{PATTERN}"):
            path.unlink(missing_ok=True)


def each_part(folder: Path | str, columns: Sequence[str] | None = None) -> Iterator[pyarrow.Table]:
    """The tables of a `folder` of parts, one after the other, in the order of the batches.

    Of some `columns`, None: of all.

    Raises
    ------
    AbraceError
        If the folder has no parts, or one cannot be read.
    """
    paths = sorted(Path(folder).glob(PATTERN))
    if not paths:
        raise AbraceError(f"{folder}: no {PATTERN}, expected the folder of finished batches")
    for path in paths:
        try:
            yield parquet.read_table(path, columns=columns)
        except (OSError, pyarrow.ArrowException) as error:
            raise AbraceError(f"{path}: {error}, expected finished batches of one computation") from error


def read_parts(folder: Path | str, columns: Sequence[str] | None = None) -> pyarrow.Table:
    """All rows of a `folder` of parts in the order of the batches, of all `columns` or some; else as `each_part`."""
    return pyarrow.concat_tables(each_part(folder, columns), promote_options="default").unify_dictionaries()


def _metadata(path: Path) -> dict[bytes, bytes]:
    try:
        return parquet.read_schema(path).metadata or {}
    except (OSError, pyarrow.ArrowException) as error:
        raise AbraceError(f"{path}: {error}, expected a Parquet file of a finished batch") from error


def _words(table: pyarrow.Table) -> list[str]:
    """Names of the columns of texts, which are stored as numbers of a dictionary."""
    return [each.name for each in table.schema if pyarrow.types.is_dictionary(each.type)]

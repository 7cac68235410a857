# SPDX-License-Identifier: Apache-2.0
"""The table in a file, known by its content: MATLAB's, NumPy's, or a text."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.file_kinds import decoded
from abrace_core.files.matlab_loader import load_matlab
from abrace_core.files.table import Table, array_table
from abrace_core.files.table_text import text_table

if TYPE_CHECKING:
    from pathlib import Path


def read_table(path: Path) -> Table:
    """The table in a file, by its content.

    Raises
    ------
    AbraceError
        If there is none, or it is of a kind that has no columns: which.
    """
    try:
        return table_in(path.read_bytes(), path, str(path))
    except OSError as error:
        what = "a folder, expected a file" if isinstance(error, IsADirectoryError) else error.strerror
        raise AbraceError(f"{path}: {what}") from error


def table_in(content: bytes, path: Path, source: str) -> Table:
    """The table in the `content` of a file at `path`, which errors call `source`; see `read_table`."""
    try:
        if content.startswith(b"\x93NUMPY"):
            return array_table({"": np.load(BytesIO(content))}, source)
        if content.startswith(b"PK\x03\x04") and b".npy" in content[:200]:
            with np.load(BytesIO(content)) as arrays:
                return array_table({name: arrays[name] for name in arrays if _readable(arrays, name)}, source)
        if is_matlab(content, path):
            return array_table(load_matlab(path, source), source)
    except AbraceError:
        raise
    except Exception as error:  # NumPy's reader raises many types for a damaged file
        raise AbraceError(f"{source}: {error}") from error
    return text_table(decoded(content, source), source)


def is_text(content: bytes, path: Path) -> bool:
    """Whether the `content` of a file at `path` is neither MATLAB's nor NumPy's."""
    return not (content[:6] == b"\x93NUMPY" or content[:4] == b"PK\x03\x04" or is_matlab(content, path))


def _readable(content: Any, name: str) -> bool:
    try:
        content[name]
    except ValueError:  # objects
        return False
    return True


def is_matlab(content: bytes, path: Path) -> bool:
    """Whether a file is MATLAB's: by its content, of version 4 by its ending and the binary header."""
    if (
        content[:6] == b"MATLAB"
        or content[512:520] == b"\x89HDF\r\n\x1a\n"
        or content[124:128] in (b"\0\1IM", b"\1\0MI")
    ):
        return True
    return path.suffix.lower() == ".mat" and (
        b"\0" in content[:200] or not content or content[:8] == b"\x89HDF\r\n\x1a\n"
    )

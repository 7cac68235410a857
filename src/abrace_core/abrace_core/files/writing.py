# SPDX-License-Identifier: Apache-2.0
"""Atomic writing of files, also against crash or power loss: a temporary file is written, synced, then renamed."""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import json
import math
import os
import secrets
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

_NOT_SYNCED = (errno.EINVAL, errno.ENOTSUP)
"""Errors of file systems that cannot sync a folder: network shares, some of FUSE."""


@contextlib.contextmanager
def write_atomically(path: Path | str) -> Iterator[Path]:
    """A temporary file beside `path`; renamed to `path` when the block ends, removed when it raises.

    It has the suffix of `path`, by which some writers choose the format. When the block has ended the file is on the
    disk: a power loss leaves the complete old file or the complete new one. Of several writers at once the last one
    counts. A symbolic link stays one, its target is written; a file that is there keeps its mode.

    Raises
    ------
    AbraceError
        If the folder cannot be made or written to, or what the block reads or writes fails with an OSError.
    """
    target = Path(os.path.realpath(path))
    temporary = target.parent / f".{secrets.token_hex(4)}.{target.name}"
    try:
        make_folder(target.parent)
        yield temporary
        if target.exists():
            shutil.copymode(target, temporary)
        sync(temporary)
        move(temporary, target)
    except OSError as error:
        reason = error.strerror or " ".join(str(error).split()) or type(error).__name__
        if error.filename is not None and Path(error.filename) not in (temporary, target, *target.parents):
            reason = f"{error.filename}: {reason}"
        raise AbraceError(f"cannot write {path}: {reason}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def write_text(path: Path | str, text: str) -> None:
    """Write a text file atomically, in UTF-8."""
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path | str, content: Any) -> None:
    """Write a JSON file atomically: `content` with null for each number that JSON lacks."""
    write_text(path, json.dumps(finite_or_null(content), indent=1, allow_nan=False) + "\n")


def write_rows(path: Path | str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write `rows`, values by column, to a CSV file atomically; a column that a row does not have is empty there."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def finite_or_null(value: Any) -> Any:
    """A JSON `value` with None for each number that JSON lacks: an infinite margin becomes null.

    >>> finite_or_null({"gain": float("inf"), "margins": (1.0, float("nan"))})
    {'gain': None, 'margins': [1.0, None]}
    """
    if isinstance(value, dict):
        return {key: finite_or_null(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite_or_null(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def make_folder(path: Path, *, new: bool = False) -> None:
    """Make a folder and those above it, and sync them to the disk.

    Parameters
    ----------
    path
        The folder; nothing is done where it exists.
    new
        Whether it is an error (FileExistsError) that it exists.
    """
    if not path.parent.exists():
        make_folder(path.parent)
    try:
        path.mkdir()
    except FileExistsError as error:
        if new:
            raise
        if not path.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path)) from error
    else:
        sync(path.parent)


def move(source: Path, target: Path) -> None:
    """Rename the file or folder `source`, which is on the disk already, to `target`, in the same folder or another."""
    source.replace(target)
    sync(target.parent)


def sync(path: Path) -> None:
    """Wait until a file's content, or the names in a folder, of this `path` are on the disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    except OSError as error:
        if error.errno not in _NOT_SYNCED:
            raise
    finally:
        os.close(number)

# SPDX-License-Identifier: Apache-2.0
"""Atomic writing of files, also against crash or power loss: a temporary file is written, synced, then renamed."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator

_NOT_SYNCED = (errno.EINVAL, errno.ENOTSUP)
"""Errors of file systems that cannot sync a folder: network shares, some of FUSE."""


@contextlib.contextmanager
def write_atomically(path: Path | str) -> Iterator[Path]:
    """A temporary file in the folder of `path`; renamed to `path` when the block ends, removed when it raises.

    It has the suffix of `path`, by which some writers choose the format. When the block has ended the file is on the
    disk: a power loss leaves the complete old file or the complete new one.

    Raises
    ------
    AbraceError
        If the folder cannot be made or written to.
    """
    path = Path(path)
    temporary = path.parent / f".{os.getpid()}.{path.name}"
    try:
        make_folder(path.parent)
        yield temporary
        sync(temporary)
        move(temporary, path)
    except OSError as error:
        raise AbraceError(f"cannot write {path}: {error.strerror}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def write_text(path: Path | str, text: str) -> None:
    """Write a text file atomically, in UTF-8."""
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


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

"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextlib.contextmanager
def write_beside(path: Path | str) -> Iterator[Path]:
    """A path beside `path` to write to; renamed to `path` when the block ends well, removed when it does not.

    The ending is kept, so that writers that choose a format by it still do.

    Raises
    ------
    AbraceError
        If the folder cannot be made or written to.
    """
    path = Path(path)
    beside = path.parent / f".{os.getpid()}.{path.name}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield beside
        beside.replace(path)
    except OSError as error:
        raise AbraceError(f"cannot write {path}: {error.strerror}") from error
    finally:
        with contextlib.suppress(OSError):
            beside.unlink()


def write_text(path: Path | str, text: str) -> None:
    """Write a text file, whole or not at all."""
    with write_beside(path) as beside:
        beside.write_text(text, encoding="utf-8")

"""Files written atomically: to a temporary file, which is then renamed."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextlib.contextmanager
def write_atomically(path: Path | str) -> Iterator[Path]:
    """A temporary file in the folder of `path`; renamed to `path` when the block ends, removed when it raises.

    It has the suffix of `path`, by which some writers choose the format.

    Raises
    ------
    AbraceError
        If the folder cannot be made or written to.
    """
    path = Path(path)
    temporary = path.parent / f".{os.getpid()}.{path.name}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise AbraceError(f"cannot write {path}: {error.strerror}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def write_text(path: Path | str, text: str) -> None:
    """Write a text file atomically, in UTF-8."""
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")

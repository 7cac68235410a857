"""Files that packages install, found by name; files written atomically: to a temporary file, which is then renamed."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator


def find_file(name: str, package: str, folder: str, ending: str, kind: str) -> Path:
    """A file by its path, or by its name among the files that a package installs.

    Parameters
    ----------
    name
        A path, with a "/" or the ending, or the name of an installed file without its ending.
    package, folder
        Where the installed files are: a folder in the package's share directory.
    ending
        Of the installed files, such as ".yaml".
    kind
        What the error calls such a file.

    Raises
    ------
    AbraceError
        If there is no such file; names the installed ones.
    """
    if name.endswith(ending) or "/" in name:
        if not Path(name).is_file():
            raise AbraceError(f"{kind} file {name}: no such file")
        return Path(name)
    from ament_index_python.packages import get_package_share_directory  # part of ROS, which only nodes need

    installed = Path(get_package_share_directory(package)) / folder
    path = installed / f"{name}{ending}"
    if not path.is_file():
        names = ", ".join(sorted(entry.name.removesuffix(ending) for entry in installed.glob(f"*{ending}")))
        raise AbraceError(f"{kind} {name!r}: unknown, expected a file ending in {ending} or one of {names}")
    return path


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

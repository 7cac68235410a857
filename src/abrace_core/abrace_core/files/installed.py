# SPDX-License-Identifier: Apache-2.0
"""Files that packages install: rigs, weights and campaigns, by their names. No ROS is needed to find them."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from abrace_core import AbraceError
from abrace_core.files.suggestion import did_you_mean


def find_file(name: str, package: str, folder: str, ending: str, kind: str) -> Path:
    """A file by its path, or by its name among the files that a package installs.

    A path has a "/" or the `ending`. Installed files are in a `folder` of the share directory of the `package`, or of
    its source; errors call them a `kind`.

    Raises
    ------
    AbraceError
        If there is no such file; names the installed ones.
    """
    if name.endswith(ending) or "/" in name:
        try:
            if not Path(name).is_file():
                is_folder = Path(name).is_dir()
                what = "a folder, expected a file" if is_folder else f"no such file{_near(Path(name), ending)}"
                raise AbraceError(f"{kind} file {name}: {what}")
        except OSError as error:  # a name that is too long, a folder that may not be read
            raise AbraceError(f"{kind} file {name}: {error.strerror}") from error
        return Path(name)
    installed = _installed(package, folder)
    path = installed / f"{name}{ending}"
    names = sorted(entry.name.removesuffix(ending) for entry in installed.glob(f"*{ending}"))
    if name not in names:
        raise AbraceError(
            f"{kind} {name!r}: unknown, expected a file ending in {ending} or one of {', '.join(names)}"
            f"{did_you_mean(name, names)}"
        )
    return path


def _near(path: Path, ending: str) -> str:
    """A suggestion for a missing file: a similar name in the same folder."""
    return did_you_mean(path.name, [entry.name for entry in path.parent.glob(f"*{ending}") if entry.is_file()])


def _installed(package: str, folder: str) -> Path:
    """A folder of a package's share directory, found from where its modules are installed, or of its source."""
    found = importlib.util.find_spec(package)
    if found is None or found.origin is None:
        raise AbraceError(f"package {package}: not found, expected it on the Python path")
    modules = Path(found.origin).resolve().parent
    shared = [parent / "share" / package / folder for parent in modules.parents]
    return next((place for place in shared if place.is_dir()), modules.parent / folder)

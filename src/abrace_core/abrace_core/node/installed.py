"""Files that packages install: rigs, weights and campaigns, by their names."""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from abrace_core.errors import AbraceError


def find_file(name: str, package: str, folder: str, ending: str, kind: str) -> Path:
    """A file by its path, or by its name among the files that a package installs.

    A path has a "/" or the `ending`. Installed files are in a `folder` of the package's share directory; errors call
    them a `kind`.

    Raises
    ------
    AbraceError
        If there is no such file; names the installed ones.
    """
    if name.endswith(ending) or "/" in name:
        if not Path(name).is_file():
            raise AbraceError(f"{kind} file {name}: no such file")
        return Path(name)
    installed = Path(get_package_share_directory(package)) / folder
    path = installed / f"{name}{ending}"
    if not path.is_file():
        names = ", ".join(sorted(entry.name.removesuffix(ending) for entry in installed.glob(f"*{ending}")))
        raise AbraceError(f"{kind} {name!r}: unknown, expected a file ending in {ending} or one of {names}")
    return path

# SPDX-License-Identifier: Apache-2.0
"""The base of all packages, without ROS, in rooms; and the exceptions whose message is for the user."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__version__ = "1.0.0"


def public(
    package: str, names: Mapping[str, str] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package, so that `dir` and tab completion tell what it has.

    Parameters
    ----------
    package
        Its name.
    names
        By module the names there, separated by spaces; None: the package's own modules. Each is imported when it is
        used.
    """
    modules = {name: module for module, several in (names or {}).items() for name in several.split()}

    def known() -> list[str]:
        import pkgutil

        found = importlib.import_module(package)
        own = [name for name, each in vars(found).items() if getattr(each, "__module__", "") == package]
        rooms = [each.name for each in pkgutil.iter_modules(found.__path__)] if names is None else []
        return sorted(name for name in {*modules, *own, *rooms} if not name.startswith("_"))

    def get(name: str) -> Any:
        if name in modules:
            return getattr(importlib.import_module(modules[name]), name)
        if names is None and not name.startswith("_") and name in known():
            return importlib.import_module(f"{package}.{name}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return get, known


class AbraceError(Exception):
    """An input of the user is wrong: the message says what, where, and what was expected.

    A node's `main` prints the message as one line and exits with code 2.
    """


class RunFailed(AbraceError):  # noqa: N818
    """Something failed at run time, though the user's input may be right: the exit code is 1."""


__getattr__, __dir__ = public(__name__)

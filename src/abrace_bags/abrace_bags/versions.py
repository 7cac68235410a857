"""Versions of what records, for the bag."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("abrace_core", "abrace_interfaces", "mcap", "numpy", "rclpy")


def installed_versions() -> dict[str, str]:
    """Versions of Python and of the packages that matter to a bag; those that are not found are left out."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        for name in (package, f"ros-jazzy-{package}"):
            try:
                found[package] = version(name)
                break
            except PackageNotFoundError:
                continue
    return found

# SPDX-License-Identifier: Apache-2.0
"""What a shell completes behind `abrace`: packages, their executables, campaigns; options and files by themselves.

The shell starts the command with the variable _ARGCOMPLETE to learn it (`docs/installation.md`).
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from abrace.processes.group import executables, packages_with_nodes, prefixes
from abrace_core import AbraceError

if TYPE_CHECKING:
    import argparse


def complete(parser: argparse.ArgumentParser) -> None:
    """Complete a shell's command line by the `parser`'s arguments, and end the process; otherwise do nothing."""
    if "_ARGCOMPLETE" not in os.environ:
        return
    import argcomplete  # imports for a tenth of a second

    argcomplete.autocomplete(parser, always_complete_options=False)


def packages(**_: Any) -> set[str]:
    """The packages that `abrace run` knows."""
    return packages_with_nodes()


def nodes(parsed_args: argparse.Namespace, **_: Any) -> set[str]:
    """The executables of the package in `parsed_args`."""
    return executables(parsed_args.package)


def campaigns(prefix: str, **_: Any) -> list[str]:
    """Campaigns by name, and files and folders that begin with `prefix`."""
    return _named(prefix, "share/abrace/campaigns")


def steps(parsed_args: argparse.Namespace, **_: Any) -> list[str]:
    """The steps of the campaign in `parsed_args`."""
    from abrace_core.files.config_file import read_mapping
    from abrace_core.files.installed import find_file

    try:
        content = read_mapping(find_file(parsed_args.file, "abrace", "campaigns", ".yaml", "campaign"), "campaign")
    except AbraceError:
        return []
    steps = content.get("steps")
    return [str(step["name"]) for step in steps if "name" in step] if isinstance(steps, list) else []


def benchmarks(prefix: str, **_: Any) -> list[str]:
    """Benchmarks and rigs by name, and files and folders that begin with `prefix`."""
    return _named(prefix, "share/abrace_studies/benchmarks", "share/abrace_plant/config")


def _named(prefix: str, *places: str) -> list[str]:
    from argcomplete.completers import FilesCompleter

    folders = [folder / place for folder in prefixes() for place in places]
    names = {path.stem for folder in folders for path in folder.glob("*.yaml")}
    return [*sorted(names), *FilesCompleter(["yaml"])(prefix)]

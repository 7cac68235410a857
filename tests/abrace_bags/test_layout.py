# SPDX-License-Identifier: Apache-2.0
"""Layout of the package: what a bag passes through when it is read."""

from __future__ import annotations

import ast
from pathlib import Path

import mcap.records

import abrace_bags

PACKAGE = Path(abrace_bags.__file__).parent


def module_path(name: str) -> Path | None:
    """File of a module of the package; None for a subpackage and for other packages."""
    path = PACKAGE.joinpath(*name.split(".")[1:]).with_suffix(".py")
    return path if name.startswith("abrace_bags.") and path.is_file() else None


def imported(path: Path) -> set[str]:
    """Modules that a module imports with itself, so not for types alone, nor for other storages than MCAP."""
    found = set()
    to_visit: list[ast.AST] = [ast.parse(path.read_text())]
    while to_visit:
        node = to_visit.pop()
        if isinstance(node, ast.FunctionDef):
            continue
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            to_visit += node.orelse
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            found |= {str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)}
        to_visit += ast.iter_child_nodes(node)
    return found


def modules_from(name: str) -> set[str]:
    """A module of the package and those that it imports, they in turn too."""
    modules: set[str] = set()
    to_read = {name}
    while to_read:
        module = to_read.pop()
        path = module_path(module)
        if path is not None:
            modules.add(module)
            to_read |= imported(path) - modules
    return modules


def test_reading_an_mcap_bag_passes_at_most_nine_modules() -> None:
    modules = modules_from("abrace_bags.reader")
    assert "abrace_bags.mcap.records" in modules, "the walk finds what is imported in turn"
    assert len(modules) <= 9, sorted(modules)


def test_no_class_has_the_name_of_a_record_of_mcap() -> None:
    classes = {
        node.name
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef)
    }
    assert "McapFile" in classes
    assert not classes & {kind.__name__ for kind in mcap.records.McapRecord.__subclasses__()}

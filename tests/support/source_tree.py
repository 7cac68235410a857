# SPDX-License-Identifier: Apache-2.0
"""The packages in src, their modules, and what each imports: for the tests of the project itself."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
FLOORS = {
    "abrace_core": 1,
    "abrace_node": 2,
    "abrace_bags": 3,
    "abrace_plant": 4,
    "abrace_sysid": 4,
    "abrace_lqg": 4,
    "abrace": 5,
    "abrace_studies": 5,
    "abrace_bringup": 6,
}
"""A package imports itself and packages of lower layers, never one of its own layer; but see MAY."""
MAY = {("abrace", "abrace_studies")}
"""The roof uses the studies where they are installed."""


@dataclass(frozen=True)
class Module:
    """A module: its dotted name, its file, the dotted names that it imports, and the text constants in it.

    `imports` has those for types alone as well, `runs` has not; both have those inside functions.
    """

    name: str
    path: Path
    imports: frozenset[str] = field(repr=False)
    runs: frozenset[str] = field(repr=False)
    texts: frozenset[str] = field(repr=False)

    @property
    def package(self) -> str:
        """The package that it is in."""
        return self.name.partition(".")[0]

    @property
    def subpackage(self) -> str:
        """The folder that the module is in; a module at the top of its package is a subpackage of its own."""
        parts = self.name.split(".")
        return ".".join(parts[:2])


def read_module(path: Path, name: str) -> Module:
    """A module from its source. `from package import name` imports the module of that name where there is one."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imports = _imports(tree)
    texts = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []
    return Module(name, path, frozenset(imports), frozenset(_imports(tree)), frozenset(texts))


def _imports(tree: ast.AST) -> set[str]:
    imports = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            imports |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return imports


@cache
def modules_of(package: str) -> list[Module]:
    """All modules of a package; a folder's `__init__` has the folder's name."""
    top = ROOT / "src" / package
    modules = []
    for path in sorted((top / package).rglob("*.py")):
        parts = list(path.relative_to(top).with_suffix("").parts)
        if parts[-1] == "__init__":
            parts.pop()
        modules.append(read_module(path, ".".join(parts)))
    return modules


@cache
def all_modules() -> dict[str, Module]:
    """The modules of all packages, by name: parsed by the first test that asks, not by every process that collects."""
    return {module.name: module for package in FLOORS for module in modules_of(package)}


def reached_by_launch() -> set[str]:
    """Names of abrace's modules that launch files import, directly or indirectly."""
    modules, found = all_modules(), set()
    files = [read_module(path, path.stem) for path in sorted((ROOT / "src").glob("*/launch/*.py"))]
    new = {name for file in files for name in file.imports if name in modules}
    while new:
        found |= new
        new = {name for each in new for name in modules[each].imports if name in modules} - found
    return found


def ring(arrows: dict[str, set[str]]) -> list[str]:
    """A cycle in the graph, as names, the first one repeated at the end; empty: no cycle."""
    finished: set[str] = set()

    def follow(name: str, way: list[str]) -> list[str]:
        if name in way:
            return [*way[way.index(name) :], name]
        if name in finished:
            return []
        for other in sorted(arrows.get(name, ())):
            if found := follow(other, [*way, name]):
                return found
        finished.add(name)
        return []

    for name in sorted(arrows):
        if found := follow(name, []):
            return found
    return []

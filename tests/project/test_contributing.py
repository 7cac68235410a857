# SPDX-License-Identifier: Apache-2.0
"""CONTRIBUTING names layers, subpackages and modules that exist, and all of them."""

import ast
import re

import pytest
from source_tree import FLOORS, MODULES, ROOT

PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
PLACEHOLDERS = {"NAME", "PACKAGE", "MODULE"}
PATHS = sorted(
    {
        span
        for span in re.findall(r"`([\w./]+)`", PAGE)
        if ("/" in span or span.endswith(".py")) and not PLACEHOLDERS & set(re.findall(r"[A-Z]+", span))
    }
)
FILES = [str(path.relative_to(ROOT)) for path in ROOT.glob("src/*/*/**/*") if "__pycache__" not in path.parts]


def subpackages() -> set[str]:
    folders = {
        module.path.parent for module in MODULES.values() if module.path.parent.parent.parent.parent == ROOT / "src"
    }
    return {f"{folder.parent.name}/{folder.name}" for folder in folders if folder.name != "nodes"}


@pytest.mark.parametrize("path", PATHS)
def test_what_is_named_exists(path):
    inside = f"/{path}"
    assert (ROOT / path).exists() or any(file.endswith(inside) for file in FILES), path


def test_every_layer_and_every_subpackage_is_named():
    layers = re.findall(r"^\| (\d) \| `(\w+)` \|", PAGE, re.MULTILINE)
    assert {package: int(layer) for layer, package in layers} == FLOORS
    table = PAGE.partition("## Subpackages")[2].partition("## Where it goes")[0]
    assert set(re.findall(r"`(\w+/\w+)`", table)) == subpackages()


@pytest.mark.parametrize(
    "module", [module for module in MODULES.values() if module.path.name == "__init__.py"], ids=str
)
def test_every_subpackage_says_what_it_is_for(module):
    text = module.path.read_text(encoding="utf-8")
    assert ast.get_docstring(ast.parse(text)), f"{module.path} has no docstring"

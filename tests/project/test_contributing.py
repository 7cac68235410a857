"""CONTRIBUTING names floors, rooms and modules that exist, and every room."""

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


def rooms() -> set[str]:
    folders = {
        module.path.parent for module in MODULES.values() if module.path.parent.parent.parent.parent == ROOT / "src"
    }
    return {f"{folder.parent.name}/{folder.name}" for folder in folders if folder.name != "nodes"}


@pytest.mark.parametrize("path", PATHS)
def test_what_is_named_exists(path):
    inside = f"/{path}"
    assert (ROOT / path).exists() or any(file.endswith(inside) for file in FILES), path


def test_every_floor_and_every_room_is_named():
    floors = re.findall(r"^\| (\d) \| `(\w+)` \|", PAGE, re.MULTILINE)
    assert {package: int(floor) for floor, package in floors} == FLOORS
    table = PAGE.partition("## Rooms")[2].partition("## Where it goes")[0]
    assert set(re.findall(r"`(\w+/\w+)`", table)) == rooms()


@pytest.mark.parametrize(
    "module", [module for module in MODULES.values() if module.path.name == "__init__.py"], ids=str
)
def test_every_room_says_what_it_is_for(module):
    text = module.path.read_text(encoding="utf-8")
    assert text.startswith('"""'), f"{module.path} has no docstring"

# SPDX-License-Identifier: Apache-2.0
"""What the documents say is so: files that are named, campaigns, docstrings; every page is in the site."""

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from documents import PAGES, ROOT

from abrace.campaign.plan import check_campaign


def test_files_that_are_named_exist():
    named = r"`((?:src|requirements|benchmarks|docs|ros2_ws)/(?![\w./]*(?:PACKAGE|NAME))[\w./-]+)`"
    for page in PAGES:
        for target in re.findall(named, page.read_text()):
            assert (ROOT / target).exists(), f"{page.name}: {target}"


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*/campaign.yaml")), ids=lambda path: path.parent.name)
def test_the_campaigns_of_the_examples_are_whole(path):
    assert check_campaign(path).text()


EXAMPLES = sorted(path.parent for path in (ROOT / "examples").glob("*/README.md"))


def test_eight_examples_have_a_page_a_picture_and_a_test():
    assert [int(path.name.partition("_")[0]) for path in EXAMPLES] == list(range(1, 9))
    listed = (ROOT / "docs/examples.md").read_text(encoding="utf-8")
    for path in EXAMPLES:
        (picture,) = path.glob("picture.*")
        assert f"({picture.name})" in (path / "README.md").read_text(encoding="utf-8")
        assert f"`{path.name}`" in listed
        assert [*path.glob("test/test_*.py")] or path.name == "4_notebook", "in test_interactive"


def test_every_page_is_linked_from_the_index_with_a_line_that_says_what_it_is():
    index = (ROOT / "docs/index.md").read_text()
    for page in (ROOT / "docs").glob("*.md"):
        assert (
            re.search(rf"^\| \[[^]]+\]\({page.name}\) \| .{{8,}} \|$", index, re.MULTILINE) or page.stem == "index"
        ), page


def test_the_citation_has_the_version_and_the_licence_of_the_packages():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    for package in (ROOT / "src").glob("*/package.xml"):
        text = package.read_text()
        assert f"<version>{citation['version']}</version>" in text, package
        assert f"<license>{citation['license']}</license>" in text, package
    assert {"cff-version", "message", "title", "authors"} <= set(citation)


def test_the_drawings_are_what_the_code_draws(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs/drawings")
    drawings = importlib.import_module("draw").DRAWINGS
    assert len(drawings) >= 10
    for name, draw in drawings.items():
        kept = (ROOT / f"docs/figures/{name}.svg").read_text(encoding="utf-8")
        assert kept == draw().text(), f"{name}: run python docs/drawings/draw.py"


def test_every_picture_is_shown_on_a_page():
    shown = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert not {path.name for path in (ROOT / "docs/figures").iterdir() if f"figures/{path.name})" not in shown}


LIBRARIES = [
    path
    for package in (
        "abrace_core",
        "abrace_bags",
        "abrace_plant",
        "abrace_sysid",
        "abrace_lqg",
        "abrace_studies",
        "abrace",
    )
    for path in sorted((ROOT / "src" / package / package).rglob("*.py"))
    if path.parent.name != "nodes"
]


def undocumented(path: Path) -> Iterator[str]:
    """The functions and methods of a module of which an argument's name does not stand in the docstring."""
    module = ast.parse(path.read_text()).body
    methods = [
        entry for each in module if isinstance(each, ast.ClassDef) and each.name[0] != "_" for entry in each.body
    ]
    for function in [*module, *methods]:
        if isinstance(function, ast.FunctionDef) and not function.name.startswith("_"):
            text = ast.get_docstring(function) or ""
            arguments = {argument.arg for argument in (*function.args.args, *function.args.kwonlyargs)}
            missing = {name for name in arguments - {"self", "cls", "path"} if not re.search(rf"\b{name}\b", text)}
            if missing and "as in `" not in text and "as `" not in text:
                yield f"{path.relative_to(ROOT)}, {function.name}: {', '.join(sorted(missing))}"


def test_public_functions_say_what_their_arguments_are():
    """Or as in which other function they are."""
    assert not [each for path in LIBRARIES for each in undocumented(path)]

# SPDX-License-Identifier: Apache-2.0
"""What the documents say is so: files that are named, campaigns, docstrings; every page is in the site."""

import ast
import re

import pytest
import yaml
from documents import PAGES, ROOT

from abrace.campaign import drives, file, tasks
from abrace.campaign.file import load_campaign
from abrace_core.config_file import Checked


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_that_are_named_exist(page):
    for target in re.findall(
        r"`((?:src|requirements|benchmarks|docs|ros2_ws)/(?![\w./]*(?:PACKAGE|NAME))[\w./-]+)`", page.read_text()
    ):
        assert (ROOT / target).exists(), f"{page.name}: {target}"


def test_the_campaigns_in_the_page_are_valid_ones(tmp_path):
    examples = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs/campaigns.md").read_text(), re.DOTALL)
    for example, steps in zip(examples, (7, 4, 3, 1, 3, 2, 10, 1), strict=True):
        (tmp_path / "campaign.yaml").write_text(example)
        assert len(load_campaign(tmp_path / "campaign.yaml").steps) == steps


def test_every_key_of_a_campaign_file_is_named_in_its_page():
    page = (ROOT / "docs/campaigns.md").read_text()
    parts = [file._Campaign, file._Step, *vars(drives).values(), *vars(tasks).values()]
    schemas = [part for part in parts if isinstance(part, type) and issubclass(part, Checked)]
    keys = {field.alias or key for schema in schemas for key, field in schema.model_fields.items()} | {"matrix"}
    assert {"low_cut", "force_limit", "damping_kept", "run", "validate"} <= keys
    assert not {key for key in keys if not re.search(rf"\| .*`{key}`", page)}


def test_every_page_is_linked_from_the_index_with_a_line_that_says_what_it_is():
    index = (ROOT / "docs/index.md").read_text()
    for page in (ROOT / "docs").glob("*.md"):
        assert (
            re.search(rf"^\| \[[^]]+\]\({page.name}\) \| .{{8,}} \|$", index, re.MULTILINE) or page.stem == "index"
        ), page


def test_every_page_is_in_the_site():
    listed = re.findall(r"^\w[\w/]*$", (ROOT / "docs/index.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(
        [*(page.stem for page in (ROOT / "docs").glob("*.md") if page.stem != "index"), "packages",
         *(f"project/{page.stem}" for page in (ROOT / "docs/project").glob("*.md"))]
    )  # fmt: skip


def test_every_figure_is_on_a_page():
    text = "".join(page.read_text() for page in [*PAGES, *(ROOT / "docs").glob("*.ipynb")])
    assert not [path.name for path in (ROOT / "docs/figures").iterdir() if path.name not in text]


def test_the_citation_has_the_version_and_the_licence_of_the_packages():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    for package in (ROOT / "src").glob("*/package.xml"):
        text = package.read_text()
        assert f"<version>{citation['version']}</version>" in text, package
        assert f"<license>{citation['license']}</license>" in text, package
    assert {"cff-version", "message", "title", "authors"} <= set(citation)


def test_the_citation_names_the_paper_as_the_references_do():
    paper, article = yaml.safe_load((ROOT / "CITATION.cff").read_text())["references"]
    text = " ".join((ROOT / "docs/references.md").read_text().split())
    for each in (paper, article):
        assert {"type", "title", "authors"} <= set(each), "keys that the format asks for"
        assert each["title"] in text
    pages = f"*{article['journal']}* {article['volume']}, {article['start']}-{article['end']}"
    assert pages in text
    assert f"*{paper['title']}.*" in text
    assert "NSC88-2211-E032-002" in paper["notes"]
    assert paper["url"].removeprefix("http://") in text


LIBRARIES = [
    path
    for package in ("abrace_core", "abrace_bags", "abrace_plant", "abrace_sysid", "abrace_lqg", "abrace")
    for path in sorted((ROOT / "src" / package / package).rglob("*.py"))
    if path.parent.name not in ("node", "nodes")
]


@pytest.mark.parametrize("path", LIBRARIES, ids=lambda path: str(path.relative_to(ROOT / "src")))
def test_public_functions_say_what_their_arguments_are(path):
    """Each argument's name stands in the docstring, or that says as in which other function they are."""
    undocumented = []
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
                undocumented.append(f"{function.name}: {', '.join(sorted(missing))}")
    assert not undocumented

"""What the documents say is so: links, commands, campaigns, pages made from the source."""

import ast
import importlib.util
import re
from pathlib import Path

import pytest

from abrace.campaign import drives, file, tasks
from abrace.campaign.file import load_campaign
from abrace.processes.group import find_executable
from abrace_core.config_file import Checked
from abrace_core.node import Parameter

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]


def module_from(path: Path):
    specification = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def table_of(package: str, executable: str) -> dict[str, Parameter]:
    """A node's own parameters, and those that its kind adds, by name."""
    script = find_executable(package, executable)
    assert script.is_file()
    page = (ROOT / "docs/nodes.md").read_text()
    section = page.partition(f"\n## {executable}\n")[2].partition("\n## ")[0]
    return dict.fromkeys(re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE))


@pytest.mark.parametrize("name", ["nodes", "states"])
def test_pages_made_from_the_code_are_what_it_says(name):
    written = module_from(ROOT / f"docs/write_{name}.py").page()
    assert (ROOT / f"docs/{name}.md").read_text() == written, (
        f"docs/{name}.md is out of date: run python docs/write_{name}.py"
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)", page.read_text()):
        assert target.startswith("http") or (page.parent / target).exists(), f"{page.name}: {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_that_are_named_exist(page):
    for target in re.findall(
        r"`((?:src|requirements|benchmarks|docs|ros2_ws)/(?![\w./]*(?:PACKAGE|NAME))[\w./-]+)`", page.read_text()
    ):
        assert (ROOT / target).exists(), f"{page.name}: {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_nodes_in_commands_exist_and_take_the_parameters(page):
    for package, executable, arguments in re.findall(r"abrace run (\w+) (\w+)(.*)", page.read_text()):
        known = table_of(package, executable)
        for name in re.findall(r"-p (\w+):=", arguments):
            assert name in known, f"{page.name}: abrace run {package} {executable} -p {name}"


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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_arguments_in_launch_commands_exist(page):
    text = (ROOT / "docs/launch.md").read_text()
    known = set(re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE))
    for name, arguments in re.findall(r"ros2 launch abrace_bringup (\S+)((?:.|\\\n)*)", page.read_text()):
        assert (ROOT / "src/abrace_bringup/launch" / name).is_file() or name == "FILE", name
        assert set(re.findall(r"(\w+):=", arguments)) <= known, f"{page.name}: {name}"


@pytest.mark.parametrize("page", ["bags", "identification"])
def test_python_examples_name_what_there_is(page):
    examples = re.findall(r"```python\n(.*?)```", (ROOT / f"docs/{page}.md").read_text(), re.DOTALL)
    assert examples
    for node in ast.walk(ast.parse("".join(examples))):
        if isinstance(node, ast.ImportFrom):
            module = importlib.import_module(node.module)
            for alias in node.names:
                assert hasattr(module, alias.name), f"{node.module}.{alias.name}"


def test_every_page_is_linked_from_the_readme():
    readme = (ROOT / "README.md").read_text()
    for page in PAGES[1:]:
        assert str(page.relative_to(ROOT)) in readme, page.name


def test_every_page_is_in_the_site():
    listed = re.findall(r"^\w[\w/]*$", (ROOT / "docs/index.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(
        [*(page.stem for page in (ROOT / "docs").glob("*.md") if page.stem != "index"), "packages",
         *(f"project/{page.stem}" for page in (ROOT / "docs/project").glob("*.md"))]
    )  # fmt: skip


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

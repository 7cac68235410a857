# SPDX-License-Identifier: Apache-2.0
"""The reference is whole: every name that a user can give or read is on its page, found here in another way."""

import ast
import importlib
import re
from xml.etree import ElementTree

import pytest
import write_errors
import write_files
from documents import GENERATED, ROOT

import abrace
from abrace_core.config_file import Checked
from abrace_core.errors import AbraceError
from abrace_core.safety.rig_safety import State

SOURCES = write_errors.sources()
TABLES = {path: tree for path, tree in SOURCES.items() if path.parent.name in ("nodes", "node")}


def page(name: str) -> str:
    return (ROOT / f"docs/{name}.md").read_text()


def calls(trees, *names: str):
    """The calls of functions and methods of these names."""
    for tree in trees:
        for node in ast.walk(tree):
            if isinstance(node, ast.Call):
                called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                if called in names:
                    yield node


def texts(nodes) -> set[str]:
    """The texts among first arguments."""
    return {node.args[0].value for node in nodes if node.args and isinstance(node.args[0], ast.Constant)}


@pytest.mark.parametrize("name", GENERATED)
def test_pages_made_from_the_code_are_what_it_says(name):
    written = importlib.import_module(f"write_{name}").page()
    assert page(name) == written, f"docs/{name}.md is out of date: run python docs/write_{name}.py, or make reference"


def test_every_parameter_is_in_the_reference():
    names = texts(calls(TABLES.values(), "Parameter"))
    assert {"lockstep", "thread_priority", "rate_limit", "record"} <= names
    assert not {name for name in names if f"| `{name}` |" not in page("nodes")}


def test_every_topic_and_service_is_in_the_reference():
    """Those that the nodes may use by the security policy, which `tests/graph` compares with running nodes."""
    policy = ElementTree.parse(ROOT / "src/abrace_bringup/config/security_policy.xml")
    used = {entry.text for entry in policy.iter("topic")} | {entry.text for entry in policy.iter("action")}
    assert {"response", "/emergency_stop", "play_ground_motion"} <= used
    used = {name for name in used if not name.endswith("/transition_event") and "*" not in name}
    assert not {name for name in used if f"`{name}`" not in page("topics")}
    served = {
        node.args[1].value
        for node in calls(SOURCES.values(), "create_service")
        if isinstance(node.args[1], ast.Constant)
    }
    assert "~/zero_sensors" in served
    assert not {name for name in served if f"| `{name}` |" not in page("topics")}


def test_every_argument_and_option_is_in_the_reference():
    of_launch = texts(calls(SOURCES.values(), "Argument"))
    assert {"bag", "patience"} <= of_launch
    assert not {name for name in of_launch if f"| `{name}` |" not in page("commands")}
    trees = [tree for path, tree in SOURCES.items() if path.parent.name == "abrace" or path.stem == "emulator"]
    options = {name for name in texts(calls(trees, "add_argument")) if name.startswith("--")}
    assert {"--check", "--exaggeration", "--fault"} <= options
    assert not {name for name in options if f"`{name}" not in page("commands")}
    for name in texts(calls(trees, "add_parser")):
        assert re.search(rf"^### abrace (?:\w+ )?{name}(?: |$)", page("commands"), re.MULTILINE) or name == "bag", name


def schemas() -> list[type]:
    """The schemas of all files, wherever they are."""
    classes = [(path, node) for path, tree in SOURCES.items() for node in tree.body if isinstance(node, ast.ClassDef)]
    names = {"Checked"}
    while True:
        more = {node.name for _, node in classes if {ast.unparse(base) for base in node.bases} & names}
        if more <= names:
            break
        names |= more
    modules = {path: ".".join(path.relative_to(ROOT / "src").with_suffix("").parts[1:]) for path, _ in classes}
    found = [getattr(importlib.import_module(modules[path]), node.name) for path, node in classes if node.name in names]
    return [each for each in found if issubclass(each, Checked)]


def test_every_key_of_every_file_is_in_the_reference():
    known = schemas()
    assert len(known) > 40
    keys = {field.alias or key for schema in known for key, field in schema.model_fields.items()}
    assert {"storey_stiffness", "word_order", "gain_margin", "sensor_seed"} <= keys
    listed = {
        part for key in re.findall(r"^\| `(\S+)` \|", page("files"), re.MULTILINE) for part in re.split(r"\.|\[\]", key)
    }
    listed |= {name for line in re.findall(r"`\*`: ([^|]*?)(?: or| \|)", page("files")) for name in line.split(", ")}
    assert not keys - listed


def test_every_key_of_every_file_has_a_meaning_and_no_meaning_is_left_over():
    files = (*write_files.WRITTEN_BY_PEOPLE, *write_files.WRITTEN_BY_ABRACE)
    keys = [
        (each.title, row.key) for each in files for at, of in each.schemas.items() for row in write_files.rows(of, at)
    ]
    used = {write_files.entry(title, key) for title, key in keys}  # raises where there is none
    given = {(heading, key): phrase for heading, part in write_files.meanings().items() for key, phrase in part.items()}
    assert len(keys) > 300
    assert not set(given) - used, "meanings of keys that there are not"
    assert not [place for place, phrase in given.items() if len(phrase) < 6 or "|" in phrase]
    with pytest.raises(AbraceError, match="Rig file: sample_rtae: no meaning"):
        write_files.entry("Rig file", "sample_rtae")


def test_every_key_that_people_write_is_explained_on_a_page():
    """In backticks, on a page that is no list made from the code."""
    pages = [path for path in (ROOT / "docs").glob("*.md") if path.stem not in GENERATED]
    explained = " ".join(
        text for path in pages for text in re.findall(r"`[^`\n]+`|^ {4}.*$", path.read_text(), re.MULTILINE)
    )
    places = [(place, schema) for each in write_files.WRITTEN_BY_PEOPLE for place, schema in each.schemas.items()]
    rows = {
        row.key.rpartition(".")[2].rstrip("[]") for place, schema in places for row in write_files.rows(schema, place)
    }
    assert len(rows) > 100
    assert not {key for key in rows - {"*"} if not re.search(rf"\b{re.escape(key)}\b", explained)}


def test_every_error_is_in_the_reference():
    found = 0
    shown = " ".join(page("errors").split())
    for path in SOURCES:
        for words in re.findall(
            r'raise (?:AbraceError|DeviceError|RunFailed|NodeDied)\(\s*f?"([^"{\\]{8,})', path.read_text()
        ):
            assert " ".join(words.split()) in shown, f"{path.name}: {words}"
            found += 1
    assert found > 100
    for name in ("AbraceError", "DeviceError", "RunFailed", "NodeDied"):
        assert f"| `{name}` |" in page("errors")


def test_every_name_of_import_abrace_and_every_package_is_in_the_reference():
    for name in abrace.__all__:
        assert re.search(rf"\b{name}\b", page("python")), name
    packages = (ROOT / "docs/packages.rst").read_text()
    for folder in (ROOT / "src").glob("*/*/__init__.py"):
        if folder.parent.name != "launch":
            assert re.search(rf"^   {folder.parent.name}$", packages, re.MULTILINE), folder


def test_messages_in_troubleshooting_are_those_of_the_code():
    """Every piece of a message between `...` is a text somewhere in the source."""
    said = {
        node.value
        for tree in SOURCES.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    states = [state.words for state in State]
    corpus = "\n".join([*said, *states, page("errors"), (ROOT / "ros2_ws/setup.bash").read_text()])
    symptoms = re.findall(r"^\| ([^|]+) \|", page("troubleshooting"), re.MULTILINE)
    messages = [message for symptom in symptoms for message in re.findall(r"`([^`]+)`", symptom)]
    pieces = [piece.strip() for message in messages for piece in re.split(r"\.\.\.|; |: ", message)]
    ours = [piece for piece in pieces if len(piece) > 5 and piece not in NOT_OURS]
    assert len(ours) > 50
    assert not [piece for piece in ours if piece not in corpus]


NOT_OURS = ("No module named 'mcap'", "open_and_lock_file failed", "/dev/shm", "make setup", "Address already in use")
"""Messages of Python, the middleware and the operating system, and other words in code."""

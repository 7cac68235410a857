# SPDX-License-Identifier: Apache-2.0
"""The reference is whole: every name that a user can give or read is on its page, found here in another way."""

import ast
import importlib
import re

import pytest
import state_table
import write_architecture
import write_files
import write_measured
from documents import GENERATED, PAGES, ROOT, blocks, sources
from policy import permissions
from source_tree import FLOORS

import abrace
from abrace_core import AbraceError
from abrace_core.files.config_file import Checked
from abrace_core.files.options import Options
from abrace_core.safety.rig_safety import State
from abrace_plant.devices import layout


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


def test_the_house_is_drawn_as_the_imports_are():
    drawn = write_architecture.PICTURE.read_text()
    assert drawn == write_architecture.house(), "run python docs/write_architecture.py"
    assert set(re.findall(r">(abrace\w*)<", drawn)) == set(FLOORS)
    assert ">bags, node, core<" in drawn, "what abrace_plant imports"


def test_the_states_are_those_that_were_written_by_hand():
    table = page("rig").partition("### Every event in every state")[2].partition("## Interlocks")[0]
    rows = "\n".join(line for line in table.splitlines() if line.startswith("|") and not line.startswith("|--"))
    assert state_table.cells(rows.replace("*", "")) == state_table.cells(state_table.EXPECTED)


def test_every_parameter_is_in_the_reference():
    trees = [tree for path, tree in sources().items() if path.parent.name in ("nodes", "abrace_node")]
    names = texts(calls(trees, "Parameter"))
    assert {"lockstep", "thread_priority", "rate_limit", "record"} <= names
    assert not {name for name in names if f"| `{name}` |" not in page("nodes")}


def test_every_topic_and_service_is_in_the_reference():
    """Those that the nodes may use by the security policy, which `tests/graph` compares with running nodes."""
    acts = ("publish", "subscribe", "execute", "call")
    used = {name.removeprefix("/rig/") for rules in permissions().values() for act, name in rules if act in acts}
    assert {"response", "/emergency_stop", "play_ground_motion"} <= used
    used = {name for name in used if not name.endswith("/transition_event") and "*" not in name}
    assert not {name for name in used if f"`{name}`" not in page("topics")}
    served = {
        node.args[1].value
        for node in calls(sources().values(), "create_service")
        if isinstance(node.args[1], ast.Constant)
    }
    assert "~/zero_sensors" in served
    assert not {name for name in served if f"| `{name}` |" not in page("topics")}


def test_every_argument_and_option_is_in_the_reference():
    of_launch = texts(calls(sources().values(), "Argument"))
    assert {"bag", "patience"} <= of_launch
    assert not {name for name in of_launch if f"| `{name}` |" not in page("commands")}
    trees = [tree for path, tree in sources().items() if path.parent.name == "abrace" or path.stem == "emulator"]
    options = {name for name in texts(calls(trees, "add_argument")) if name.startswith("--")}
    assert {"--check", "--output", "--controllers"} <= options
    assert not {name for name in options if f"`{name}" not in page("commands")}
    for name in texts(calls(trees, "add_parser")):
        assert re.search(rf"^### abrace (?:\w+ )?{name}(?: |$)", page("commands"), re.MULTILINE) or name == "bag", name


def schemas() -> list[type]:
    """The schemas of all files, wherever they are."""
    classes = [(path, node) for path, tree in sources().items() for node in tree.body if isinstance(node, ast.ClassDef)]
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
    results = ("abrace.report.results", "abrace.campaign.done", "abrace_sysid.validity.finding")
    of_nodes = "abrace_core.model.controller_file"  # its keys are the parameters of the node `controller`
    known = [
        each
        for each in schemas()
        if (not issubclass(each, Options) or each.__module__ == "abrace.campaign.tasks")
        and each.__module__ not in (*results, of_nodes)  # the first are read by abrace alone
    ]
    assert len(known) > 30
    keys = {field.alias or key for schema in known for key, field in schema.model_fields.items()}
    assert {"storey_stiffness", "byte_order", "gain_margin", "sensor_seed"} <= keys
    listed = {
        part for key in re.findall(r"^\| `(\S+)` \|", page("files"), re.MULTILINE) for part in re.split(r"\.|\[\]", key)
    }
    listed |= {
        name for line in re.findall(r"`\*`: ([^|;]*?)(?: or |;| \|)", page("files")) for name in line.split(", ")
    }
    assert not keys - listed


def test_every_key_of_every_file_has_a_meaning_and_no_meaning_is_left_over():
    files = (*write_files.WRITTEN_BY_PEOPLE, write_files.MODEL_FILE)
    rows = [(each.title, row) for each in files for at, of in each.schemas.items() for row in write_files.rows(of, at)]
    keys = [(title, row.key) for title, row in rows if not row.meaning]
    used = {write_files.entry(title, key) for title, key in keys}  # raises where there is none
    given = {(heading, key): phrase for heading, part in write_files.meanings().items() for key, phrase in part.items()}
    assert len(keys) > 200
    assert not set(given) - used, "meanings of keys that there are not"
    assert not [place for place, phrase in given.items() if len(phrase) < 6 or "|" in phrase]
    with pytest.raises(AbraceError, match="Rig file: sample_rtae: no meaning"):
        write_files.entry("Rig file", "sample_rtae")


def test_numbers_are_taken_from_new_results_where_these_have_them():
    given = {"rows": [["{lqg.lqg3.gain_db:.1f} dB", "{rig.errors[0.5 mm]:.1%}"]], "text": "{margin}, {bags.kills}"}
    known = {"bags": {"kills": 50}, "rig": {"errors": {"0.5 mm": 0.05}, "unused": 1}}
    found = write_measured.updated(given, known, {"rig": {"other": 1}}, {"lqg": {"lqg3": {"gain_db": 9.24}}})
    assert found == {"lqg": {"lqg3": {"gain_db": 9.24}}, "rig": {"errors": {"0.5 mm": 0.05}}, "bags": {"kills": 50}}
    results = write_measured.Results(found, margin="9 dB", rig=write_measured.Results(found["rig"]))
    assert write_measured.shown("{margin}, {rig.errors[0.5 mm]:.1%}", results) == "9 dB, 5.0 %"
    with pytest.raises(SystemExit, match=r"^rig\.gone: neither"):
        write_measured.updated("{rig.gone}", known)


def test_numbers_that_pages_show_are_measured_ones():
    used = {name for path in PAGES for name in re.findall(r"\{\{ (\w+) \}\}", path.read_text())}
    assert "table1" in used
    assert used <= set(write_measured.numbers())
    margin = write_measured.numbers()["delay_margin"]
    assert f"whose margin is {margin}," in page("computers"), "a limit for command_timeout: read in plain text, too"


def test_the_fields_of_packets_are_those_of_the_layout():
    for part, needed in layout._NEEDED.items():
        phrase = write_files.meanings()["Layout file"][f"{part}[].field"]
        assert set(needed) <= set(re.findall(r"`(\w+)`", phrase)) <= set(layout._SPECIAL), part


def test_what_users_import_is_in_the_reference():
    """All of `import abrace` and `abrace_bags`, and what the Python of the pages imports from other packages."""
    shown = page("python")
    assert not [name for name in abrace.__all__ if not re.search(rf"\b{name}\b", shown)]
    packages = (ROOT / "docs/packages.rst").read_text()
    assert ".. automodule:: abrace\n" in packages
    assert ".. automodule:: abrace_bags\n" in packages
    examples = [path for path in (ROOT / "examples").rglob("*.py") if path.parent.name != "test"]
    python = "\n".join(
        [block.text for path in PAGES for block in blocks(path)] + [each.read_text() for each in examples]
    )
    imports = re.findall(r"^from (abrace_(?!bags )[\w.]+) import (.+)$", python, re.MULTILINE)
    used = {f"{module}.{name}" for module, names in imports for name in names.split(", ")}
    assert "abrace_node.law_node.run_law" in used
    of_abrace = {name for name in used if name.rpartition(".")[2] in abrace.__all__}
    assert not {name for name in used - of_abrace if not re.search(rf":: {re.escape(name)}$", packages, re.MULTILINE)}


def test_what_the_reference_lists_is_there():
    listed = re.findall(
        r"^\.\. auto(?:function|class):: (\S+)\.(\w+)$", (ROOT / "docs/packages.rst").read_text(), re.MULTILINE
    )
    assert len(listed) > 15
    assert not [f"{module}.{name}" for module, name in listed if not hasattr(importlib.import_module(module), name)]


def test_messages_in_troubleshooting_are_those_of_the_code():
    """Every piece of a message between `...` is a text somewhere in the source."""
    said = {
        node.value
        for tree in sources().values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    states = [state.words for state in State]
    corpus = "\n".join([*said, *states, (ROOT / "ros2_ws/setup.bash").read_text()])
    symptoms = re.findall(r"^\| ([^|]+) \|", page("troubleshooting"), re.MULTILINE)
    messages = [message for symptom in symptoms for message in re.findall(r"`([^`]+)`", symptom)]
    pieces = [piece.strip() for message in messages for piece in re.split(r"\.\.\.|; |: ", message)]
    ours = [piece for piece in pieces if len(piece) > 5 and piece not in NOT_OURS]
    assert len(ours) > 50
    assert not [piece for piece in ours if piece not in corpus]


NOT_OURS = ("No module named 'mcap'", "open_and_lock_file failed", "/dev/shm", "make setup", "Address already in use")
"""Messages of Python, the middleware and the operating system, and other words in code."""

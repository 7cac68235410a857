# SPDX-License-Identifier: Apache-2.0
"""Every file that a page shows passes its schema; output is where `test_pages.py`, which runs the rest, compares it."""

import re

import pytest
import write_nodes
from documents import EXAMPLES, GENERATED, PAGES, ROOT, Block, blocks
from page_runner import is_value, not_printed

from abrace.campaign.file import load_campaign
from abrace_core import AbraceError
from abrace_core.files.config_file import read_config
from abrace_core.files.reading import parse_yaml
from abrace_lqg.weights import Weights
from abrace_plant.devices.calibration import CalibrationFile
from abrace_plant.devices.udp import UdpFile
from abrace_plant.rig.file import _Interlocks, load_rig
from abrace_studies.benchmark.definition import load_definition

OWN_KIND = ("ni_daqmx", "my_daq")
"""Devices of the reader's."""
LANGUAGES = ("python", "yaml", "text", "matlab", "c", "{toctree}")
"""Of fenced blocks: no console, no session of Python, in which output could stand beside what prints it."""
COMMANDS = (
    *("abrace", "ros2", "make", "python", "source", "pip", "git", "sudo", "cc", "./target", "cd", "export", "openssl"),
    *("printf", "echo", "groupadd", "udevadm", "umask", "autoload"),
)
"""First words of commands."""
NEITHER = {
    "bridge": ("entry_points=",),  # lines of a setup.py and of a device file
    "computers": ("<interfaceWhiteList>",),
    "rig": ("M x'' + C x'", "sensors: ", "masses: "),
}
"""Indented blocks that are neither commands nor a whole file, by their first words."""


def yaml_of(page) -> list[str]:
    """The YAML blocks of a page, those that are indented and look like a file of ours too."""
    own = re.compile(r"(?:kind|name|channels|interlocks|building): ?[^=]*\n")
    return [
        block.text
        for block in blocks(page)
        if block.language == "yaml" or (not block.language and own.match(block.text) and "Traceback" not in block.text)
    ]


def mistake(text: str, folder) -> str:
    """What is wrong in a file; empty: nothing."""
    content = parse_yaml(text, "block")
    file = folder / "block.yaml"
    file.write_text(text)
    try:
        match content:
            case {"steps": _}:
                load_campaign(file)
            case {"cases": _}:
                load_definition(str(file))
            case {"building": _, "braces": _}:
                load_rig(file)
            case {"kind": "udp"}:
                read_config(file, UdpFile, "device")
            case {"kind": kind} if kind in OWN_KIND:
                return ""
            case {"channels": _, "commands": _}:
                read_config(file, CalibrationFile, "calibration")
            case {"measured": _, "weights": _}:
                read_config(file, Weights, "weights")
            case {"interlocks": {}}:
                _Interlocks.model_validate(content["interlocks"])
            case dict() if all("ros__parameters" in inside for inside in content.values()):
                return parameter_mistake(content)
            case _:
                return f"a file of no kind that abrace has: {text[:80]}"
    except AbraceError as error:
        return str(error)
    return ""


def parameter_mistake(content) -> str:
    """Parameters that a node does not have."""
    for name, inside in content.items():
        node = name.rpartition("/")[2]
        package = next(package for package, nodes in write_nodes.NODES.items() if node in nodes)
        known = {parameter.name for parameter in write_nodes.parameters(package, node)}
        if unknown := set(inside["ros__parameters"]) - known:
            return f"{node}: {unknown}"
    return ""


@pytest.mark.parametrize("page", [page for page in PAGES if yaml_of(page)], ids=lambda page: page.name)
def test_files_pass_their_schemas(page, tmp_path):
    wrong = [found for text in yaml_of(page) if (found := mistake(text, tmp_path))]
    assert not wrong, "\n".join(wrong)


def is_of_commands(block: Block) -> bool:
    """Whether each line is a command, sets a variable or is empty."""
    joined = re.sub(r"\\\n\s*", "", block.text)
    return all(
        line.split()[0] in COMMANDS or re.match(r"(bag|day)=", line) for line in joined.splitlines() if line.strip()
    )


@pytest.mark.parametrize("page", [*PAGES, *EXAMPLES], ids=lambda page: str(page.relative_to(ROOT)))
def test_output_stands_in_text_blocks_alone(page):
    if page.stem in GENERATED:
        return
    files, wrong = yaml_of(page), []
    for block in blocks(page):
        if block.language:
            compared = block.language != "text" or page in PAGES
            wrong += [block.text] * (block.language not in LANGUAGES or not compared)
        elif not (
            is_of_commands(block) or block.text in files or block.text.startswith(NEITHER.get(page.stem, ("\0",)))
        ):
            wrong.append(block.text)
        if re.search(r"(?m)^\s*(>>>|\$) ", block.text):
            wrong.append(block.text)
    assert not wrong, "\n".join(["neither commands nor a file; output goes into ```text:", *wrong])


@pytest.mark.parametrize(
    ("shown", "printed", "wrong"),
    [
        ("a 1.5\nb 2", "a  1.5\nnothing\nb 2 m", []),
        ("b 2\na 1", "a 1\nb 2", ["a 1"]),
        ("24 8", "124 8", ["24 8"]),
        ("24 8", "24 80", ["24 8"]),
        ("1.5", "1.52", ["1.5"]),
        ("2.3 %", "-2.3 %", ["2.3 %"]),
        ("1.5... s", "1.52 s", []),
        ("x1 ... cm", "x1 1.10\nx2 2 cm", ["x1 ... cm"]),
        ("the first line\ngoes on", "the first line goes on", []),
        ("(...) more", "(17 of 20) more", []),
        ("anything", "", ["anything"]),
    ],
)
def test_shown_lines_are_compared_word_by_word_and_in_their_order(shown, printed, wrong):
    assert not_printed(shown, printed) == wrong


@pytest.mark.parametrize(
    ("comment", "printed", "right"),
    [
        ("3.2 Hz", "3.1999", True),
        ("3.2 Hz", "3.26", False),
        ("8", "8", True),
        ("8 states", "9", False),
        ("-1.5e-3 m", "-0.00152", True),
        ("True", "False", False),
        ("[1, 2]", "[1, 2]", True),
        ("<Run ...: 12 s>", "<Run a/b: 12 s>", True),
        ("3.2", "", False),
    ],
)
def test_a_stated_number_is_compared_to_the_digits_that_it_has(comment, printed, right):
    assert is_value(comment, printed + "\n") == right

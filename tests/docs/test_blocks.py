# SPDX-License-Identifier: Apache-2.0
"""Every code block in the documents is whole: Python compiles and imports what there is, files pass their schemas."""

import ast
import importlib
import re

import pytest
import write_nodes
from documents import PAGES, blocks

from abrace.benchmark.definition import load_definition
from abrace.campaign.file import load_campaign
from abrace_core.config_file import read_config
from abrace_core.errors import AbraceError
from abrace_core.yaml_text import parse_yaml
from abrace_lqg.weights import Weights
from abrace_plant.devices.calibration import CalibrationFile
from abrace_plant.devices.modbus import ModbusFile
from abrace_plant.devices.udp import UdpFile
from abrace_plant.rig.file import _Interlocks, load_rig

OWN_KIND = ("ni_daqmx", "my_daq")
"""Devices of the reader's."""
PYTHON = re.compile(r"^(?:import |from \w+(?:\.\w+)* import |class \w+)", re.MULTILINE)


def python_of(page) -> list[str]:
    """The Python blocks of a page, those that are indented too."""
    return [
        block.text
        for block in blocks(page)
        if block.language == "python" or (not block.language and PYTHON.match(block.text))
    ]


def import_mistakes(tree: ast.Module, files: set[str]) -> list[str]:
    """What is imported and is not there; `files` are modules that the page makes, and what no test installs is left."""
    wrong = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [(node.module, alias.name) for alias in node.names]
        else:
            continue
        for module, name in names:
            if module in files or module.partition(".")[0] in ("control",):
                continue
            try:
                imported = importlib.import_module(module)
                if name is not None:
                    getattr(imported, name)
            except (ImportError, AttributeError):
                wrong.append(f"{module}.{name}")
    return wrong


@pytest.mark.parametrize("page", [page for page in PAGES if python_of(page)], ids=lambda page: page.name)
def test_python_compiles_and_imports_what_there_is(page):
    files = {block.name.removesuffix(".py") for block in blocks(page)}
    for text in python_of(page):
        assert not import_mistakes(ast.parse(text), files), text


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
            case {"kind": "modbus"}:
                read_config(file, ModbusFile, "device")
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


def test_a_wrong_block_is_found(tmp_path):
    """The checks above can fail."""
    assert mistake("kind: udp\nadress: 1.2.3.4\n", tmp_path)
    assert mistake("name: day\nrig: ncree_three_storey\nsteps: [{name: a, tset: {}}]\n", tmp_path)
    assert mistake("/**/logger:\n  ros__parameters: {topic: [response]}\n", tmp_path)
    assert mistake("measured: [a1]\nweights: {displacement: 1.0}\n", tmp_path)
    assert import_mistakes(ast.parse("from abrace_core.own_law import Lwa\nimport abrace_cor"), set())

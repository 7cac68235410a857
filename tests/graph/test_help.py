# SPDX-License-Identifier: Apache-2.0
"""`--help` and `--version` of every node: without ROS, without making it."""

import importlib
import re
import shlex
from pathlib import Path

import pytest
import write_nodes

from abrace.cli import ON_A_NODE, parser

COMMANDS = [
    *((name,) for name in ("run", "campaign", "report", "demo", "status", "stop", "set", "bag", *ON_A_NODE)),
    *(("bag", name) for name in ("info", "csv", "mat", "plot")),
]
PAGE = (Path(__file__).parents[2] / "docs/nodes.md").read_text()
NODES = [(package, name) for package, inside in write_nodes.NODES.items() for name in inside]


@pytest.mark.parametrize(("package", "name"), NODES)
def test_help_says_what_a_node_is_and_every_parameter_with_its_default(package, name, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", [f"lib/{package}/{name}", "--help"])
    assert importlib.import_module(f"{package}.nodes.{name}").main() == 0
    text = capsys.readouterr().out
    assert f"`{name}`" in text.splitlines()[0]
    assert f"ros2 run (or abrace run) {package} {name} --ros-args -p NAME:=VALUE ..." in text
    (example,) = re.findall(r"^example: (abrace run .*)$", text, re.MULTILINE)
    assert example.startswith(f"abrace run {package} {name} --ros-args -")
    assert set(re.findall(r"-p (\w+):=", example)) <= set(re.findall(r"^  -p (\w+):=", text, re.MULTILINE))
    assert f"    {example}\n" in PAGE
    parameters = [parameter.name for parameter in write_nodes.parameters(package, name)]
    assert parameters
    assert re.findall(r"^  -p (\w+):=\S", text, re.MULTILINE) == parameters


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_has_an_example_that_its_parser_takes(words, capsys):
    with pytest.raises(SystemExit):
        parser().parse_args([*words, "--help"])
    text = capsys.readouterr().out.partition("\nexample")[2]
    examples = re.findall(r"(?:: .*?|  )\babrace (.*?)(?:,.*|  .*)?$", text, re.MULTILINE)
    assert examples
    for given in map(shlex.split, examples):
        assert given[: len(words)] == list(words)
        parser().parse_args(given)


def test_version_is_abraces(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["lib/abrace_plant/plant", "--version"])
    assert importlib.import_module("abrace_plant.nodes.plant").main() == 0
    assert re.fullmatch(r"plant of abrace \d+\.\d+\.\d+\n", capsys.readouterr().out)

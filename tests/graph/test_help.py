"""`--help` and `--version` of every node: without ROS, without making it."""

import importlib
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs/nodes.md").read_text()
NODES = re.findall(r"^`abrace run (\w+) (\w+)`", PAGE, re.MULTILINE)


@pytest.mark.parametrize(("package", "name"), NODES)
def test_help_says_what_a_node_is_and_every_parameter_with_its_default(package, name, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", [f"lib/{package}/{name}", "--help"])
    assert importlib.import_module(f"{package}.nodes.{name}").main() == 0
    text = capsys.readouterr().out
    assert f"`{name}`" in text.splitlines()[0]
    assert f"ros2 run (or abrace run) {package} {name} --ros-args -p NAME:=VALUE ..." in text
    section = PAGE.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
    parameters = re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)
    assert parameters
    assert re.findall(r"^  -p (\w+):=\S", text, re.MULTILINE) == parameters


def test_version_is_abraces(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["lib/abrace_plant/plant", "--version"])
    assert importlib.import_module("abrace_plant.nodes.plant").main() == 0
    assert re.fullmatch(r"plant of abrace \d+\.\d+\.\d+\n", capsys.readouterr().out)

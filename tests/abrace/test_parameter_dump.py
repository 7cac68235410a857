# SPDX-License-Identifier: Apache-2.0
"""What `ros2 param dump` writes of a node can be given to the next one as `--params-file`."""

from __future__ import annotations

import importlib
import pkgutil
from typing import TYPE_CHECKING, Any

import domain_coordinator
import pytest
import rclpy
import yaml
from rclpy.parameter import parameter_value_to_python

from abrace_core.node import AbraceNode, Parameter

if TYPE_CHECKING:
    from pathlib import Path

PACKAGES = ("abrace_plant", "abrace_bags", "abrace_sysid", "abrace_lqg")


def tables() -> dict[str, list[Parameter]]:
    """The parameter table of every node."""
    found = {}
    for package in PACKAGES:
        for module in pkgutil.iter_modules(importlib.import_module(f"{package}.nodes").__path__):
            node = importlib.import_module(f"{package}.nodes.{module.name}")
            if hasattr(node, "PARAMETERS"):
                found[module.name] = list(node.PARAMETERS)
    return found


def started(name: str, table: list[Parameter], *arguments: str) -> tuple[dict[str, Any], str]:
    """The values of a node that is started with these arguments, and its dump."""
    with domain_coordinator.domain_id() as domain:
        context = rclpy.Context()
        context.init(args=[name, "--ros-args", "-r", "__ns:=/rig", *arguments], domain_id=domain)
        node = AbraceNode(name, table, context)
        shown = {one: node.get_parameter(one).get_parameter_value() for one in sorted(node._parameters)}
        values = {one: parameter_value_to_python(value) for one, value in shown.items()}
        text = yaml.dump({f"/rig/{name}": {"ros__parameters": values}}, default_flow_style=False)
        used = dict(vars(node.parameters))
        node.destroy_node()
        context.try_shutdown()
    return used, text


@pytest.mark.parametrize(("name", "table"), tables().items(), ids=tables())
def test_the_dump_of_every_node_starts_it_with_the_same_parameters(name: str, table: list[Parameter], tmp_path: Path):
    examples = {str: "text", float: "3.0"}
    arguments = []
    for one in table:
        if one.required and not one.default:
            value = f"[{examples[one.element or str]}]" if one.default == [] else examples[str]
            arguments += ["-p", f"{one.name}:={value}"]
    before, dump = started(name, table, *arguments)
    file = tmp_path / "dump.yaml"
    file.write_text(dump)
    after, _ = started(name, table, "--params-file", str(file))
    assert after == before

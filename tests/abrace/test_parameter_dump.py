# SPDX-License-Identifier: Apache-2.0
"""What `ros2 param dump` writes of a node can be given to the next one as `--params-file`."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import domain_coordinator
import pytest
import rclpy
import yaml
from rclpy.parameter import parameter_value_to_python

from abrace_node.node import AbraceNode

if TYPE_CHECKING:
    from pathlib import Path

    from abrace_node.parameters import Parameter

NODES = ("abrace_plant.nodes.plant", "abrace_sysid.nodes.identify", "abrace_lqg.nodes.controller")
"""Among their parameters is every type, required or not, with choices or not, and lists that may be empty."""


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


@pytest.mark.parametrize("name", NODES)
def test_the_dump_of_a_node_starts_it_with_the_same_parameters(name: str, tmp_path: Path):
    table = list(importlib.import_module(name).PARAMETERS)
    examples = {str: "text", float: "3.0"}
    arguments = []
    for one in table:
        if one.required and not one.default:
            value = f"[{examples[one.element or str]}]" if one.default == [] else examples[str]
            arguments += ["-p", f"{one.name}:={value}"]
    before, dump = started(name.rpartition(".")[2], table, *arguments)
    file = tmp_path / "dump.yaml"
    file.write_text(dump)
    after, _ = started(name.rpartition(".")[2], table, "--params-file", str(file))
    assert after == before

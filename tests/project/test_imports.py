# SPDX-License-Identifier: Apache-2.0
"""Imports go from higher to lower layers, without cycles of modules or subpackages; only nodes import ROS."""

import itertools
import subprocess
import sys

import pytest
from source_tree import FLOORS, MAY, Module, all_modules, modules_of, reached_by_launch, ring

ROS = {"rclpy", "rcl_interfaces", "ament_index_python", "launch", "launch_ros", "abrace_interfaces"}


def imported_modules(module: Module) -> set[str]:
    """Those of our modules that it imports."""
    return {name for name in module.imports if name in all_modules()} - {module.name}


@pytest.mark.parametrize("package", FLOORS)
def test_a_package_imports_only_lower_layers(package):
    for module in modules_of(package):
        for other in {name.partition(".")[0] for name in module.imports} & set(FLOORS) - {package}:
            lower = FLOORS[other] < FLOORS[package] or (package, other) in MAY
            assert lower, f"{module.name} imports {other}"


def test_no_ring_of_modules():
    # `from subpackage import name` runs its __init__ first, which a module of that subpackage does not import itself
    arrows = {
        name: {other for other in imported_modules(module) if not name.startswith(f"{other}.")}
        for name, module in all_modules().items()
    }
    assert not ring(arrows), " -> ".join(ring(arrows))


def test_no_ring_of_subpackages():
    arrows: dict[str, set[str]] = {}
    for module in all_modules().values():
        others = {all_modules()[name].subpackage for name in imported_modules(module)} - {
            module.subpackage,
            module.package,
        }
        arrows.setdefault(module.subpackage, set()).update(others)
    assert not ring(arrows), " -> ".join(ring(arrows))


LAUNCH = "abrace_bringup.description"
"""What launch files share; the other modules of that package hold what is tested without launch."""


def test_ros_is_imported_by_nodes_alone():
    for name, module in all_modules().items():
        if not {"abrace_node", "nodes"} & set(name.split(".")) and name != LAUNCH:
            found = {imported.partition(".")[0] for imported in module.imports}
            assert not {other for other in found if other in ROS or other.endswith(("_msgs", "_srvs"))}, name


def test_launch_files_need_what_every_machine_with_launch_has():
    """They run in the system's Python, which has an older pydantic than our nodes, and no mcap."""
    here = {*sys.stdlib_module_names, *FLOORS, "yaml", "launch", "launch_ros", "ament_index_python"}
    for name in reached_by_launch():
        assert {each.partition(".")[0] for each in all_modules()[name].imports} <= here, name


@pytest.mark.parametrize(
    "name", ["abrace_bags.nodes.logger", "abrace_lqg.nodes.controller", "abrace_plant.nodes.ground_motion"]
)
def test_a_node_of_every_test_does_not_wait_for_scipy(name):
    """Its import takes as long as that of all the rest of a logger."""
    code = f"import sys, {name}; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0


ACTING = [
    "abrace.nodes.supervisor",
    "abrace_bags.nodes.logger",
    "abrace_bags.nodes.replay",
    "abrace_bringup.nodes.operator",
    "abrace_bringup.nodes.viewer",
    "abrace_lqg.nodes.controller",
    "abrace_plant.nodes.ground_motion",
    "abrace_plant.nodes.plant",
    "abrace_plant.nodes.sensor_bridge",
    "abrace_sysid.nodes.excitation",
]


@pytest.mark.parametrize("name", ACTING)
def test_nothing_that_acts_on_a_rig_imports_a_figure_or_python_control(name):
    """Not even inside a function, where it would be imported while the rig moves."""
    modules, found, new = all_modules(), set(), {name}
    while new:
        found |= new
        new = {
            package
            for each in new
            for other in modules[each].runs
            for package in itertools.accumulate(other.split("."), "{}.{}".format)
            if package in modules
        } - found
    drawing = {
        each for each in found if {other.partition(".")[0] for other in modules[each].runs} & {"matplotlib", "plotly"}
    }
    assert not drawing | {each for each in found if "figures" in each.split(".")}
    algebra = {each for each in found if "control" in {other.partition(".")[0] for other in modules[each].runs}}
    assert algebra == {"abrace_core.model.linear_model"} & found, "to_control alone, which nothing here calls"

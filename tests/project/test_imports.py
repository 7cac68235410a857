# SPDX-License-Identifier: Apache-2.0
"""Imports go from higher to lower layers, without cycles of modules or subpackages; only nodes import ROS."""

import subprocess
import sys

import pytest
from source_tree import FLOORS, LAUNCH_FILES, MODULES, Module, modules_of, reached, ring

ROS = {"rclpy", "rcl_interfaces", "ament_index_python", "launch", "launch_ros", "abrace_interfaces"}


def imported_modules(module: Module) -> set[str]:
    """Those of our modules that it imports."""
    return {name for name in module.imports if name in MODULES} - {module.name}


def test_a_ring_is_found_and_named():
    assert ring({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    assert ring({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


@pytest.mark.parametrize("package", FLOORS)
def test_a_package_imports_only_lower_layers(package):
    for module in modules_of(package):
        for other in {name.partition(".")[0] for name in module.imports} & set(FLOORS) - {package}:
            assert FLOORS[other] < FLOORS[package], f"{module.name} imports {other}"


def test_no_ring_of_modules():
    # `from subpackage import name` runs its __init__ first, which a module of that subpackage does not import itself
    arrows = {
        name: {other for other in imported_modules(module) if not name.startswith(f"{other}.")}
        for name, module in MODULES.items()
    }
    assert not ring(arrows), " -> ".join(ring(arrows))


def test_no_ring_of_subpackages():
    arrows: dict[str, set[str]] = {}
    for module in MODULES.values():
        others = {MODULES[name].subpackage for name in imported_modules(module)} - {module.subpackage, module.package}
        arrows.setdefault(module.subpackage, set()).update(others)
    assert not ring(arrows), " -> ".join(ring(arrows))


def test_subpackages_of_the_plant_hardly_import_each_other():
    subpackages = {f"abrace_plant.{subpackage}" for subpackage in ("rig", "records", "live")}
    crossing = [
        (module.name, name)
        for module in modules_of("abrace_plant")
        for name in imported_modules(module)
        if module.subpackage in subpackages and MODULES[name].subpackage in subpackages - {module.subpackage}
    ]
    assert len(crossing) <= 4, crossing


LAUNCH = "abrace_bringup.description"
"""What launch files share; the other modules of that package hold what is tested without launch."""


@pytest.mark.parametrize(
    "name", [name for name in MODULES if not {"node", "nodes"} & set(name.split(".")) and name != LAUNCH]
)
def test_ros_is_imported_by_nodes_alone(name):
    module = MODULES[name]
    found = {imported.partition(".")[0] for imported in module.imports}
    assert not found & ROS
    assert not {other for other in found if other.endswith(("_msgs", "_srvs"))}


@pytest.mark.parametrize("name", sorted(reached(LAUNCH_FILES)))
def test_launch_files_need_what_every_machine_with_launch_has(name):
    """They run in the system's Python, which has an older pydantic than our nodes, and no mcap."""
    outside = {each.partition(".")[0] for each in MODULES[name].imports} - set(sys.stdlib_module_names) - set(FLOORS)
    assert outside <= {"yaml", "launch", "launch_ros", "ament_index_python"}


@pytest.mark.parametrize(
    "name", ["abrace_bags.nodes.logger", "abrace_lqg.nodes.controller", "abrace_plant.nodes.ground_motion"]
)
def test_a_node_of_every_test_does_not_wait_for_scipy(name):
    """Its import takes as long as that of all the rest of a logger."""
    code = f"import sys, {name}; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0

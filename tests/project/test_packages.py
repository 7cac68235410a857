# SPDX-License-Identifier: Apache-2.0
"""package.xml names what the package imports, and what its tests import, and nothing else."""

import glob
import re
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from source_tree import FLOORS, ROOT, Module, modules_of, reached_by_launch, read_module, ring

import abrace_core

KEYS = {
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "matplotlib": "python3-matplotlib",
    "pandas": "python3-pandas",
    "numba": "python3-numba",
    "argcomplete": "python3-argcomplete",
    "yaml": "python3-yaml",
    "pytest": "python3-pytest",
    "hypothesis": "python3-hypothesis",
    "psutil": "python3-psutil",
    "rich": "python3-rich",
    "tornado": "python3-tornado",
}
"""rosdep's keys of Python packages that apt installs on Ubuntu 24.04, by import; a ROS package is its own key."""
FROM_PIP = {
    "pydantic",
    "mcap",
    "zstandard",
    "lz4",
    "plotly",
    "threadpoolctl",
    "rosbags",
    "foxglove",
    "dask",
    "distributed",
    "pyarrow",
    "structdyn",
    "control",
    "ctrlsys",
    "eqsig",
    "fmpy",
    "skrf",
    "mcap_ros2",
    "Pynite",
}
"""Python packages that rosdep does not know, has by pip alone (which Ubuntu refuses outside an environment: rosbags,
mcap-ros2-support), or older than abrace needs (pydantic 1): `make setup` installs them."""
NAMES_OF_PIP = {
    "foxglove": "foxglove-sdk",
    "skrf": "scikit-rf",
    "mcap_ros2": "mcap-ros2-support",
    "Pynite": "PyNiteFEA",
}
MODULES_OF_TESTS = {
    path.stem
    for folder in ("tests/support", "tests/runner", "benchmarks", "docs")
    for path in (ROOT / folder).glob("*.py")
}
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


def test_launch_files_import_nothing_that_only_our_environment_has():
    """`ros2 launch` runs them with the Python that ROS 2 is for, which sees what apt installs and not .venv."""
    code = f"""
import importlib, sys
sys.modules.update(dict.fromkeys({sorted(FROM_PIP)}))
for name in {sorted(reached_by_launch())}:
    try:
        importlib.import_module(name)
    except ImportError as error:
        if error.name in {sorted(FROM_PIP)}:
            raise
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


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


def required(*files: str) -> set[str]:
    """Names of the packages in files of requirements."""
    lines = [line.split("#")[0].strip() for file in files for line in (ROOT / f"requirements/{file}.txt").open()]
    return {re.split("[^A-Za-z0-9._-]", line)[0] for line in lines if line}


def test_what_apt_does_not_have_is_installed_by_pip():
    assert {NAMES_OF_PIP.get(name, name) for name in FROM_PIP} <= required("run", "develop", "numpy2")


def test_what_apt_has_is_in_our_environment_too():
    assert set(KEYS) - {"yaml"} | {"PyYAML"} <= required("run", "develop")


@pytest.mark.parametrize("files", [("run", "build"), ("run", "build", "develop")], ids=", ".join)
def test_versions_are_locked_with_a_sourced_ros_2_as_without(files):
    """By lock.txt, or left to the system by system.txt; ctrlsys and other packages for NumPy 2 are in neither."""
    run = subprocess.run(
        [ROOT / "requirements/lock_beside.sh", ROOT / "requirements/system.txt"],
        capture_output=True,
        text=True,
        check=True,
    )
    locked = {line.partition("==")[0] for line in run.stdout.splitlines()}
    assert required(*files) <= locked | required("system")
    assert not locked & required("system")
    assert not required("system", *files) & required("numpy2")


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
WITHOUT_ROS = [package for package in FLOORS if not package.endswith("_bringup")]
"""Packages that `pip install .` installs: those but the launch files and the page."""


def test_pip_installs_every_package_that_needs_no_ros_with_its_files():
    build = PROJECT["tool"]["hatch"]["build"]
    assert {*build["dev-mode-dirs"]} == {f"src/{package}" for package in WITHOUT_ROS}
    wheel = build["targets"]["wheel"]
    assert {*wheel["packages"]} == {f"src/{package}/{package}" for package in WITHOUT_ROS}
    files = [Path(path) for path in glob.glob("src/*/**/*.yaml", root_dir=ROOT, recursive=True)]  # noqa: PTH207
    # the first folder of each in its package
    needed = {Path(*file.parts[:3]).as_posix() for file in files if file.parts[1] in WITHOUT_ROS}
    assert {*wheel["shared-data"]} == needed
    for folder, share in wheel["shared-data"].items():
        assert share == f"share/{Path(folder).relative_to('src').as_posix()}"


def test_pip_builds_without_setuptools_which_leaves_a_package_abrace_in_the_checkout():
    # abrace.egg-info there is found before the workspace's, and has none of its nodes (`make test-pip` installs)
    assert PROJECT["build-system"]["build-backend"] == "hatchling.build"
    assert not {"setup.py", "setup.cfg"} & {path.name for path in ROOT.iterdir()}


@pytest.mark.parametrize("package", [*FLOORS, "abrace_interfaces"])
def test_every_package_says_what_it_is_and_has_licence_and_changes(package):
    folder = ROOT / "src" / package
    description = ElementTree.parse(folder / "package.xml").findtext("description")
    assert (folder / "README.md").read_text().startswith(f"# {package}\n\n{description}\n")
    for name in ("LICENSE", "CHANGELOG.md"):
        assert (folder / name).read_bytes() == (ROOT / name).read_bytes()


def test_every_package_has_the_version_of_abrace():
    versions = {}
    for package in {*FLOORS, "abrace_interfaces"}:
        tree = ElementTree.parse(ROOT / "src" / package / "package.xml")
        versions[package] = tree.findtext("version")
        if package != "abrace_interfaces":
            setup = (ROOT / "src" / package / "setup.py").read_text()
            versions[f"{package}/setup.py"] = re.findall(r'version="(.*)"', setup)[0]
    assert set(versions.values()) == {abrace_core.__version__}, versions

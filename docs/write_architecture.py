# SPDX-License-Identifier: Apache-2.0
"""Write docs/architecture.md and its picture of the house from the packages: `python docs/write_architecture.py`."""

from __future__ import annotations

import ast

import pages
from source_tree import FLOORS, modules_of

from abrace_core.files.writing import write_text

PICTURE = pages.DOCS / "figures/house.svg"
WIDTH, HEIGHT, GAP = 900, 62, 8
"""Of the picture, of a floor, between boxes [px]."""
BOX = 'fill="#e8eef6" stroke="#33527a"'

INTRODUCTION = """# Architecture

For those who change abrace: which package does what, and where a new thing goes. How to set up and test:
[CONTRIBUTING](project/contributing.md).

![The packages by floor, each with the packages that it imports](figures/house.svg)

*The house, drawn from the imports by `docs/write_architecture.py`. A package imports only packages of lower floors;
`abrace` uses `abrace_studies` where it is installed.*

- There is no ring of modules or of subpackages (`tests/project/test_imports.py`), and each `package.xml` names what its
  package imports (`tests/project/test_packages.py`).
- Only the `nodes` folder of a package and `abrace_node` import rclpy. All else runs without ROS, in a notebook too.
- Launch files and what they import run in the system's Python: they need nothing but PyYAML.
- `nodes/NAME.py` is the executable NAME: a table of parameters, topics, callbacks, `main`, and no line that could be
  tested without ROS.
- Nothing that acts on a rig imports a figure.
- One class of options a verb: node parameters, campaign keys, command options and Python keywords are made from it.
- The code runs on NumPy 1.26, SciPy 1.11 and Matplotlib 3.6 (Ubuntu 24.04) as well as on the newest versions.

## Packages and their subpackages

The docstring of each `__init__.py` says what it takes and gives.
"""

WHERE = (
    ("format of ground motion records", "a reader in `abrace_plant/records`, chosen in `records/files.py`"),
    ("key of the rig file", "`abrace_plant/rig/file.py`; its range relative to other keys in `rig/ranges.py`"),
    (
        "part of the simulated rig",
        "`abrace_plant/rig`: linear in `model.py`, limited in `motion.py`; a sensor fault in `sensors.py`",
    ),
    (
        "interlock",
        "what it watches `abrace_plant/rig/detectors.py`, its limit and time `rig/limits.py`, its key `rig/file.py`",
    ),
    (
        "kind of device",
        "a module with `load` in `abrace_plant/devices`, named in `devices/file.py`; or an entry point of your package",
    ),
    ("fault of the emulator", "of the link `abrace_plant/emulator/link.py`, of the target `emulator/emulator.py`"),
    ("check of all commands", "`abrace_core/safety/command_guard.py`"),
    (
        "option of a verb",
        "a field of its class of options: `abrace_sysid/fitting/options.py`, `abrace_studies/options.py` and others",
    ),
    ("transfer-function estimator, way to fit poles", "a module in `abrace_sysid/spectra`, `abrace_sysid/fitting`"),
    (
        "check of an identification",
        "its numbers in `abrace_sysid/validity`, its words in `model_findings.py` and others, called in `judgement.py`",
    ),
    ("margin, prediction", "`abrace_lqg/analysis`; shown by `abrace_lqg/proof`"),
    (
        "control law of abrace's own",
        "beside `abrace_lqg/control_law.py`, its node in `abrace_lqg/nodes` on `abrace_node/commander.py`",
    ),
    ("benchmark, criterion", "a file in `src/abrace_studies/benchmarks`; `abrace_studies/benchmark/criteria.py`"),
    ("parameter of a node", "a row of `PARAMETERS` in `nodes/NAME.py`"),
    (
        "node, topic, service",
        "also `abrace_bringup/policy.py` and `docs/write_nodes.py`; a message in `src/abrace_interfaces/msg`",
    ),
    ("launch argument, launch file", "`abrace_bringup/arguments.py`, `abrace_bringup/graphs.py`"),
    ("what a person sees or presses", "`abrace_bringup/page`; for Foxglove and RViz `abrace_bringup/viewing`"),
    (
        "key of the campaign file",
        "`abrace/campaign/tasks.py`, `drives.py` or `file.py`; checked in `demands.py`, run in `runner.py`",
    ),
    ("table of the report", "`abrace/report/tables.py`; its place in `abrace/report/content.py`"),
    ("figure", "`figure.py` or `figures` beside its subject, captioned by `abrace_core/figures/drawing.py`"),
    (
        "function of `import abrace`",
        "`abrace/interactive`, which calls the libraries and computes nothing; named in `abrace/__init__.py`",
    ),
    ("message to a user", "where it is raised; of files `abrace_core/files/config_mistakes.py`"),
    (
        "test",
        "`tests/PACKAGE/test_MODULE.py`; of nodes or by the clock `tests/graph`; shared `tests/support`",
    ),
    (
        "number that abrace claims",
        "`benchmarks`: accuracy in `make verify`, speed in `make bench`, endurance in `make soak`",
    ),
    ("dependency", "`requirements` with its reason, `lock.txt`, `package.xml`"),
)


def used(package: str) -> list[str]:
    """The packages that a package imports, the highest first."""
    imported = {name.partition(".")[0] for module in modules_of(package) for name in module.imports}
    return sorted(imported & set(FLOORS) - {package}, key=lambda name: (-FLOORS[name], name))


def house() -> str:
    """The picture: one row a floor, one box a package with what it imports."""
    levels = sorted(set(FLOORS.values()), reverse=True)
    height = len(levels) * (HEIGHT + GAP) + GAP
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif">',
        f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
    ]
    for row, level in enumerate(levels):
        packages = [name for name, floor in FLOORS.items() if floor == level]
        width = (WIDTH - GAP) / len(packages) - GAP
        for column, name in enumerate(packages):
            left, top = GAP + column * (width + GAP), GAP + row * (HEIGHT + GAP)
            below = ", ".join(each.removeprefix("abrace_") for each in used(name)) or "no other package"
            middle = left + width / 2
            lines += [
                f'<rect x="{left:.0f}" y="{top}" width="{width:.0f}" height="{HEIGHT}" {BOX}/>',
                f'<text x="{middle:.0f}" y="{top + 26}" text-anchor="middle" font-size="17">{name}</text>',
                f'<text x="{middle:.0f}" y="{top + 48}" text-anchor="middle" font-size="12" fill="#444">{below}</text>',
            ]
    return "\n".join([*lines, "</svg>", ""])


def summary(package: str) -> tuple[str, str]:
    """A package: the first sentence of its docstring, and its subpackages."""
    modules = [each for each in modules_of(package) if each.path.name == "__init__.py"]
    (root,) = (each for each in modules if each.name == package)
    text = ast.get_docstring(ast.parse(root.path.read_text(encoding="utf-8"))) or ""
    inside = ", ".join(f"`{each.name.removeprefix(package)[1:]}`" for each in modules if each is not root)
    return f"`{package}`", " ".join(text.split("\n\n")[0].split()) + (f" {inside}" if inside else "")


def page() -> str:
    """The whole page."""
    rows = [summary(package) for package in sorted(FLOORS, key=lambda name: -FLOORS[name])]
    packages = pages.table(["package", "what it is, and its subpackages"], rows)
    head = "## Where it goes\n\nPaths are relative to `src/PACKAGE`.\n"
    return "\n".join([INTRODUCTION, packages, head, pages.table(["what you add", "where"], WHERE)])


if __name__ == "__main__":
    write_text(PICTURE, house())
    pages.write(__file__, page)

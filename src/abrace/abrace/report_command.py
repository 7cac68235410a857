# SPDX-License-Identifier: Apache-2.0
"""`abrace report`: the report of a campaign, or a comparison of two campaigns."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import argparse

    from abrace_core.command_line import OneLineParser

EXAMPLES = """examples:
  abrace report results/demo                              report.html, report.md, summary.json and figures, made again
  abrace report results/demo --units SI                   in mm, m/s² and kN
  abrace report results/tuesday --against results/monday  two campaigns compared: against_monday.html"""


def add_report_parser(commands: argparse._SubParsersAction[OneLineParser]) -> None:
    """Add `report` to the command's `commands`."""
    report = commands.add_parser(
        "report",
        help="a campaign's report.html, report.md, figures and summary.json, from its results and bags",
        epilog=EXAMPLES,
    )
    report.add_argument("directory", type=Path, help="such as results/demo")
    report.add_argument(
        "--units",
        choices=("paper", "SI"),
        help="paper: cm, g, kgf; SI: mm, m/s², kN; default: paper for the paper's rig, otherwise SI",
    )
    report.add_argument("--against", type=Path, metavar="OTHER", help="results of another campaign, to compare with")


def report_command(given: argparse.Namespace) -> None:
    """Carry out `abrace report` with the arguments `given`."""
    from abrace.report.against import compare_campaigns
    from abrace.report.writer import make_report

    if given.against is None:
        print(make_report(given.directory, given.units))
    else:
        print(compare_campaigns(given.directory, given.against, given.units))

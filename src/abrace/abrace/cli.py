# SPDX-License-Identifier: Apache-2.0
"""The `abrace` command: nodes, campaigns, reports, bags, and the operator's commands for the running graph."""

from __future__ import annotations

import errno
import os
import sys
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from abrace import completion
from abrace.bag_command import add_bag_parser
from abrace.benchmark_command import add_benchmark_parser
from abrace.processes.group import NodeDied, find_executable, terminate_as_exception
from abrace.study_commands import add_study_parsers
from abrace_core import AbraceError, RunFailed, __version__
from abrace_core.files.command_line import OneLineParser
from abrace_node.executable import check_environment, replace_unprintable

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Sequence

DEMO = "demo"
ON_A_NODE = {
    "activate": ("configure a node, if it is not yet, and activate it", "excitation"),
    "deactivate": ("deactivate a node; it comes to rest first", "excitation"),
    "clear": ("clear the latched fault of a node", "plant"),
    "play": ("play the signal of a node, once", "ground_motion"),
}
"""By command of an operator on one node: what it does, and a node of an example."""
WRONG_INPUT = 2
"""Exit code when an argument or a file, of a node or of this command, is wrong."""
NOT_WRITABLE = (
    *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EIO),
    *(errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG),
)
"""Errors when a folder or disk cannot be written."""
FAILED = 1
"""Exit code when a run failed, or its results cannot be trusted."""
REPORTS = """examples:
  abrace report results/demo              report.html, summary.json and figures, made again
  abrace report results/demo --units SI   in mm, m/s² and kN"""
EXPORTS = """examples:
  abrace export results/demo/lqg3/lqg3.yaml --c      lqg3_c/: controller.h, controller.c and the controller's constants
  abrace export results/demo/lqg3/lqg3.yaml --fmu    lqg3.fmu for Simulink and other programs (FMI 2.0)"""


def parser() -> OneLineParser:
    """The command's arguments."""
    main_parser = OneLineParser(
        prog="abrace",
        description="Tests of an actively braced building on ROS 2.",
        example="abrace COMMAND --help, or abrace run abrace_plant plant --help for a node and its parameters",
    )
    main_parser.add_argument("--version", action="version", version=f"abrace {__version__}")
    commands = main_parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    run = commands.add_parser(
        "run",
        help="run a node: `ros2 run` for a machine without the ros2 command",
        example="abrace run abrace_plant plant --ros-args -p rig:=five_storey",
    )
    _completed(run.add_argument("package", help="such as abrace_plant"), completion.packages)
    _completed(run.add_argument("executable", help="such as plant"), completion.nodes)
    run.add_argument("arguments", nargs="...", help="as for ros2 run: --ros-args -p name:=value ...")
    run.set_defaults(act=_run)
    campaign = commands.add_parser(
        "campaign", help="run the steps of a campaign file, then report", example="abrace campaign my_day.yaml"
    )
    installed = "demo, demo_bridge, five_controllers, five_storeys, ten_storeys"
    file = campaign.add_argument("file", help=f"YAML file, or the name of an installed campaign: {installed}")
    _completed(file, completion.campaigns)
    _add_watch(campaign)
    one_of = campaign.add_mutually_exclusive_group()
    start = one_of.add_argument("--from", dest="start", metavar="STEP", help="run this step and those after it again")
    _completed(start, completion.steps)
    one_of.add_argument("--check", action="store_true", help="only check the file, and print what it would do")
    campaign.set_defaults(act=_campaign)
    report = commands.add_parser(
        "report",
        help="a campaign's report.html, figures and summary.json, from its results and bags",
        epilog=REPORTS,
    )
    report.add_argument("directory", type=Path, help="such as results/demo")
    report.add_argument(
        "--units",
        choices=("paper", "SI"),
        help="paper: cm, g, kgf; SI: mm, m/s², kN; default: paper for the paper's rig, otherwise SI",
    )
    report.set_defaults(act=_report)
    add_bag_parser(commands)
    add_benchmark_parser(commands, lambda action: _completed(action, completion.benchmarks))
    add_study_parsers(commands)
    _add_export(commands)
    status = commands.add_parser(
        "status",
        help="every node of the running graph: state, fault, rate, losses; live on a terminal",
        example="ROS_DOMAIN_ID=7 abrace status",
    )
    stop = commands.add_parser(
        "stop", help="press the stop button of the whole laboratory (a protective stop)", example="abrace stop"
    )
    operating = [status, stop]
    for command, (text, node) in ON_A_NODE.items():
        on_node = commands.add_parser(command, help=text, example=f"abrace {command} {node}")
        on_node.add_argument("node", help=f"such as {node}, or /rig/{node} where there are several")
        operating.append(on_node)
    setting = commands.add_parser(
        "set", help="set a parameter of a running node", example="abrace set controller next lqg2.yaml"
    )
    setting.add_argument("node", help="such as controller, or /rig/controller")
    setting.add_argument("parameter", help="name of the parameter, such as next")
    setting.add_argument("value", help="new value, such as lqg2.yaml")
    for each in (*operating, setting):
        each.set_defaults(act=_operate)
    demo = commands.add_parser(
        DEMO,
        help="the paper's tests, identification, design and comparison on the simulated rig",
        example="abrace demo, then open results/demo/report.html in a browser",
    )
    _add_watch(demo)
    demo.set_defaults(act=_campaign, file=DEMO, start=None, check=False)
    return main_parser


def _add_export(commands: argparse._SubParsersAction[OneLineParser]) -> None:
    export = commands.add_parser(
        "export", help="a controller file as C99 for a target computer, or as a co-simulation unit", epilog=EXPORTS
    )
    export.add_argument("controller", type=Path, help="controller file (YAML or .mat), such as lqg3.yaml")
    kind = export.add_mutually_exclusive_group(required=True)
    kind.add_argument("--c", action="store_true", help="C99 sources, without a heap")
    kind.add_argument("--fmu", action="store_true", help="unit of FMI 2.0 for co-simulation; needs a C compiler")
    export.add_argument("--rate-limit", type=float, default=2.5e6, metavar="R", help="N/s, of one brace (2.5e6)")
    export.add_argument("--ramp-time", type=float, default=0.5, metavar="S", help="s, of the force's fade-in (0.5)")
    export.add_argument("--output", type=Path, metavar="PATH", help="folder, or .fmu file (NAME_c, NAME.fmu)")
    export.set_defaults(act=_export)


def _add_watch(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--watch",
        action="store_true",
        help="show the building on a page in the browser; afterwards play the last test there until Ctrl-C",
    )


def _completed(action: argparse.Action, completer: Callable[..., Iterable[str]]) -> None:
    """Let the shell complete an argument with the values that `completer` returns."""
    action.completer = completer  # type: ignore[attr-defined]


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point, with the `arguments` of the command line by default; returns the exit code."""
    replace_unprintable()
    known = parser()
    completion.complete(known)
    given = known.parse_args(arguments)
    try:
        with terminate_as_exception():
            code: int = given.act(given) or 0
            sys.stdout.flush()
            return code
    except AbraceError as error:
        print(f"abrace: {error}", file=sys.stderr)
        refused = isinstance(error, NodeDied) and error.returncode == WRONG_INPUT
        return FAILED if isinstance(error, RunFailed) and not refused else WRONG_INPUT
    except BrokenPipeError:
        # the reader of the output has closed the pipe; what Python still writes at exit is discarded
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.errno not in NOT_WRITABLE:
            raise
        print(f"abrace: cannot write {error.filename or 'a file'}: {error.strerror}", file=sys.stderr)
        return WRONG_INPUT
    except KeyboardInterrupt:
        print("abrace: stopped", file=sys.stderr)
        return 130


def _run(given: argparse.Namespace) -> None:
    program = find_executable(given.package, given.executable)
    os.execv(program, [str(program), *given.arguments])


def _report(given: argparse.Namespace) -> None:
    from abrace.report.writer import make_report

    print(make_report(given.directory, given.units))


def _export(given: argparse.Namespace) -> None:
    from abrace_core.model.controller_file import load_controller
    from abrace_lqg.export.c_sources import write_c
    from abrace_lqg.export.fmu import write_fmu

    write, ending = (write_c, "_c") if given.c else (write_fmu, ".fmu")
    output = given.output or Path(f"{given.controller.stem}{ending}")
    write(load_controller(given.controller), output, given.rate_limit, given.ramp_time)
    print(f"wrote {output}")


def _campaign(given: argparse.Namespace) -> int:
    check_environment()
    if given.check:
        from abrace.campaign.plan import check_campaign

        print(check_campaign(_campaign_file(given.file)).text())
        return 0
    from abrace.campaign.course import run_campaign

    path = _campaign_file(given.file)
    with _watched(path) if given.watch else nullcontext():
        outcome = run_campaign(path, given.start)
    print(outcome.tables, flush=True)
    print(f"report: {outcome.results / 'report.html'}")
    for bags in outcome.bags:
        print(f"bags: {bags}", flush=True)
    for warning in outcome.warnings:
        print(f"abrace: cannot be trusted: {warning}", file=sys.stderr)
    if given.watch:
        _watch_last(path, outcome.results)
    return FAILED if outcome.warnings else 0


def _watched(path: Path) -> AbstractContextManager[None]:
    """The page on which the rig of the campaign in a file is watched."""
    from abrace.campaign.file import load_campaign
    from abrace.campaign.laboratory import Laboratories
    from abrace.processes.watching import watched

    campaign = load_campaign(path)
    return watched(f"/{campaign.name}", Laboratories(campaign).of().rig_file)


def _watch_last(path: Path, results: Path) -> None:
    """Show the last test of the campaign in a file, if it has one, until Ctrl-C."""
    from abrace.campaign.file import load_campaign
    from abrace.campaign.laboratory import Laboratories
    from abrace.processes.watching import watch_bag
    from abrace.report.recorded import last_bag

    campaign = load_campaign(path)
    if bag := last_bag(results, [step.name for step in campaign.steps]):
        watch_bag(bag, f"/{campaign.name}", Laboratories(campaign).of().rig_file)


def _campaign_file(name: str) -> Path:
    from abrace_core.files.installed import find_file

    return find_file(name, "abrace", "campaigns", ".yaml", "campaign")


def _operate(given: argparse.Namespace) -> int:
    check_environment()  # before ROS is imported: it ends the process if ROS_DOMAIN_ID is invalid
    from abrace.nodes import operator_commands

    match given.command:
        case "status":
            return operator_commands.status()
        case "stop":
            return operator_commands.stop()
        case "set":
            return operator_commands.set_parameter(given.node, given.parameter, given.value)
    return operator_commands.act_on(given.node, given.command)

# SPDX-License-Identifier: Apache-2.0
"""The `abrace` command: nodes, campaigns, reports, bags, and the operator's commands for the running graph."""

from __future__ import annotations

import errno
import os
import sys
from contextlib import AbstractContextManager, nullcontext
from importlib.metadata import version
from typing import TYPE_CHECKING

from abrace import completion
from abrace.bag_command import add_bag_parser, bag_command
from abrace.benchmark_command import add_benchmark_parser, benchmark_command
from abrace.fragility_command import add_fragility_parser, fragility_command
from abrace.processes.group import NodeDied, find_executable, terminate_as_exception
from abrace.report_command import add_report_parser, report_command
from abrace_core.command_line import OneLineParser
from abrace_core.errors import AbraceError, RunFailed
from abrace_core.executable import replace_unprintable
from abrace_core.ros_arguments import check_environment

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

DEMO = "demo"
WRONG_INPUT = 2
"""Exit code when an argument or a file, of a node or of this command, is wrong."""
NOT_WRITABLE = (
    *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EIO),
    *(errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG),
)
"""Errors when a folder or disk cannot be written."""
FAILED = 1
"""Exit code when a run failed, or its results cannot be trusted."""


def parser() -> OneLineParser:
    """The command's arguments."""
    main_parser = OneLineParser(
        prog="abrace",
        description="Tests of an actively braced building on ROS 2.",
        example="abrace COMMAND --help, or abrace run abrace_plant plant --help for a node and its parameters",
    )
    main_parser.add_argument("--version", action="version", version=f"abrace {version('abrace_core')}")
    commands = main_parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    run = commands.add_parser(
        "run",
        help="run a node: `ros2 run` for a machine without the ros2 command",
        example="abrace run abrace_plant plant --ros-args -p rig:=five_storey",
    )
    _completed(run.add_argument("package", help="such as abrace_plant"), completion.packages)
    _completed(run.add_argument("executable", help="such as plant"), completion.nodes)
    run.add_argument("arguments", nargs="...", help="as for ros2 run: --ros-args -p name:=value ...")
    explore = commands.add_parser(
        "explore",
        help="try many sets of weights, draw the trade-off: the node explore of abrace_lqg, with its parameters",
        example="abrace explore model:=results/demo/model/reduced.json simulation_model:=results/demo/model/model.json "
        "noise:=[1,2,3,4] output:=results/exploration",
    )
    explore.add_argument(
        "parameters", nargs="+", metavar="NAME:=VALUE", help="as `abrace run abrace_lqg explore --help` lists them"
    )
    campaign = commands.add_parser(
        "campaign", help="run the steps of a campaign file, then report", example="abrace campaign my_day.yaml"
    )
    file = campaign.add_argument("file", help="YAML file, or the name of an installed campaign: demo, five_controllers")
    _completed(file, completion.campaigns)
    _add_watch(campaign)
    one_of = campaign.add_mutually_exclusive_group()
    one_of.add_argument("--from", dest="start", metavar="STEP", help="run this step and those after it again")
    one_of.add_argument("--check", action="store_true", help="only check the file, and print what it would do")
    add_report_parser(commands)
    add_bag_parser(commands)
    add_benchmark_parser(commands, lambda action: _completed(action, completion.benchmarks))
    add_fragility_parser(commands)
    commands.add_parser(
        "status",
        help="every node of the running graph: state, fault, rate, losses; live on a terminal",
        example="ROS_DOMAIN_ID=7 abrace status",
    )
    commands.add_parser(
        "stop", help="press the stop button of the whole laboratory (a protective stop)", example="abrace stop"
    )
    clear = commands.add_parser("clear", help="clear the latched fault of a node", example="abrace clear plant")
    clear.add_argument("node", help="such as plant, or /rig/plant where there are several")
    setting = commands.add_parser(
        "set", help="set a parameter of a running node", example="abrace set controller next lqg2.yaml"
    )
    setting.add_argument("node", help="such as controller, or /rig/controller")
    setting.add_argument("parameter", help="name of the parameter, such as next")
    setting.add_argument("value", help="new value, such as lqg2.yaml")
    demo = commands.add_parser(
        DEMO,
        help="the paper's tests, identification, design and comparison on the simulated rig",
        example="abrace demo, then open results/demo/report.html in a browser",
    )
    _add_watch(demo)
    return main_parser


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
            code = _carry_out(given)
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


def _carry_out(given: argparse.Namespace) -> int:
    if given.command == "run":
        program = find_executable(given.package, given.executable)
        os.execv(program, [str(program), *given.arguments])
    if given.command == "explore":
        program = find_executable("abrace_lqg", "explore")
        parameters = [text for each in given.parameters for text in ("-p", each)]
        os.execv(program, [str(program), "--ros-args", *parameters])
    if given.command == "bag":
        bag_command(given)
        return 0
    if given.command in ("status", "stop", "clear", "set"):
        return _operate(given)
    if given.command == "campaign" and given.check:
        from abrace.campaign.plan import check_campaign

        print(check_campaign(_campaign_file(given.file)).text())
        return 0
    if given.command == "report":
        report_command(given)
        return 0
    if given.command == "fragility":
        fragility_command(given)
        return 0
    if given.command == "benchmark":
        benchmark_command(given)
        return 0
    check_environment()
    from abrace.campaign.course import run_campaign

    name, start = (given.file, given.start) if given.command == "campaign" else (DEMO, None)
    path = _campaign_file(name)
    with _watched(path) if given.watch else nullcontext():
        outcome = run_campaign(path, start)
    print(outcome.tables, flush=True)
    for doubt in outcome.doubts:
        print(f"abrace: cannot be trusted: {doubt}", file=sys.stderr)
    if given.watch:
        _watch_last(path, outcome.results)
    return FAILED if outcome.doubts else 0


def _watched(path: Path) -> AbstractContextManager[None]:
    """The viewer, running with the campaign in a file."""
    from abrace.campaign.file import load_campaign
    from abrace.campaign.laboratory import Laboratories
    from abrace.processes.watching import watched

    return watched(Laboratories(load_campaign(path)).of().rig_file)


def _watch_last(path: Path, results: Path) -> None:
    """Show the last test of the campaign in a file, if it has one, until Ctrl-C."""
    from abrace.campaign.file import load_campaign
    from abrace.processes.watching import watch_bag
    from abrace.report.recorded import last_bag

    if bag := last_bag(results, [step.name for step in load_campaign(path).steps]):
        watch_bag(bag)


def _campaign_file(name: str) -> Path:
    from abrace_core.node import find_file

    return find_file(name, "abrace", "campaigns", ".yaml", "campaign")


def _operate(given: argparse.Namespace) -> int:
    check_environment()  # before ROS is imported: it ends the process if ROS_DOMAIN_ID is invalid
    from abrace.nodes import operator_commands

    match given.command:
        case "status":
            return operator_commands.status()
        case "stop":
            return operator_commands.stop()
        case "clear":
            return operator_commands.clear(given.node)
    return operator_commands.set_parameter(given.node, given.parameter, given.value)

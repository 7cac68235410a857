# SPDX-License-Identifier: Apache-2.0
"""Every command in the documents is one that there is, and takes what it is given."""

import re
import shlex

import write_nodes
import write_topics
import yaml
from documents import PAGES, ROOT, blocks, commands, inline_commands
from write_commands import LAUNCH_FILES as LAUNCH

from abrace import cli
from abrace.processes.group import find_executable
from abrace_core import AbraceError
from abrace_node.parameters import Parameter
from abrace_plant.nodes import emulator

PARSER = cli.parser()
OWN = ("my_package", "my_node", "skyhook", "sliding_mode")
"""Packages of a reader's own, and of the examples."""
ROS2 = {
    "action": ("send_goal", "list"),
    "bag": ("info", "play", "record", "convert", "reindex"),
    "launch": (),
    "lifecycle": ("get", "set", "nodes"),
    "node": ("info", "list"),
    "param": ("get", "set", "list", "dump"),
    "pkg": ("prefix",),
    "run": (),
    "security": ("generate_artifacts",),
    "service": ("call", "list"),
    "topic": ("echo", "hz", "info", "list", "pub"),
}
"""What of `ros2` the documents use."""

PLACEHOLDERS = ("--help", "--show-args", "NAME:=VALUE", "...")
"""Words that are no argument of a launch file."""
OTHERS = ("diagnostic_aggregator",)
"""Packages of others whose nodes the documents start."""


def node_mistakes(package: str, executable: str, words: list[str]) -> list[str]:
    """What is wrong in a node's name and arguments."""
    if package in OWN or re.fullmatch(r"[A-Z_]+", executable):
        return []
    find_executable(package, executable)  # raises
    if package.endswith("_bringup") and executable in LAUNCH:
        return argument_mistakes(executable, words)
    if executable == "emulator":
        emulator.arguments().parse_args([word for word in words if word != "..."])
        return []
    if executable not in write_nodes.NODES.get(package, {}):
        return []
    table = {parameter.name: parameter for parameter in write_nodes.parameters(package, executable)}
    given = [words[i + 1] for i, word in enumerate(words[:-1]) if word == "-p"]
    return [mistake for each in given if (mistake := parameter_mistake(table, each))]


def parameter_mistake(table: dict[str, Parameter], given: str) -> str:
    """What is wrong in `name:=value`; empty: nothing."""
    name, assigned, text = given.partition(":=")
    if not assigned or name not in table:
        return given
    value = yaml.safe_load(text)
    if re.fullmatch(r"[A-Z_]+|\.\.\.", text) or value is None:
        return ""
    kind = type(table[name].default)
    wanted = (int, float) if kind is float else (str, list, int, float) if kind is list else kind
    fits = isinstance(value, wanted) and isinstance(value, bool) == (kind is bool)
    choices = table[name].choices
    return "" if fits and (not choices or isinstance(value, list) or value in choices) else given


def argument_mistakes(launch: str, words: list[str]) -> list[str]:
    """Arguments of a launch file that there are not, and numbers and choices that do not fit."""
    table = {argument.name: argument for argument in LAUNCH[launch]}
    wrong = []
    for name, assigned, text in (word.partition(":=") for word in words if word not in PLACEHOLDERS):
        if not assigned or name not in table:
            wrong.append(name)
            continue
        try:
            table[name].read(text)
        except ValueError as error:
            if "file" not in str(error):  # files are a reader's own
                wrong.append(f"{name}:={text}, expected {error}")
    return wrong


def ros2_mistakes(words: list[str]) -> list[str]:
    """What is wrong in a command of `ros2`."""
    verb, *rest = words
    if verb not in ROS2 or (ROS2[verb] and (not rest or rest[0] not in ROS2[verb])):
        return [" ".join(words)]
    if verb == "run":
        ours = len(rest) > 1 and rest[0] not in OTHERS
        return node_mistakes(rest[0], rest[1], rest[2:]) if ours else []
    if verb == "launch":
        name = rest[1].removesuffix(".launch.py") if len(rest) > 1 else "FILE"
        return argument_mistakes(name, rest[2:]) if rest[0].endswith("_bringup") and name in LAUNCH else []
    nodes = write_topics.all_endpoints()
    if words[:2] == ["service", "call"]:
        node, _, service = rest[1].removeprefix("/rig/").rpartition("/")
        kinds = {each.type for each in nodes.get(node, []) if each.name == f"~/{service}"}
        return [] if rest[2] in kinds else [" ".join(words)]
    if words[:2] == ["param", "set"]:
        node = rest[1].rpartition("/")[2]
        packages = [package for package, inside in write_nodes.NODES.items() if node in inside]
        live = {one.name for package in packages for one in write_nodes.parameters(package, node) if one.live}
        return [] if rest[2] in live else [" ".join(words)]
    return []


def mistakes(command: str, files: set[str]) -> list[str]:
    """What is wrong in a command; `files` are those that its page makes."""
    words = shlex.split(command)
    head, rest = words[0], words[1:]
    if head == "abrace":
        PARSER.parse_args(rest)
        return node_mistakes(rest[1], rest[2], rest[3:]) if rest[0] == "run" else []
    if head == "ros2":
        return ros2_mistakes(rest)
    if head == "make":
        targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
        return [word for word in rest if "=" not in word and word not in targets and word != "clean"]
    if head == "python":
        known = rest[0] in ("-m", "-c") or rest[0] in files or (ROOT / rest[0]).is_file()
        return [] if known else [rest[0]]
    elsewhere = r"/opt/ros/.*|install/.*|~/.*|PATH_TO_ABRACE/.*"
    return [] if re.fullmatch(elsewhere, rest[0]) or (ROOT / rest[0]).is_file() else [rest[0]]


def reported(command: str, files: set[str], capsys) -> str:
    """The command and what is wrong in it; empty: nothing."""
    try:
        found = mistakes(command, files)
    except (SystemExit, AbraceError, ValueError, IndexError) as error:
        found = [str(error), capsys.readouterr().err]
    return f"{command}: {found}" if found else ""


def test_commands_in_blocks_are_taken_by_what_they_call(capsys):
    for page in PAGES:
        files = {block.name for block in blocks(page)}
        wrong = [text for command in commands(page) if (text := reported(command, files, capsys))]
        assert not wrong, "\n".join([page.name, *wrong])


def test_commands_in_sentences_are_there():
    """Their first words: in a sentence the rest of a command may be left out."""
    known = {"help", *re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)}
    (of_abrace,) = (action.choices for action in PARSER._actions if isinstance(action.choices, dict))
    options = [text for action in PARSER._actions for text in action.option_strings]
    there = {"abrace": {*of_abrace, *options, "COMMAND"}, "ros2": set(ROS2), "make": known}
    for page in PAGES:
        for command in inline_commands(page):
            head, first, *_ = command.split()
            assert first in there.get(head, {first}) or "=" in first, f"{page.name}: {command}"


def test_the_nodes_of_the_reference_are_all_that_there_are():
    for setup in (ROOT / "src").glob("*/setup.py"):
        scripts = re.findall(r'"(\w+) = abrace_node.executable:main"', setup.read_text())
        listed = write_nodes.NODES.get(setup.parent.name, {})
        assert set(scripts) - {"emulator"} == set(listed), setup

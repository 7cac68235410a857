# SPDX-License-Identifier: Apache-2.0
"""What a new user gets wrong: each is one line that says what, where, and what was expected, and exit code 2."""

from __future__ import annotations

import json
import os
import re
import shlex
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from simulated_loop import RUN, simulated_loop

from abrace.processes.group import find_executable
from abrace_bags import BagWriter, message_definition
from abrace_core.node import find_file
from abrace_core.wire import Responses
from abrace_plant.rig.file import load_rig

SUPPORT = Path(__file__).parents[1] / "support"
CONFIG = Path(__file__).parents[2] / "src/abrace_plant/config"
RIG = (CONFIG / "ncree_three_storey.yaml").read_text()
STEP = "name: x\nrig: ncree_three_storey\nsteps:\n  - name: a\n    test: {%s, duration: 2.0}\n"
MOTION = "ground_motion: {record: el_centro, peak_acceleration: 0.98}"

FILES = {
    "tab.yaml": RIG.replace("  peak_jerk", "\tpeak_jerk"),
    "indent.yaml": RIG.replace("  peak_jerk", "    peak_jerk"),
    "twice.yaml": f"name: a\n{RIG}",
    "unknown.yaml": RIG.replace("sample_rate:", "sampel_rate:").replace("masses:", "massses:"),
    "unit.yaml": RIG.replace("24516.625 ", "25 kN "),
    "comma.yaml": RIG.replace("0.0008 ", "0,0008 "),
    "list.yaml": RIG.replace("500.0 ", "[500.0] "),
    "nan.yaml": RIG.replace("500.0 ", ".nan "),
    "negative.yaml": RIG.replace("500.0 ", "-500.0 "),
    "latin.yaml": RIG.encode() + b"# caf\xe9\n",
    "empty.yaml": "",
    "quotes.yaml": (STEP % MOTION).replace("2.0", '"2.0"'),
    "record.yaml": (STEP % MOTION).replace("el_centro", "el_cento"),
    "tset.yaml": (STEP % MOTION).replace("test:", "tset:"),
    "signal.yaml": STEP % "excitation: {signal: whitenoise, rms: 1e3, band: [0.0, 30.0], seed: 1}",
    "scale.yaml": STEP % "ground_motion: {record: el_centro, peak_acceleration: 1e3}",
    "empty.csv": "",
    "semicolons.csv": "time;acc\n0,00;0,1\n0,01;0,2\n",
    "no_names.csv": "0.0,0.1\n0.01,0.2\n",
    "word.csv": "time [s],acceleration [m/s^2]\n0.0,0.1\n0.01,n/a\n",
    "feet.csv": "time [s],acceleration [ft/s^2]\n0.0,0.1\n0.01,0.2\n",
    "model.json": "{",
    "notes.txt": "taken",
}
MODULES = [
    "abrace.cli",
    "abrace.campaign.runner",
    "abrace.nodes.operator_commands",
    "abrace_bringup.nodes.viewer",
    "abrace_bringup.nodes.operator",
    *(
        f"abrace_plant.nodes.{name}"
        for name in ("plant", "ground_motion", "record", "characterize", "sensor_bridge", "emulator")
    ),
    *(f"abrace_sysid.nodes.{name}" for name in ("identify", "validate", "excitation")),
    *("abrace_lqg.nodes.controller", "abrace_lqg.nodes.design", "abrace_bags.nodes.logger", "abrace_bags.nodes.replay"),
]

PLANT = "abrace_plant/plant --ros-args"
LOOK = "abrace_plant/characterize --ros-args -p output:=o -p"
VIEW = "abrace_bringup/viewer --ros-args -p"
SERVE = "abrace_bringup/operator --ros-args -p"
EMULATE = "abrace_plant/emulator --device device.yaml --rig"
SHAKE = "abrace_plant/record --ros-args -p output:=o -p"
MISTAKES = [
    # names
    ("abrace rn abrace_plant plant", "command 'rn': unknown, expected one of bag, .*, did you mean run?"),
    (
        "abrace run abrace_plnt plant",
        "no package 'abrace_plnt' .*expected one of abrace, .*, did you mean abrace_plant?",
    ),
    ("abrace run abrace_plant plnt", "package abrace_plant has no executable 'plnt', .*, did you mean plant?"),
    ("abrace run abrace_plant", "executable: not given, expected abrace run [-h] package executable ..."),
    ("abrace", "COMMAND: not given, expected one of run, .*"),
    ("abrace set plant", "parameter, value: not given, expected abrace set [-h] node parameter value"),
    (
        "abrace bag csv B response --outptu r.csv",
        "--output: not given, expected abrace bag csv .* --output FILE bag topic",
    ),
    ("abrace bag csv {bag} respons --output r.csv", ".*: no topic /respons in it, .*, did you mean /response?"),
    ("abrace campaign demos", "campaign 'demos': unknown, expected a file ending in .yaml or .*, did you mean demo?"),
    (
        "abrace campaign record.yaml",
        ".*: step a: .*ground motion .*el_cento: no such file, .*, did you mean el_centro?",
    ),
    ("abrace campaign tset.yaml", "campaign file tset.yaml: step a: tset: unknown key, did you mean test?"),
    (f"{LOOK} rig:=ncree_three_story", "rig 'ncree_three_story': unknown, .*, did you mean ncree_three_storey?"),
    (f"{LOOK} rig:=unkown.yaml", "rig file unkown.yaml: no such file, did you mean unknown.yaml?"),
    (f"{LOOK} rig:=folder.yaml", "rig file folder.yaml: a folder, expected a file"),
    (f"{SHAKE} record:=el_centr", "ground motion el_centr: no such file, and no such name .*, did you mean el_centro?"),
    (f"{PLANT} -p lockstpe:=true", "parameter lockstpe: unknown, plant has autostart, .*, did you mean lockstep?"),
    (
        "abrace_lqg/design --ros-args -p model:=model.json -p output:=o.yaml -p weights:=lgq3",
        "weights 'lgq3': unknown, expected a file ending in .yaml or one of half, .*, did you mean lqg3?",
    ),
    # what is given
    (f"{PLANT} -p duration:=ten", "parameter duration: 'ten', expected a number, at least 0.0"),
    (f"{PLANT} -p duration:=-1", "parameter duration: -1, expected a number, at least 0.0"),
    (f"{PLANT} -p duration:=.nan", "parameter duration: nan, expected a number, at least 0.0"),
    (f"{PLANT} -p duration:=[1.0,2.0]", r"parameter duration: \[1.0, 2.0\], expected a number, at least 0.0"),
    (f"{PLANT} -p duration=10", "argument -p duration=10: expected name:=value, as duration:=10"),
    (f"{PLANT} -p duration:=", "argument -p duration:=: nothing after :=, expected a value; an empty text is ''"),
    (
        f"{PLANT} duration:=10.0",
        "argument duration:=10.0: unknown .*, expected -p name:=value .*, did you leave out -p?",
    ),
    (
        "abrace_plant/plant -p duration:=10.0",
        "argument '-p': unknown, expected --ros-args -p name:=value, .*--ros-args?",
    ),
    (f"{PLANT} -p 'cpu_affinity:=[1, 2.5]'", r"argument -p .*: expected numbers of one kind, as \[1.0, 2.5\]"),
    (f"{PLANT} -p lockstep:=1", "parameter lockstep: 1, expected true or false"),
    (f"{PLANT} -p wait_for:=[brace_comand]", "parameter wait_for: .*, expected a list .*, did you mean brace_command?"),
    (f"{PLANT} -p sensor_faults:=[a9=zero]", "sensor fault 'a9=zero': expected CHANNEL=KIND .* out of x1, x2, .*"),
    (f"{PLANT} -r __ns:=my-rig", "argument -r __ns:=my-rig: expected a namespace of letters, digits and _, as /my_rig"),
    (f"{PLANT} --params-file none.yaml", "parameter file none.yaml: No such file or directory"),
    (f"{PLANT} --params-file tab.yaml", "parameter file tab.yaml: line 9: not YAML: a tab, expected spaces"),
    ("abrace_lqg/controller", "parameter name: not given, expected --params-file FILE, the controller file .*"),
    (
        f"abrace_lqg/controller --ros-args --params-file {CONFIG}/five_storey.yaml",
        "parameter file .*five_storey.yaml: no ros__parameters in it, expected .*",
    ),
    # rig and campaign files
    (f"{EMULATE} tab.yaml", "rig file tab.yaml: line 9: not YAML: a tab, expected spaces"),
    (f"{EMULATE} indent.yaml", "rig file indent.yaml: line 9: not YAML: .*indented.*, expected .*"),
    (f"{EMULATE} twice.yaml", "rig file twice.yaml: line 5: key 'name' appears twice, expected once"),
    (
        f"{EMULATE} unknown.yaml",
        "rig file unknown.yaml: .*massses: unknown key, did you mean masses?; sampel_rate: unknown key, did you .*",
    ),
    (f"{EMULATE} unit.yaml", "rig file unit.yaml: .*capacity: '25 kN', expected a number without its unit"),
    (f"{EMULATE} comma.yaml", "rig file comma.yaml: .*lag: '0,0008', expected a number with a decimal point"),
    (f"{EMULATE} list.yaml", r"rig file list.yaml: sample_rate: \[500.0\], expected a number"),
    (f"{EMULATE} nan.yaml", "rig file nan.yaml: sample_rate: nan, expected a finite number"),
    (f"{EMULATE} negative.yaml", "rig file negative.yaml: sample_rate: -500.0, expected a number greater than 0"),
    (f"{EMULATE} latin.yaml", "rig file latin.yaml: line .*: not YAML: a character that is not UTF-8, expected UTF-8"),
    (f"{EMULATE} empty.yaml", "rig file empty.yaml: empty, expected keys and values"),
    ("abrace campaign quotes.yaml", ".*: step a: test.duration: '2.0', expected a number without quotation marks"),
    ("abrace campaign signal.yaml", ".*excitation: 'whitenoise', expected one of .*, did you mean white_noise?"),
    ("abrace campaign scale.yaml", ".*: step a: .*el_centro exceeds the table's limits: .*, expected a smaller .*"),
    # records, bags, models
    (f"{SHAKE} record:=empty.csv", "ground motion empty.csv: empty, expected a ground acceleration"),
    (f"{SHAKE} record:=semicolons.csv", "ground motion semicolons.csv, line 1: .*: semicolons, expected commas .*"),
    (f"{SHAKE} record:=no_names.csv", "ground motion no_names.csv, line 1: .*, expected names such as 'time .*"),
    (f"{SHAKE} record:=word.csv", "ground motion word.csv, line 3: 'n/a', expected a finite number"),
    (f"{SHAKE} record:=feet.csv", "ground motion feet.csv, line 1: unit 'ft/s^2' .*, expected one of g, m/s^2, cm/s^2"),
    ("abrace bag info none", "none: no such bag, expected a bag directory or an MCAP file"),
    ("abrace bag info notes.txt", "notes.txt: not an MCAP file"),
    ("abrace_bags/replay --ros-args -p bag:=folder.yaml", "folder.yaml: no MCAP file in it, expected a bag directory"),
    (
        "abrace_sysid/identify --ros-args -p data:=semicolons.csv -p inputs:=[acc] -p output:=o",
        "semicolons.csv, line 1: a semicolon, expected a line of names, then numbers with commas between",
    ),
    (
        "abrace_lqg/design --ros-args -p model:=model.json -p output:=o.yaml",
        "model file model.json: not JSON, line 1, .*",
    ),
    ("abrace_lqg/design --ros-args -p model:=. -p output:=o.yaml", "model file .: a folder, expected a file"),
    ("abrace report folder.yaml", "results file .*timing.json: No such file or directory"),
    # disk and network
    (f"{VIEW} bag:=none", "none: no such bag, expected a bag directory or an MCAP file"),
    (f"{VIEW} bag:={{bag}} -p response:=x", "parameter response: /x, bag has /response"),
    (f"{VIEW} response:=a-b", "parameter response: a-b, .*"),
    (f"{SERVE} address:=0.0.0.0", "parameter address: 0.0.0.0, beyond this machine, expected token_file, .*"),
    (f"{SERVE} address:=lab", "parameter address: lab, expected an IP address of this machine"),
    (f"{SERVE} certificate:=notes.txt", "parameter key: not given, expected a file, because certificate is given"),
    (f"{SERVE} page_heartbeat:=0.1", "parameter page_heartbeat: 0.1, expected 0, or at least 0.5"),
    (f"{VIEW} port:=70000", "parameter port: 70000, expected a whole number from 0 to 65535"),
    (f"{VIEW} host:=192.0.2.1", "server: cannot listen on 192.0.2.1, port 8765: .*"),
    (
        f"{VIEW} host:=0.0.0.0 -p operate:=true",
        "parameter operate: true with host 0.0.0.0, expected a host of 127.0.0.1, localhost, ::1",
    ),
    (f"{VIEW} token_file:=notes.txt", "parameter token_file: given, expected operate:=true with it"),
    (
        f"{VIEW} operate:=true -p token_file:=none",
        "parameter token_file: none: No such file or directory, expected a file with a token",
    ),
    ("abrace_bags/logger --ros-args -p output:={bag}", "bag .* exists already, expected a new directory"),
    ("abrace_bags/logger --ros-args -p output:=notes.txt/bag", "cannot write bag notes.txt/bag: Not a directory"),
    (
        "abrace_bags/logger --ros-args -p output:=/proc/no/bag",
        "cannot write bag /proc/no/bag: No such file or directory",
    ),
    (
        "abrace_plant/sensor_bridge --ros-args -p device:=device.yaml",
        "udp device 127.0.0.1:15000: cannot receive at 0.0.0.0:{port}: Address already in use",
    ),
]
VARIABLES = [
    ("ROS_DOMAIN_ID", "nine", "expected 0 to 232"),
    ("ROS_DOMAIN_ID", "300", "expected 0 to 232"),
    ("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp", "expected Fast DDS: .*rmw_fastrtps_cpp.*"),
    ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCAL", "expected SUBNET or .*, did you mean LOCALHOST?"),
    ("FASTRTPS_DEFAULT_PROFILES_FILE", "none.xml", "expected a file"),
]


def test_there_are_forty_and_more():
    assert len(MISTAKES) + len(VARIABLES) >= 40


pytestmark = pytest.mark.usefixtures("domain")


@pytest.fixture(scope="module")
def laboratory(domain, tmp_path_factory):  # noqa: ARG001
    """A folder with the wrong files, a bag, and a port that is taken; and the answers to all commands given there."""
    folder = tmp_path_factory.mktemp("mistakes")
    for name, content in FILES.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    (folder / "folder.yaml").mkdir()
    write_bag(folder / "bag")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        names = {"bag": "bag", "port": taken.getsockname()[1]}
        device = (CONFIG / "devices/emulator.yaml").read_text().replace("15001", str(names["port"]))
        (folder / "device.yaml").write_text(device.replace("../", f"{CONFIG}/"))
        lines = [json.dumps(shlex.split(command.format(**names))) for command, _ in MISTAKES]
        answered = subprocess.run(
            [sys.executable, SUPPORT / "mistakes.py", *MODULES],
            cwd=folder,
            input="\n".join(lines),
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
    answers = [json.loads(line) for line in answered.stdout.splitlines()]
    assert len(answers) == len(MISTAKES), answered.stderr
    left = sorted(path.name for path in folder.iterdir())
    return folder, names, dict(zip([command for command, _ in MISTAKES], answers, strict=True)), left


def write_bag(path: Path) -> None:
    """A bag of 50 samples of the rig at rest."""
    loop = simulated_loop(load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig")), 1)
    definition, packed = message_definition("abrace_interfaces/msg/Response"), Responses()
    with BagWriter(path, {"sample_period": "0.002"}) as bag:
        topic = bag.add_topic("/response", definition.type_name, definition.text, definition.type_hash)
        for k in range(50):
            sample = loop.step()
            z, time = sample.reading, 2_000_000 * k
            payload = packed.pack(time, sample.head, "", [2], z[:3], z[4:7], z[3:4], z[7:9], sample.command, z[9])
            bag.write(topic, payload, time, time)
            loop.receive_ground_acceleration(sample.stamp, 0.0)
            loop.receive_command(RUN, k, np.zeros(1), "")


def pattern_of(expected: str) -> str:
    """A regular expression in which a question mark, a plus sign and square brackets stand for themselves."""
    return re.sub(r"(?<!\\)([?\[\]^])", r"\\\1", expected)


@pytest.mark.parametrize(("command", "expected"), MISTAKES, ids=[command for command, _ in MISTAKES])
def test_a_mistake_is_one_line_that_says_what_where_and_what_was_expected(laboratory, command, expected):
    _, names, answers, _ = laboratory
    code, _, errors = answers[command]
    assert code == 2, errors
    (line,) = errors.splitlines()
    program, _, message = line.partition(": ")
    assert program.split()[0] == command.split()[0].rpartition("/")[2]
    assert re.fullmatch(pattern_of(expected.replace("{port}", str(names["port"]))), message), message
    for wording in ("lexeme", "Input should be", "pydantic", "Traceback", "rcl", "argparse", "<block", "literal"):
        assert wording not in message


def test_a_mistake_writes_nothing(laboratory):
    folder, _, _, left = laboratory
    assert left == sorted([*FILES, "bag", "device.yaml", "folder.yaml"]), folder


@pytest.mark.parametrize(("name", "value", "expected"), VARIABLES)
def test_a_wrong_variable_is_one_line_from_nodes_and_commands(name, value, expected):
    plant = find_executable("abrace_plant", "plant")
    for program, command in (("plant", [str(plant)]), ("abrace", ["abrace", "status"])):
        environment = os.environ | {name: value}
        ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
        assert ended.returncode == 2
        assert re.fullmatch(pattern_of(f"{program}: {name}={value}, {expected}\n"), ended.stderr), ended.stderr

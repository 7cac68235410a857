# SPDX-License-Identifier: Apache-2.0
"""What a new user gets wrong: each is one line that says what, where, and what was expected, and exit code 2."""

from __future__ import annotations

import re
import shlex
import socket
from pathlib import Path

import numpy as np
import pytest
from bag_of_run import write_bag
from forked import run_forked

from abrace import simulate
from abrace.cli import main
from abrace.processes.group import find_executable

CONFIG = Path(__file__).parents[2] / "src/abrace_plant/config"
RIG = (CONFIG / "ncree_three_storey.yaml").read_text()
STEP = "name: x\nrig: ncree_three_storey\nsteps:\n  - name: a\n    test: {%s, duration: 2.0}\n"
MOTION = "ground_motion: {record: el_centro, peak_acceleration: 0.98}"

FILES = {
    "tab.yaml": RIG.replace("  peak_jerk", "\tpeak_jerk"),
    "unknown.yaml": RIG.replace("sample_rate:", "sampel_rate:").replace("masses:", "massses:"),
    "unit.yaml": RIG.replace("24516.625 ", "25 kg "),
    "quotes.yaml": (STEP % MOTION).replace("2.0", '"2.0"'),
    "record.yaml": (STEP % MOTION).replace("el_centro", "el_cento"),
    "scale.yaml": STEP % "ground_motion: {record: el_centro, peak_acceleration: 1e3}",
    "word.csv": "time [s],acceleration [m/s^2]\n0.0,0.1\n0.01,n/a\n",
    "still.txt": "0\n0\n0\n",
    "model.json": "{",
}
PLANT = "abrace_plant/plant --ros-args"
LOOK = "abrace_plant/characterize --ros-args -p output:=o -p"
VIEW = "abrace_bringup/viewer --ros-args -p"
SERVE = "abrace_bringup/operator --ros-args -p"
EMULATE = "abrace_plant/emulator --device device.yaml --rig"
SHAKE = "abrace_plant/record --ros-args -p output:=o -p"
MOVE = "abrace_plant/ground_motion --ros-args -p"
MISTAKES = [
    # names
    ("abrace rn abrace_plant plant", "command 'rn': unknown, expected one of activate, bag, .*, did you mean run?"),
    (
        "abrace run abrace_plnt plant",
        "no package 'abrace_plnt' .*expected one of abrace, .*, did you mean abrace_plant?",
    ),
    ("abrace run abrace_plant plnt", "package abrace_plant has no executable 'plnt', .*, did you mean plant?"),
    ("abrace campaign --chek day.yaml", "argument --chek: unknown, .*, did you mean --check?"),
    ("abrace set plant", "parameter, value: not given, expected abrace set [-h] node parameter value"),
    (
        "abrace bag csv {bag} respons --output r.csv",
        ".*: no topic respons in it, .* /response, did you mean /response?",
    ),
    ("abrace campaign demos", "campaign 'demos': unknown, expected a file ending in .yaml or .*, did you mean demo?"),
    (
        "abrace campaign record.yaml",
        ".*: step a: .*ground motion .*el_cento: no such file, .*, did you mean el_centro?",
    ),
    (f"{LOOK} rig:=ncree_three_story", "rig 'ncree_three_story': unknown, .*, did you mean ncree_three_storey?"),
    (f"{LOOK} rig:=folder.yaml", "rig file folder.yaml: a folder, expected a file"),
    (f"{PLANT} -p lockstpe:=true", "parameter lockstpe: unknown, plant has autostart, .*, did you mean lockstep?"),
    # what is given
    (f"{PLANT} -p duration:=ten", "parameter duration: 'ten', expected a number, at least 0.0"),
    (f"{PLANT} -p wait_for:=[brace_comand]", "parameter wait_for: .*, expected a list .*, did you mean brace_command?"),
    (f"{PLANT} -p sensor_faults:=[a9=zero]", "sensor fault 'a9=zero': expected CHANNEL=KIND .* out of x1, x2, .*"),
    ("abrace_plant/plant -p duration:=10.0", "argument '-p': unknown, expected --ros-args -p NAME:=VALUE, .*"),
    ("abrace_lqg/controller", "parameter name: not given, expected --params-file FILE, the controller file .*"),
    # rcl's own words for arguments that it cannot read, in one line
    (f"{PLANT} -p duration=10", "ROS arguments: .*rule: '-p duration=10'; expected --ros-args -p NAME:=VALUE, .*"),
    (f"{PLANT} -p 'cpu_affinity:=[1, 2.5]'", "ROS arguments: .*Sequence should be of same type.*; expected .*"),
    (f"{PLANT} --params-file tab.yaml", "ROS arguments: .*'--params-file tab.yaml'.*; expected .*"),
    (
        "abrace_bags/logger --ros-args -p topics:=[a]",
        "parameter output: not given, expected -p output:=text: .*new directory.*",
    ),
    (
        "abrace_bags/logger --ros-args -p output:=b -p 'facts:=[a=1, a=2]'",
        "parameter facts: .*, expected each key once",
    ),
    (
        "abrace_bags/logger --ros-args -p output:=b -p every:=[response]",
        "parameter every: 'response', expected topic=n, one of n messages, as response=5",
    ),
    (
        "abrace_bags/logger --ros-args -p output:=b -p every:=[respons=5]",
        "parameter every: respons is not among the topics, expected one of .*, did you mean response?",
    ),
    ("abrace_bags/logger --ros-args -p output:=b -p attachments:=[none.yaml]", "attachment none.yaml: .*"),
    ("abrace_bags/logger --ros-args -p output:=b -p split_duration:=1e300", "parameter split_duration: .*0.0 to.*"),
    ("abrace_plant/check_sensors", "parameters device, bag: expected one of them"),
    (
        "abrace_plant/check_sensors --ros-args -p device:=none",
        "device 'none': unknown, expected a file ending in .yaml or one of emulator",
    ),
    # rig and campaign files
    (f"{EMULATE} tab.yaml", "rig file tab.yaml: line 9: not YAML: a tab, expected spaces"),
    (
        f"{EMULATE} unknown.yaml",
        "rig file unknown.yaml: .*massses: unknown key, did you mean masses?; sampel_rate: unknown key, did you .*",
    ),
    (f"{EMULATE} unit.yaml", "rig file unit.yaml: .*capacity: '25 kg', expected a number in N, or one with its .*"),
    ("abrace campaign quotes.yaml", ".*: step a: test.duration: '2.0', expected a valid number"),
    ("abrace campaign scale.yaml", ".*: step a: .*el_centro exceeds the table's limits: .*, expected a smaller .*"),
    # records, bags, models
    (f"{SHAKE} record:=el_centr", "ground motion el_centr: no such file, and no such name .*, did you mean el_centro?"),
    (f"{SHAKE} record:={{bag}} -p channel:=x1", ".*one of w, a1.*"),
    (f"{SHAKE} record:=word.csv", "ground motion word.csv, line 3: 'n/a' in acceleration, expected a finite number"),
    (f"{MOVE} record:=white_noise", "parameter duration: .*white_noise.*"),
    (
        f"{MOVE} record:=el_centro -p peak_acceleration:=30.0",
        ".* exceeds the table's limits: acceleration 30 m/s\\^2 at 2.178 s.* limit is 10.*displacement 0.94.*",
    ),
    (
        f"{MOVE} record:=white_noise -p duration:=240.0 -p 'band:=[0.0, 10.0]'",
        "ground motion white_noise exceeds the table's limits: displacement.*a band that begins higher.*",
    ),
    ("abrace_sysid/identify --ros-args -p output:=o", "parameter table: .*"),
    ("abrace_sysid/identify_data --ros-args -p data:=d.npz -p inputs:=[u] -p output:=o", ".*d.npz: No such file.*"),
    ("abrace_sysid/ambient --ros-args -p test:={pushed} -p output:=o", ".*an ambient test is without commands.*"),
    ("abrace_sysid/validate --ros-args -p test:={bag} -p model:=no.json -p output:=o", "model file no.json: .*"),
    (f"{SHAKE} record:=still.txt -p unit:=g", "ground motion still.txt: no times in the file.*"),
    ("abrace bag info none", "none: no such bag, expected a bag directory or an MCAP file"),
    (
        "abrace_bags/replay --ros-args -p bag:=folder.yaml",
        "folder.yaml: no MCAP or sqlite3 file in it, expected a bag directory",
    ),
    (
        "abrace_lqg/design --ros-args -p model:=model.json -p output:=o.yaml",
        "model file model.json: line 1: not JSON: column 2: .*",
    ),
    ("abrace_lqg/design --ros-args -p model:=model.json -p output:=o.txt", ".*ends in .yaml.*"),
    ("abrace report folder.yaml", "results file .*timing.json: No such file or directory"),
    # disk and network
    (f"{SERVE} address:=0.0.0.0", "parameter address: 0.0.0.0, beyond this machine, expected token_file, .*"),
    (f"{VIEW} host:=192.0.2.1", "server: cannot listen on 192.0.2.1, port 8765: .*"),
    ("abrace_bags/logger --ros-args -p output:={bag}", "bag .* exists already, expected a new directory"),
    (
        "abrace_plant/sensor_bridge --ros-args -p device:=device.yaml",
        "parameter stop_heartbeat: not given, .*",
    ),
    (
        "abrace_plant/sensor_bridge --ros-args -p device:=device.yaml -p stop_heartbeat:=0.0",
        "parameter stop_heartbeat: 0.0, expected a number, at least 0.02, not empty",
    ),
    (
        "abrace_plant/sensor_bridge --ros-args -p device:=device.yaml -p stop_heartbeat:=600.0",
        "udp device 127.0.0.1:15000: cannot receive at 0.0.0.0:{port}: Address already in use",
    ),
]
VARIABLES = [
    ("ROS_DOMAIN_ID", "300", "expected 0 to 232"),
    ("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp", "expected Fast DDS: .*rmw_fastrtps_cpp.*"),
    ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCAL", "expected SUBNET or .*, did you mean LOCALHOST?"),
    ("FASTRTPS_DEFAULT_PROFILES_FILE", "none.xml", "expected a file"),
]


pytestmark = pytest.mark.usefixtures("domain")


@pytest.fixture(scope="module")
def laboratory(domain, tmp_path_factory):  # noqa: ARG001
    """A folder with the wrong files, a bag, and a port that is taken."""
    folder = tmp_path_factory.mktemp("mistakes")
    for name, content in FILES.items():
        (folder / name).write_text(content)
    (folder / "folder.yaml").mkdir()
    write_bag(simulate("ncree_three_storey", np.zeros(50)), folder / "bag")
    write_bag(simulate("ncree_three_storey", command=np.ones(50)), folder / "pushed")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        names = {"bag": "bag", "pushed": "pushed", "port": taken.getsockname()[1]}
        device = (CONFIG / "devices/emulator.yaml").read_text().replace("15001", str(names["port"]))
        (folder / "device.yaml").write_text(device.replace("../", f"{CONFIG}/"))
        yield folder, names


def run_node(package: str, name: str, words: list[str]) -> tuple[int, str]:
    """Exit code and errors of a node, a process of its own."""
    ended = run_forked([find_executable(package, name), *words])
    return ended.returncode, ended.stderr


def run_command(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and errors of the command `abrace`, in this process."""
    try:
        code = main(words)
    except SystemExit as ended:
        code = int(ended.code or 0)
    return code, capsys.readouterr().err


def pattern_of(expected: str) -> str:
    """A regular expression in which a question mark, a plus sign and square brackets stand for themselves."""
    return re.sub(r"(?<!\\)([?\[\]^])", r"\\\1", expected)


@pytest.mark.parametrize(("command", "expected"), MISTAKES, ids=[command for command, _ in MISTAKES])
def test_a_mistake_is_one_line_that_says_what_where_and_what_was_expected(
    laboratory, monkeypatch, capsys, command, expected
):
    folder, names = laboratory
    monkeypatch.chdir(folder)
    first, *words = shlex.split(command.format(**names))
    package, _, name = first.rpartition("/")
    code, errors = run_node(package, name, words) if package else run_command(words, capsys)
    assert code == 2, errors
    (line,) = errors.splitlines()
    program, _, message = line.partition(": ")
    assert program.split()[0] == name
    assert re.fullmatch(pattern_of(expected.replace("{port}", str(names["port"]))), message), message
    for wording in ("lexeme", "Input should be", "pydantic", "Traceback", "rcl", "argparse", "<block", "literal"):
        assert wording not in message
    assert sorted(path.name for path in folder.iterdir()) == sorted(
        [*FILES, "bag", "pushed", "device.yaml", "folder.yaml"]
    )


@pytest.mark.parametrize(("name", "value", "expected"), VARIABLES)
def test_a_wrong_variable_is_one_line_from_nodes_and_commands(monkeypatch, capsys, name, value, expected):
    monkeypatch.setenv(name, value)
    ended = {"plant": run_node("abrace_plant", "plant", []), "abrace": run_command(["status"], capsys)}
    for program, (code, errors) in ended.items():
        assert code == 2
        assert re.fullmatch(pattern_of(f"{program}: {name}={value}, {expected}\n"), errors), errors

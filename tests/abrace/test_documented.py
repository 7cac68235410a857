# SPDX-License-Identifier: Apache-2.0
"""Every documented value of every option runs to a result, by one name, default and range wherever it can be given."""

from __future__ import annotations

import inspect
import re
from typing import Any

import documented
import pytest
from campaign_file import day
from documented import CALLS, RIG, RUNS, Data, missing, result
from forked import run_forked, run_node

import abrace
from abrace.campaign.file import load_campaign
from abrace.campaign.plan import check_campaign
from abrace.campaign.tasks import Ambient, Design, Identify, given_options
from abrace_core import AbraceError
from abrace_core.model.controller_file import load_controller
from abrace_lqg.nodes import design as design_node
from abrace_node.parameters import parameters_of
from abrace_plant.nodes import ground_motion, record
from abrace_sysid.nodes import ambient, identify, identify_data

NODES = {
    "identify": ("abrace_sysid", identify),
    "identify_data": ("abrace_sysid", identify_data),
    "identify_ambient": ("abrace_sysid", ambient),
    "design": ("abrace_lqg", design_node),
}
TASKS = {"identify": Identify, "identify_ambient": Ambient, "design": Design}

AS_NODES = [
    ("identify_data", 1, {"data": "{data}", "validation": "{data}"}, "model.json"),
    ("identify_ambient", 1, {"test": "{table}", "before": "{table}"}, "ambient_stabilization.svg"),
    ("design", 1, {"model": "{model}/reduced.json", "check_models": "{model}/model.json"}, ""),
]
"""Verb, number of the run, input files, a result; `identify`: tests/graph/test_offline.py, `make verify`."""
STUDIES = [
    ("fragility", 2, ["{model}", "--controllers", "{law}"], "zero command: d1 above 0.01 m", "fragility.csv"),
    (
        "explore",
        2,
        ["{model}", "--simulation-model", "{model}", "--weights", "{weights}", "--rig", RIG],
        "most robust",
        "exploration.csv",
    ),
]
"""Verb and command, number of the run, files, what is printed and written."""


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Data:
    return Data(tmp_path_factory.mktemp("documented"))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("verb", "number"),
    [
        # `make verify` runs all: also the slowest ones, and those that are given to nodes and commands below
        pytest.param(verb, number, id=f"{verb} {number}")
        for verb, (_, runs) in RUNS.items()
        for number in range(len(runs))
        if (verb, number) not in {*documented.SLOW, *((each[0], each[1]) for each in (*AS_NODES, *STUDIES))}
    ],
)
def test_every_documented_value_runs_to_a_result(verb, number, data):
    result(verb, RUNS[verb][1][number], data, number)


def test_every_other_public_function_runs_to_a_result_with_each_of_its_arguments(data, tmp_path):
    given: dict[str, set[str]] = {}
    for name, keywords, is_right in CALLS:
        found = keywords(data, tmp_path)
        assert is_right(getattr(abrace, name)(**found)), name
        given.setdefault(name, set()).update(found)
    functions = {name: getattr(abrace, name) for name in abrace.__all__ if inspect.isfunction(getattr(abrace, name))}
    assert given == {
        name: set(inspect.signature(one).parameters) for name, one in functions.items() if name not in RUNS
    }


@pytest.mark.parametrize("verb", RUNS)
def test_no_option_or_value_is_documented_that_is_not_run(verb):
    assert not missing(verb), f"documented, but in no run of tests/support/documented.py: {sorted(missing(verb))}"


@pytest.mark.parametrize("verb", [verb for verb in RUNS if verb != "record"])
def test_a_function_takes_the_options_of_its_class_and_says_what_they_are(verb):
    options, function = RUNS[verb][0], getattr(abrace, verb)
    parameters = inspect.signature(function).parameters
    for name, option in options.listed().items():
        assert re.search(rf"^ +{name}$|^ +inputs, outputs$", function.__doc__, re.MULTILINE), name
        if not option.required and name not in ("inputs", "outputs", "channels"):
            default = parameters[name].default
            assert (list(default) if isinstance(default, tuple | dict) else default) == option.default, name
    assert set(options.listed()) <= set(parameters)


@pytest.mark.parametrize("verb", NODES)
def test_a_node_has_the_options_of_its_class_and_files(verb):
    module, options = NODES[verb][1], RUNS[verb][0]
    of_class = parameters_of(options)
    assert [each for each in module.PARAMETERS if each in of_class] == of_class
    others = {each.name for each in module.PARAMETERS} - set(options.listed())
    files = {"table", "command", "data", "validation", "test", "before", "model", "check_models", "weights", "output"}
    assert others <= files, "an option of the node alone"


@pytest.mark.parametrize("verb", TASKS)
def test_a_campaign_s_step_has_the_options_of_its_class_and_names_of_steps_and_files(verb):
    options = RUNS[verb][0]
    assert set(options.listed()) <= set(TASKS[verb].model_fields)
    steps = {"table", "command", "test", "before", "model", "weights"}
    assert set(TASKS[verb].model_fields) - set(options.listed()) <= steps


def test_a_record_that_is_played_has_one_set_of_options():
    of_class = parameters_of(RUNS["record"][0])
    for table in (ground_motion.PARAMETERS, record.PARAMETERS):
        assert [each for each in table if each in of_class] == of_class


def as_given(value: Any) -> str:
    """A value of an option as in `-p name:=value`."""
    if isinstance(value, dict):
        return as_given(
            [f"{name}={one}" for name, each in value.items() for one in (each if isinstance(each, list) else [each])]
        )
    return f"[{', '.join(map(as_given, value))}]" if isinstance(value, list | tuple) else str(value)


@pytest.mark.parametrize(("verb", "number", "files", "written"), AS_NODES)
def test_every_parameter_of_an_offline_node_is_given_and_gives_its_result(verb, number, files, written, data, tmp_path):
    options, run = RUNS[verb][0], RUNS[verb][1][number]
    table, command = data.bags
    places = {"table": table, "command": command, "model": data.model, **data.written(tmp_path)}
    output = tmp_path / ("law.yaml" if verb == "design" else "found")
    given = {name: value.format(**places) for name, value in files.items()}
    package, module = NODES[verb]
    ended = run_node(
        package,
        module.__name__.rpartition(".")[2],
        **given,
        **{name: as_given(value) for name, value in run.items()},
        output=output,
    )
    assert ended.returncode == 0, ended.stderr
    assert (output / written).exists() if written else output.is_file()
    assert set(run) <= set(options.listed())
    if verb == "design":
        assert load_controller(output).force_limit.tolist() == [2e4]


def test_every_key_of_a_campaign_s_steps_is_given_and_passes_the_check(tmp_path):
    def keys(verb: str, number: int) -> str:
        return ", ".join(f"{name}: {as_given(value)}" for name, value in RUNS[verb][1][number].items())

    noise = "band: [0.0, 30.0], seed: 1"
    path = day(
        tmp_path,
        f"{{name: w, test: {{duration: 70.0, ground_motion: {{record: white_noise, rms: 0.05, {noise}}}}}}}",
        f"{{name: u, test: {{duration: 70.0, excitation: {{rms: 900.0, {noise}}}}}}}",
        *(
            f"{{name: m{number}, identify: {{table: w, command: u, {keys('identify', number)}}}}}"
            for number in range(len(RUNS["identify"][1]))
        ),
        f"{{name: d, design: {{model: m1, weights: lqg3, {keys('design', 1)}}}}}",
        f"{{name: a, ambient: {{test: w, {keys('identify_ambient', 1)}}}}}",
    )
    check_campaign(path)
    tasks = load_campaign(path).tasks
    for verb, number, task in (("identify", 1, "m1"), ("design", 1, "d"), ("identify_ambient", 1, "a")):
        options = RUNS[verb][0]
        wanted = options.of(RUNS[verb][1][number])
        assert options.of(given_options(tasks[task], options)) == wanted


@pytest.mark.parametrize(("verb", "number", "files", "said", "written"), STUDIES)
def test_every_option_of_a_study_s_command_is_given_and_gives_its_result(
    verb, number, files, said, written, data, tmp_path
):
    run, places = RUNS[verb][1][number], {"model": data.model, "law": data.law, **data.written(tmp_path)}
    words = [text for name, value in run.items() for text in (f"--{name.replace('_', '-')}", *as_words(value))]
    command = ["abrace", verb, *(each.format(**places) for each in files), *words, "--output", tmp_path / "found"]
    ended = run_forked(command, timeout=300.0)
    assert ended.returncode == 0, ended.stderr
    assert said in ended.stdout
    assert (tmp_path / "found" / written).is_file()


@pytest.mark.parametrize(("kind", "written"), [("--c", "controller.c"), ("--fmu", "")])
def test_every_option_of_the_command_export_is_given_and_gives_its_result(kind, written, data, tmp_path):
    output = tmp_path / ("sources" if kind == "--c" else "law.fmu")
    ended = run_forked(
        ["abrace", "export", data.law, kind, "--rate-limit", "1e6", "--ramp-time", "0.4", "--output", output]
    )
    assert ended.returncode == 0, ended.stderr
    assert (output / written).is_file()


def as_words(value: Any) -> list[str]:
    text = as_given(value)
    return text.strip("[]").split(", ") if isinstance(value, dict | list | tuple) else [text]


OBJECT = object()
WRONG: list[Any] = [OBJECT, "wrong", float("nan"), -1, {"a": OBJECT}, [OBJECT]]


@pytest.mark.parametrize("verb", [verb for verb in RUNS if verb != "record"])
def test_a_wrong_value_of_any_option_is_one_line(verb, data):
    """What it is, where, and what was expected; a value that is right for an option, as a name, is no mistake."""
    options, function = RUNS[verb][0], getattr(abrace, verb)
    given = {"identify": data.tests, "identify_ambient": data.tests[:1], "identify_data": (data.columns,)}
    arguments = given.get(verb, (RIG,))
    base = {**RUNS[verb][1][0]}
    tried = 0
    for name in options.listed():
        for value in WRONG:
            try:
                options.of({**base, name: value})
            except AbraceError as expected:
                with pytest.raises(AbraceError, match=re.escape(str(expected))) as error:
                    function(*arguments, **{**base, name: value})
                assert "\n" not in str(error.value)
                assert f"{options.who}: {name}" in str(error.value)
                assert "expected" in str(error.value)
                tried += 1
    assert tried > 3 * len(options.listed())

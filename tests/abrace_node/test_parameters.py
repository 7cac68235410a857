# SPDX-License-Identifier: Apache-2.0
"""The parameter table of a node: what it declares, and how it refuses what does not fit."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

import domain_coordinator
import pytest
import rclpy
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.parameter import get_parameter_value

from abrace_core import AbraceError
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter, declare

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

TABLE = [
    Parameter("rate", 500.0, "Hz", minimum=1.0, maximum=1e4),
    Parameter("seed", 3, "of the noise", minimum=0),
    Parameter("lockstep", False, "or by the clock"),
    Parameter("rig", "ncree", "name", required=True),
    Parameter("unit", "", "of the record", choices=("", "g", "m/s^2")),
    Parameter("band", [0.0, 10.0], "Hz", minimum=0.0),
    Parameter("inputs", ["table"], "answered", choices=("table", "braces"), required=True),
    Parameter("matrix", [], "row by row", element=float),
]
LIVE = [
    Parameter("faults", [], "of sensors", element=str, live=True),
    Parameter("gains", [1.0], "of channels", live=True),
    Parameter("file", "", "to use next", live=True),
]


@pytest.fixture(scope="module")
def context() -> Iterator[rclpy.Context]:
    """A ROS domain of our own on this machine."""
    with domain_coordinator.domain_id() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        context = rclpy.Context()
        context.init(args=[], domain_id=domain)
        yield context
        context.try_shutdown()


@pytest.fixture
def node(context: rclpy.Context) -> Iterator[Callable[..., Node]]:
    """Makes a node that was started with these parameters."""
    made: list[Node] = []

    def make(**given: Any) -> Node:
        overrides = [RosParameter(name, value=value) for name, value in given.items()]
        made.append(Node("rig", context=context, parameter_overrides=overrides))
        return made[-1]

    yield make
    for one in made:
        one.destroy_node()


def test_defaults_hold_where_nothing_is_given(node):
    values = vars(declare(node(), TABLE))
    assert values == {parameter.name: parameter.default for parameter in TABLE}
    assert {name: type(value) for name, value in values.items()} == {p.name: type(p.default) for p in TABLE}


def test_the_node_shows_each_with_type_description_and_range(node):
    rig = node(rate=200.0)
    declare(rig, TABLE)
    assert rig.get_parameter("rate").value == 200.0
    shown = {parameter.name: rig.describe_parameter(parameter.name) for parameter in TABLE}
    assert all(descriptor.read_only for descriptor in shown.values())
    assert shown["rate"].description == "Hz"
    (allowed,) = shown["rate"].floating_point_range
    assert (allowed.from_value, allowed.to_value) == (1.0, 1e4)
    assert shown["seed"].integer_range[0].from_value == 0
    assert shown["unit"].additional_constraints == "a text out of an empty text, g, m/s^2"
    types = [ParameterType.PARAMETER_DOUBLE_ARRAY, ParameterType.PARAMETER_STRING_ARRAY]
    assert [shown[name].type for name in ("band", "inputs")] == types


def test_a_running_node_changes_none(node):
    rig = node()
    declare(rig, TABLE)
    (answer,) = rig.set_parameters([RosParameter("rate", value=100.0)])
    assert not answer.successful
    assert rig.get_parameter("rate").value == 500.0


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("rate", 0, "a number from 1.0 to 10000.0"),
        ("rate", "200.0", "a number from"),
        ("rate", 0.5, "from 1.0 to 10000.0"),
        ("rate", math.nan, "from 1.0 to 10000.0"),
        ("seed", 1.0, "a whole number, at least 0"),
        ("seed", True, "a whole number"),
        ("lockstep", 1, "true or false"),
        ("rig", "", "a text, not empty"),
        ("unit", "ft", "out of an empty text, g, m/s^2"),
        ("band", -10.0, "a list like [3.0], at least 0.0"),
        ("band", [0.0, -1.0], "at least 0.0"),
        ("inputs", ["table", "wind"], "out of table, braces"),
        ("inputs", "brace", "out of table, braces, not empty, did you mean braces?"),
        ("inputs", 3.0, "a list like [text]"),
        ("matrix", [math.inf], "a list like [3.0]"),
    ],
)
def test_a_value_that_does_not_fit_is_refused_with_what_was_expected(node, name, value, expected):
    with pytest.raises(AbraceError, match=rf"^parameter {name}: .*expected .*{re.escape(expected)}"):
        declare(node(**{name: value}), TABLE)


def test_whole_numbers_are_taken_for_numbers_with_a_decimal_point(node):
    rig = node(rate=200, band=[0, 10])
    given = declare(rig, TABLE)
    assert (given.rate, given.band) == (200.0, [0.0, 10.0])
    assert rig.get_parameter("rate").type_ == RosParameter.Type.DOUBLE


def test_one_value_where_a_list_is_meant_is_a_list_of_one(node):
    rig = node(band=10.0, inputs="braces")
    values = declare(rig, TABLE)
    assert (values.band, values.inputs) == ([10.0], ["braces"])
    assert list(rig.get_parameter("band").value) == [10.0]


def test_a_required_parameter_that_is_missing_is_told_with_how_to_give_it(node):
    for table, expected in (
        ([Parameter("bag", "", "bag to read", required=True)], "-p bag:=text: bag to read"),
        ([Parameter("bags", [], "bags to read", element=str, required=True)], r"-p bags:=\[text\]: bags to read"),
        ([Parameter("a_d", [], "A_d", element=float, required=True, source="--params-file F")], "--params-file F"),
    ):
        with pytest.raises(AbraceError, match=rf"^parameter {table[0].name}: not given, expected {expected}$"):
            declare(node(), table)


def test_an_unknown_name_is_refused_with_those_that_there_are(node):
    with pytest.raises(AbraceError, match=r"parameter rat: unknown, rig has band, .*, rate, .*, did you mean rate"):
        declare(node(rat=200.0), TABLE)


@pytest.mark.parametrize("name", ["rate", "use_sim_time"])
def test_two_parameters_of_one_name_are_refused(node, name):
    with pytest.raises(AbraceError, match=f"^parameter {name}: rig has two of this name, expected another one$"):
        declare(node(), [*TABLE, Parameter(name, 1.0, "of a law of one's own")])


class Live(AbraceNode):
    """A node with live parameters that remembers what it applied, and refuses a `file` of the name `absent`."""

    def __init__(self, context: rclpy.Context) -> None:
        super().__init__("live", LIVE, context=context)
        self.applied: list[tuple[str, Any]] = []

    def prepare_change(self, name: str, value: Any) -> Callable[[], None]:
        if value == "absent":
            raise AbraceError("file absent: no such file")
        return lambda: self.applied.append((name, value))

    def given(self, name: str) -> Any:
        """The value that the node uses, which has to be the one that ROS shows, with the table's type."""
        parameter, used = self.get_parameter(name), getattr(self.parameters, name)
        assert (list(parameter.value) if isinstance(used, list) else parameter.value) == used
        assert parameter.type_.value == self.describe_parameter(name).type
        return used


@pytest.fixture
def live(context: rclpy.Context) -> Iterator[Live]:
    """A node with live parameters."""
    made = Live(context)
    yield made
    made.destroy_node()


def sent(name: str, value: ParameterValue) -> RosParameter:
    """A parameter as it comes over the service."""
    return RosParameter.from_parameter_msg(ParameterMessage(name=name, value=value))


EMPTY_TYPES = [kind.value for kind in RosParameter.Type if kind.name.endswith("_ARRAY")]


@pytest.mark.parametrize(
    "empty",
    [
        *(get_parameter_value(text) for text in ("[]", "[ ]", "''", "['']")),
        *(ParameterValue(type=kind) for kind in EMPTY_TYPES),
    ],
    ids=lambda value: f"{value.type}{list(value.string_array_value)}",
)
def test_a_live_list_becomes_empty_in_every_spelling(live, empty):
    assert live.set_parameters_atomically([RosParameter("faults", value="a2=stuck")]).successful
    assert live.given("faults") == ["a2=stuck"]
    result = live.set_parameters_atomically([sent("faults", empty)])
    assert result.successful, result.reason
    assert live.given("faults") == []
    assert not live.set_parameters_atomically([sent("gains", empty)]).successful
    assert live.given("gains") == [1.0]
    assert live.applied == [("faults", ["a2=stuck"]), ("faults", [])]


@pytest.mark.parametrize("name", ["faults", "gains", "file"])
def test_a_parameter_cannot_be_deleted(live, name):
    before = live.given(name)
    (result,) = live.set_parameters([sent(name, ParameterValue())])
    assert (result.successful, result.reason) == (False, "Static parameter cannot be undeclared")
    assert live.given(name) == before
    assert not live.applied


def test_parameters_that_are_refused_together_leave_nothing_changed(live):
    good = RosParameter("faults", value=["a2=stuck"])
    for wrong, reason in (
        (RosParameter("file", value="absent"), "file absent: no such file"),
        (RosParameter("gains", value=[math.nan]), "parameter gains: [nan], expected a list like [3.0]"),
        (RosParameter("gains", value="3"), "Wrong parameter type"),
    ):
        result = live.set_parameters_atomically([good, wrong])
        assert not result.successful
        assert reason in result.reason
        assert not live.applied
        assert [live.given(name) for name in ("faults", "gains", "file")] == [[], [1.0], ""]
    files = [RosParameter("file", value=name) for name in ("one", "two")]
    assert live.set_parameters_atomically([good, *files]).successful
    assert live.applied == [("faults", ["a2=stuck"]), ("file", "two")], "of two values the last"

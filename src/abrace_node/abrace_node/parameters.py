# SPDX-License-Identifier: Apache-2.0
"""A node's parameters: one table from which they are declared, checked and described."""

from __future__ import annotations

import sys
import textwrap
from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.exceptions import InvalidParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from abrace_core import AbraceError
from abrace_core.files.suggestion import did_you_mean

if TYPE_CHECKING:
    from abrace_core.files.options import Options

_TYPES = {
    bool: RosParameter.Type.BOOL,
    int: RosParameter.Type.INTEGER,
    float: RosParameter.Type.DOUBLE,
    str: RosParameter.Type.STRING,
}
_ARRAY_TYPES = {
    bool: RosParameter.Type.BOOL_ARRAY,
    int: RosParameter.Type.INTEGER_ARRAY,
    float: RosParameter.Type.DOUBLE_ARRAY,
    str: RosParameter.Type.STRING_ARRAY,
}
_EXAMPLES = {bool: "true", int: "3", float: "3.0", str: "text"}


@dataclass(frozen=True)
class Parameter:
    """One row of a node's parameter table.

    Parameters
    ----------
    name
        Name, as in `-p name:=value`.
    default
        Default value; its type is the parameter's type, a list for an array.
    description
        Description with the unit.
    minimum, maximum
        Range of a number, or of each number of an array.
    choices
        The valid values of a text, or of each text of an array; empty: any.
    element
        Type of an array's elements, for arrays that are empty by default.
    required
        Whether an empty value is refused.
    source
        How a required parameter is given, if not by `-p`.
    live
        Whether it may be changed while the node runs; see `AbraceNode.prepare_change`.
    """

    name: str
    default: bool | int | float | str | list
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    element: type | None = None
    required: bool = False
    source: str = ""
    live: bool = False

    @property
    def _element(self) -> type:
        if not isinstance(self.default, list):
            return type(self.default)
        return self.element or type(self.default[0])

    @property
    def _may_be_empty(self) -> bool:
        return not self.required and (self._element is str or self.default == [])

    @property
    def ros_type(self) -> RosParameter.Type:
        """The ROS parameter type."""
        return (_ARRAY_TYPES if isinstance(self.default, list) else _TYPES)[self._element]

    def expected(self) -> str:
        """Description of the valid values."""
        kind = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}
        text = (
            kind[self._element] if not isinstance(self.default, list) else f"a list like [{_EXAMPLES[self._element]}]"
        )
        if self.choices:
            text += f" out of {', '.join(choice or 'an empty text' for choice in self.choices)}"
        if self.minimum is not None and self.maximum is not None:
            text += f" from {self.minimum} to {self.maximum}"
        elif self.minimum is not None:
            text += f", at least {self.minimum}"
        if self.required:
            text += ", not empty"
        return text

    def descriptor(self) -> ParameterDescriptor:
        """The descriptor that ROS tools show."""
        descriptor = ParameterDescriptor(
            description=self.description,
            read_only=not self.live,
            additional_constraints=self.expected(),
            type=self.ros_type.value,
        )
        low = self.minimum if self.minimum is not None else -sys.float_info.max
        high = self.maximum if self.maximum is not None else sys.float_info.max
        if (self.minimum, self.maximum) != (None, None) and not isinstance(self.default, list):
            if self._element is float:
                descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
            else:
                bounds = IntegerRange(from_value=int(max(low, -(2**63))), to_value=int(min(high, 2**63 - 1)), step=0)
                descriptor.integer_range = [bounds]
        return descriptor

    def missing(self) -> AbraceError:
        """The error to raise when a required parameter is not given."""
        example = _EXAMPLES[self._element] if not isinstance(self.default, list) else f"[{_EXAMPLES[self._element]}]"
        source = self.source or f"-p {self.name}:={example}: {self.description}"
        return AbraceError(f"parameter {self.name}: not given, expected {source}")

    def typed(self, given: RosParameter) -> RosParameter:
        """`given`, converted to the parameter's own type: 10 to 10.0 or "10", a single value to a list, an empty list.

        An empty list has no type from `-p x:=[]`, booleans from `ros2 param set NODE x []`, and bytes from Python; for
        tools that cannot pass an empty list, `['']` is one, too.
        """
        if self._element is float and given.type_ in (_TYPES[int], _ARRAY_TYPES[int]):
            whole = given.type_ == _TYPES[int]
            given = RosParameter(self.name, value=float(given.value) if whole else [float(one) for one in given.value])
        if self._element is str and given.type_ in (_TYPES[int], _TYPES[float], _ARRAY_TYPES[int]):  # channel:=2
            texts = [str(one) for one in ([given.value] if given.type_ in _TYPES.values() else given.value)]
            given = RosParameter(self.name, value=texts if given.type_ == _ARRAY_TYPES[int] else texts[0])
        if not isinstance(self.default, list):
            return given
        value = list(given.value) if isinstance(given.value, (tuple, array)) else given.value
        if value is None or (isinstance(value, (str, list)) and all(entry == "" for entry in value)):
            return RosParameter(self.name, self.ros_type, [])
        if given.type_ == _TYPES[self._element]:
            return RosParameter(self.name, self.ros_type, [value])
        return given

    def check(self, given: RosParameter) -> Any:
        """The value, if it is valid; a single value for an array is a list of one.

        Raises
        ------
        AbraceError
            If it has another type or is out of range.
        """
        typed = self.typed(given)
        value = list(typed.value) if isinstance(typed.value, (tuple, array)) else typed.value
        if typed.type_ != self.ros_type or not self.holds(value):
            raise AbraceError(f"parameter {self.name}: {given.value!r}, expected {self.expected()}{self._near(value)}")
        return value

    def _near(self, value: Any) -> str:
        """A suggestion of the choice that is most similar to a wrong value."""
        texts = [text for text in (value if isinstance(value, list) else [value]) if isinstance(text, str)]
        return next((did_you_mean(text, self.choices) for text in texts if text not in self.choices), "")

    def holds(self, value: Any) -> bool:
        """Whether a value of the right type is in range."""
        if value in ("", []) and not self._may_be_empty:
            return False
        values = value if isinstance(self.default, list) else [value]
        if self._element is str:
            return not self.choices or all(entry in self.choices for entry in values)
        low = self.minimum if self.minimum is not None else -float("inf")
        high = self.maximum if self.maximum is not None else float("inf")
        return all(low <= entry <= high and abs(entry) != float("inf") for entry in values)


def parameters_of(options: type[Options]) -> list[Parameter]:
    """A parameter for each option of a verb, with its default, range and description."""
    return [
        Parameter(
            each.name,
            each.default,
            each.description,
            each.low,
            each.high,
            each.choices,
            each.kind if each.many else None,
            each.required,
        )
        for each in options.listed().values()
    ]


def parameter_help(table: Sequence[Parameter]) -> str:
    """The help text of a table's parameters: each with its default, description and valid values."""
    lines = []
    for parameter in table:
        lines.append(f"  -p {as_given(parameter)}")
        described = f"{parameter.description} ({parameter.expected()})"
        lines += textwrap.wrap(described, 100, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return "\n".join(lines)


def as_given(parameter: Parameter) -> str:
    """A parameter with its default, as on the command line: `name:=value`."""
    default = "..." if parameter.required and not parameter.default else _as_given(parameter.default)
    return f"{parameter.name}:={default}"


def _as_given(value: Any) -> str:
    """A value as on the command line, after `:=`."""
    if isinstance(value, list):
        return f"[{','.join(map(_as_given, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value) or "''"


def declare(node: Node, table: Sequence[Parameter]) -> SimpleNamespace:
    """Declare the table's parameters on the node and return their values.

    Raises
    ------
    AbraceError
        For a value of the wrong type or out of range, for a parameter that the node does not have, and for two rows
        of one name.
    """
    values = SimpleNamespace()
    given = node._parameter_overrides
    for name, count in Counter([*node._parameters, *(parameter.name for parameter in table)]).items():
        if count > 1:
            raise AbraceError(f"parameter {name}: {node.get_name()} has two of this name, expected another one")
    known = {parameter.name for parameter in table} | set(node._parameters)
    for name in given:
        if name not in known and not name.startswith("qos_overrides."):
            names = [parameter.name for parameter in table]
            near = did_you_mean(name, names)
            raise AbraceError(f"parameter {name}: unknown, {node.get_name()} has {', '.join(sorted(names))}{near}")
    for parameter in table:
        if parameter.required and not parameter.default and parameter.name not in given:
            raise parameter.missing()
        value = parameter.check(given.get(parameter.name) or RosParameter(parameter.name, value=parameter.default))
        try:
            _declare(node, parameter, value)
        except InvalidParameterException as error:
            raise AbraceError(f"parameter {parameter.name}: {value!r}, expected {parameter.expected()}") from error
        setattr(values, parameter.name, value)
    return values


def _declare(node: Node, parameter: Parameter, value: Any) -> None:
    """Declare one parameter with its own type, also for an empty list, which rclpy takes for a list of bytes."""
    if value != []:
        node.declare_parameter(parameter.name, value, parameter.descriptor(), ignore_override=True)
        return
    node.declare_parameter(parameter.name, value, ParameterDescriptor(dynamic_typing=True), ignore_override=True)
    typed = RosParameter(parameter.name, parameter.ros_type, value)
    node.set_descriptor(parameter.name, parameter.descriptor(), typed.get_parameter_value())


def refuse_unknown_types(node: Node) -> None:
    """Make a node's services refuse parameters of types that do not exist; in rclpy 7.1 these end the process."""
    for service in node.services:
        if service.srv_type in (SetParameters, SetParametersAtomically):
            service.callback = _refusing(service.callback)


def _refusing(callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    known = [one.value for one in RosParameter.Type]

    def call(request: Any, response: Any) -> Any:
        wrong = [f"{one.name}: type {one.value.type}" for one in request.parameters if one.value.type not in known]
        if not wrong:
            return callback(request, response)
        reason = f"parameter {', '.join(wrong)}, expected a type of rcl_interfaces/msg/ParameterType"
        refused = SetParametersResult(successful=False, reason=reason)
        if isinstance(response, SetParameters.Response):
            response.results = [refused] * len(request.parameters)
        else:
            response.result = refused
        return response

    return call

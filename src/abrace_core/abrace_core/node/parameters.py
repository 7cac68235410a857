"""A node's parameters, declared, checked and described from one table."""

from __future__ import annotations

import sys
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from abrace_core.errors import AbraceError

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
_EMPTY_LISTS = (RosParameter.Type.BYTE_ARRAY, RosParameter.Type.NOT_SET)
"""ROS types of an empty list."""
_EXAMPLES = {bool: "true", int: "3", float: "3.0", str: "text"}


@dataclass(frozen=True)
class Parameter:
    """One row of a node's parameter table.

    Parameters
    ----------
    name
        As in `-p name:=value`.
    default
        Its type is the parameter's type; a list for an array.
    description
        What it is, with its unit.
    minimum, maximum
        Range of a number, or of each number of an array.
    choices
        The values that a text, or each text of an array, may have; empty: any.
    element
        Type of an array's elements, for arrays that are empty by default.
    required
        Whether an empty value is refused.
    live
        Whether it may be changed while the node runs; `AbraceNode.parameter_changed` then receives the new value.
    """

    name: str
    default: bool | int | float | str | list
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    element: type | None = None
    required: bool = False
    live: bool = False

    @property
    def _element(self) -> type:
        if not isinstance(self.default, list):
            return type(self.default)
        return self.element or type(self.default[0])

    @property
    def _may_be_empty(self) -> bool:
        return isinstance(self.default, list) and (self.default == [] or self._element is str)

    @property
    def ros_type(self) -> RosParameter.Type:
        """The ROS parameter type."""
        return (_ARRAY_TYPES if isinstance(self.default, list) else _TYPES)[self._element]

    def expected(self) -> str:
        """Description of the valid values."""
        kind = {bool: "true or false", int: "a whole number", float: "a number with a decimal point", str: "a text"}
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
            # the ROS type of an empty list is that of bytes; `check` checks the type of later values
            dynamic_typing=self.default == [],
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

    def check(self, given: RosParameter) -> Any:
        """The value, if it is valid; a single value for an array is a list of one.

        Raises
        ------
        AbraceError
            If it has another type or is out of range.
        """
        value, fits = given.value, given.type_ == self.ros_type
        if isinstance(self.default, list) and given.type_ == _TYPES[self._element]:
            value, fits = [value], True
        if self._may_be_empty and not value and given.type_ in _EMPTY_LISTS:
            value, fits = [], True
        if not fits or not self.holds(value):
            raise AbraceError(f"parameter {self.name}: {given.value!r}, expected {self.expected()}")
        return list(value) if isinstance(value, (list, tuple, array)) else value

    def holds(self, value: Any) -> bool:
        """Whether a value of the right type is in range."""
        if self.required and not value:
            return False
        values = value if isinstance(self.default, list) else [value]
        if self._element is str:
            return not self.choices or all(entry in self.choices for entry in values)
        low = self.minimum if self.minimum is not None else -float("inf")
        high = self.maximum if self.maximum is not None else float("inf")
        return all(low <= entry <= high and abs(entry) != float("inf") for entry in values)


def declare(node: Node, table: Sequence[Parameter]) -> SimpleNamespace:
    """Declare the table's parameters on the node and return their values.

    Raises
    ------
    AbraceError
        For a value of the wrong type or out of range, and for a parameter that the node does not have.
    """
    values = SimpleNamespace()
    given = node._parameter_overrides
    known = {parameter.name for parameter in table} | set(node._parameters)
    for name in given:
        if name not in known and not name.startswith("qos_overrides."):
            names = ", ".join(sorted(parameter.name for parameter in table))
            raise AbraceError(f"parameter {name}: unknown, {node.get_name()} has {names}")
    for parameter in table:
        value = parameter.check(given.get(parameter.name) or RosParameter(parameter.name, value=parameter.default))
        ros_value = RosParameter(parameter.name, parameter.ros_type, value).value
        try:
            node.declare_parameter(parameter.name, ros_value, parameter.descriptor(), ignore_override=True)
        except InvalidParameterException as error:
            raise AbraceError(f"parameter {parameter.name}: {value!r}, expected {parameter.expected()}") from error
        setattr(values, parameter.name, value)
    return values

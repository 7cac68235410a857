"""The controller as a ROS 2 parameter file: YAML that a node takes with `--params-file` and that says where it is from.

Numbers are written with 17 digits where they need them, so that reading gives back the same bits, and with a point, so
that ROS takes each for a double.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pydantic
import yaml

from abrace_core.config_file import Checked, read_config
from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_core.linear_model import LinearModel

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

Names = Annotated[list[str], pydantic.Field(min_length=1)]
Positive = Annotated[float, pydantic.Field(gt=0)]


class ControllerParameters(Checked):
    """The parameters, as a node declares them and the file lists them; matrices row by row.

    Parameters
    ----------
    name
        What the controller is called.
    model, weights, margins
        Facts: what it was designed from, what was asked for, and the margins that were predicted.
    sample_period
        [s].
    measured, commands
        Names of what it takes and gives.
    states
        Their number.
    force_limit
        (commands,) [N]: commands are cut to it, either way.
    a_d, b_d, c_d, d_d
        Eq. (13).
    g_d, p_d
        `Controller.correction` and `Controller.prediction`.
    """

    name: str
    model: str
    weights: str
    margins: str
    sample_period: Positive
    measured: Names
    commands: Names
    states: Annotated[int, pydantic.Field(ge=1)]
    force_limit: list[Positive]
    a_d: list[float]
    b_d: list[float]
    c_d: list[float]
    d_d: list[float]
    g_d: list[float]
    p_d: list[float]


class _Node(Checked):
    ros__parameters: ControllerParameters


class _File(Checked):
    nodes: Annotated[_Node, pydantic.Field(alias="/**")]


@dataclass(frozen=True)
class Controller:
    """A controller with what a run needs to know of it.

    Parameters
    ----------
    name
        What it is called.
    law
        Eq. (13): discrete model from the measured quantities to the commands.
    correction
        (states, commands) G_d: what is added to the next state for each newton by which the command that acted differs
        from the law's: q(n+1) = A_d q(n) + B_d y(n) + G_d (U_acted(n) - U_law(n)).
    prediction
        (measured, states + commands) P_d: the measured values that the estimate expects, P_d [q(n); U_acted(n)].
    force_limit
        (commands,) [N].
    model, weights, margins
        Facts, one line each: what it was designed from, what was asked for, the predicted margins.
    """

    name: str
    law: LinearModel
    correction: NDArray[np.float64]
    prediction: NDArray[np.float64]
    force_limit: NDArray[np.float64]
    model: str
    weights: str
    margins: str

    def __post_init__(self) -> None:
        law = self.law
        if not law.sample_period > 0:
            raise AbraceError(f"controller {self.name}: continuous, expected a discrete law")
        if law.order < 1:
            raise AbraceError(f"controller {self.name}: no states, expected 1 or more")
        radius = float(np.abs(np.linalg.eigvals(law.a)).max())
        if not radius < 1:
            raise AbraceError(
                f"controller {self.name}: the law itself is not stable (spectral radius of a_d {radius:.6g}), "
                "expected less than 1"
            )
        states, measured, commands = law.order, len(law.inputs), len(law.outputs)
        for key, shape in (("correction", (states, commands)), ("prediction", (measured, states + commands))):
            matrix = np.asarray(getattr(self, key), dtype=np.float64)
            if matrix.shape != shape or not np.isfinite(matrix).all():
                raise AbraceError(
                    f"controller {self.name}: {key} of shape {matrix.shape}, expected finite numbers of shape {shape}"
                )
            object.__setattr__(self, key, matrix)
        limit = np.asarray(self.force_limit, dtype=np.float64)
        if limit.shape != (len(law.outputs),) or not (np.isfinite(limit).all() and limit.min() > 0):
            raise AbraceError(
                f"controller {self.name}: force_limit {limit.tolist()}, "
                f"expected a force above zero for each of {', '.join(law.outputs)}"
            )
        object.__setattr__(self, "force_limit", limit)


def save_controller(controller: Controller, path: Path | str, proof: Sequence[str] = ()) -> None:
    """Write the controller's parameter file, atomically; the same controller gives the same bytes.

    Parameters
    ----------
    controller
        What to write.
    path
        Of the file.
    proof
        Lines of the controller's proof, for people to read: comments at the top of the file.

    Raises
    ------
    AbraceError
        If the file cannot be written.
    """
    law = controller.law
    facts = {key: " ".join(getattr(controller, key).split()) for key in ("name", "model", "weights", "margins")}
    lines = [
        f"# Controller {facts['name']}: Eq. (13), U(n) = C_d q(n) + D_d y(n), q(n+1) = A_d q(n) + B_d y(n)",
        "# + G_d (U_acted(n) - U(n)), U_acted being what limits left of U; y(n) = P_d [q(n); U_acted(n)] is expected.",
        "# A ROS 2 parameter file, written by abrace; SI units; matrices row by row.",
        f"# Made from: {facts['model']}",
        f"# Weights: {facts['weights']}",
        f"# Predicted: {facts['margins']}",
        *(f"# {line}" for line in proof),
        "/**:",
        "  ros__parameters:",
        *(f"    {key}: {_quoted(value)}" for key, value in facts.items()),
        f"    sample_period: {_number(law.sample_period)}",
        f"    measured: [{', '.join(map(_quoted, law.inputs))}]",
        f"    commands: [{', '.join(map(_quoted, law.outputs))}]",
        f"    states: {law.order}",
        f"    force_limit: [{_row(controller.force_limit)}]",
    ]
    eq_13 = (("a_d", law.a), ("b_d", law.b), ("c_d", law.c), ("d_d", law.d))
    for key, matrix in (*eq_13, ("g_d", controller.correction), ("p_d", controller.prediction)):
        rows = ",\n      ".join(_row(row) for row in matrix)
        lines.append(f"    {key}: [\n      {rows}]")
    write_text(path, "\n".join(lines) + "\n")


def load_controller(path: Path | str) -> Controller:
    """Read a controller's parameter file.

    Raises
    ------
    AbraceError
        Naming the file, the key and what was expected.
    """
    content = read_config(path, _File, "controller")
    return _controller(content.nodes.ros__parameters, f"controller file {path}")


def controller_from_parameters(parameters: Mapping[str, Any], source: str) -> Controller:
    """A controller from the parameters of a node.

    Parameters
    ----------
    parameters
        A value for each field of `ControllerParameters`; lists may be arrays.
    source
        Who asks, for messages.

    Raises
    ------
    AbraceError
        Naming the source, the parameter and what was expected.
    """
    values = {
        key: list(value) if hasattr(value, "__iter__") and not isinstance(value, str) else value
        for key, value in parameters.items()
    }
    try:
        checked = ControllerParameters.model_validate(values)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise AbraceError(f"{source}: {key}: {first['msg']}") from error
    return _controller(checked, source)


def _controller(parameters: ControllerParameters, source: str) -> Controller:
    """The controller that checked parameters describe, with lengths checked."""
    n, p, m = parameters.states, len(parameters.measured), len(parameters.commands)
    matrices: dict[str, NDArray[np.float64]] = {}
    eq_13 = (("a_d", (n, n)), ("b_d", (n, p)), ("c_d", (m, n)), ("d_d", (m, p)))
    for key, shape in (*eq_13, ("g_d", (n, m)), ("p_d", (p, n + m))):
        values = np.array(getattr(parameters, key))
        if len(values) != shape[0] * shape[1]:
            raise AbraceError(f"{source}: {key}: {len(values)} numbers, expected {shape[0]} rows of {shape[1]}")
        matrices[key[0]] = values.reshape(shape)
    try:
        law = LinearModel(
            matrices["a"],
            matrices["b"],
            matrices["c"],
            matrices["d"],
            inputs=tuple(parameters.measured),
            outputs=tuple(parameters.commands),
            sample_period=parameters.sample_period,
        )
        return Controller(
            parameters.name,
            law,
            matrices["g"],
            matrices["p"],
            np.array(parameters.force_limit),
            parameters.model,
            parameters.weights,
            parameters.margins,
        )
    except AbraceError as error:
        raise AbraceError(f"{source}: {error}") from error


def _row(values: Sequence[float] | NDArray[np.float64]) -> str:
    return ", ".join(_number(float(value)) for value in values)


def _number(value: float) -> str:
    """The shortest text that reads back as the same double, and as nothing but a double: with a point.

    Subnormal numbers, which ROS's parser takes for text, are written as zero.

    >>> _number(5.0), _number(1e-5), _number(0.1 + 0.2)
    ('5.0', '1.0e-05', '0.30000000000000004')
    """
    value = 0.0 if abs(value) < np.finfo(np.float64).tiny else value
    mantissa, e, exponent = repr(float(value)).partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.0") + e + exponent


def _quoted(text: str) -> str:
    """A YAML string in quotes, which ROS never takes for a number."""
    return yaml.safe_dump(text, default_style='"', width=10**9, allow_unicode=True).strip()

# SPDX-License-Identifier: Apache-2.0
"""The controller as a ROS 2 parameter file, for `--params-file`, with its origin and proof as comments.

Numbers are written such that reading gives back the same bits, and with a point, so that ROS takes each for a double.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pydantic
import yaml

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, read_config, validated, yaml_number
from abrace_core.files.writing import write_text
from abrace_core.model.lifting import divisor
from abrace_core.model.linear_model import LinearModel, load_mat, save_mat
from abrace_core.model.values import Value, read_only

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
        Name of the controller.
    model, weights, margins
        Texts: the model and the weights that it was designed with, and its predicted margins.
    sample_period
        [s].
    measured, commands
        Names of its inputs and outputs.
    states
        Number of states.
    force_limit
        (commands,) [N]: commands are limited to it in both directions.
    a_d, b_d, c_d, d_d
        Eq. (13).
    g_d, p_d
        `Controller.correction` and `Controller.prediction`.
    units
        SI units, as NAME=UNIT, of measured quantities and commands that are no rig's.
    rig_period
        Sample period of the rig [s], of whose samples every n-th is answered; 0: the controller's.
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
    units: list[str] = []
    rig_period: Annotated[float, pydantic.Field(ge=0)] = 0.0


class _Node(Checked):
    ros__parameters: ControllerParameters


class _File(Checked):
    nodes: Annotated[_Node, pydantic.Field(alias="/**")]


@dataclass(frozen=True, eq=False)
class Controller(Value):
    """A controller: its law, the observer form of its estimate, and its force limits.

    Parameters
    ----------
    name
        Name of the controller.
    law
        Eq. (13): discrete model from the measured quantities to the commands.
    correction
        (states, commands) G_d: change of the next state for each newton of difference between the applied command and
        the law's: q(n+1) = A_d q(n) + B_d y(n) + G_d (U_acted(n) - U_law(n)).
    prediction
        (measured, states + commands) P_d: the measured values that the estimate predicts, P_d [q(n); U_acted(n)].
    force_limit
        (commands,) [N].
    model, weights, margins
        Texts of one line: the model and the weights that it was designed with, and its predicted margins.
    rig_period
        Sample period [s] of the rig for which it was made; the law's is a whole multiple. 0: the law's.

    Raises
    ------
    AbraceError
        If the law is continuous, has no states, is not stable or of a sample period that is no whole multiple of the
        rig's, or a matrix or limit does not fit it.
    """

    name: str
    law: LinearModel
    correction: NDArray[np.float64]
    prediction: NDArray[np.float64]
    force_limit: NDArray[np.float64]
    model: str
    weights: str
    margins: str
    rig_period: float = 0.0

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
        object.__setattr__(self, "rig_period", self.rig_period or law.sample_period)
        self.of_rig(self.rig_period)
        states, measured, commands = law.order, len(law.inputs), len(law.outputs)
        for key, shape in (("correction", (states, commands)), ("prediction", (measured, states + commands))):
            matrix = read_only(getattr(self, key), shape, f"controller {self.name}: {key}")
            object.__setattr__(self, key, matrix)
        limit = read_only(self.force_limit, (len(law.outputs),), f"controller {self.name}: force_limit")
        if not limit.min() > 0:
            raise AbraceError(
                f"controller {self.name}: force_limit {limit.tolist()}, "
                f"expected a force above zero for each of {', '.join(law.outputs)}"
            )
        object.__setattr__(self, "force_limit", limit)

    def of_rig(self, period: float) -> int:
        """How many samples of a rig, one each `period` [s], make one of the law; of these it answers the first.

        Raises
        ------
        AbraceError
            If it is not a whole number, or the controller was made for a rig of another sample period.
        """
        try:
            found = divisor(self.law.sample_period, period)
        except AbraceError as error:
            raise AbraceError(f"controller {self.name}: {error}") from error
        made_for = divisor(self.law.sample_period, self.rig_period)
        if made_for not in (1, found):
            raise AbraceError(
                f"controller {self.name}: made for a rig that samples every {self.rig_period:g} s, not {period:g} s"
            )
        return found

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles of its law, as `LinearModel.poles`."""
        return self.law.poles

    def __repr__(self) -> str:
        law = self.law
        signals = f"{', '.join(law.inputs)} to {', '.join(law.outputs)}"
        return f"<Controller {self.name}: {signals}, {law.order} states, every {law.sample_period:g} s>"


def save_controller(controller: Controller, path: Path | str, proof: Sequence[str] = ()) -> None:
    """Write the controller's parameter file, or where `path` ends in `.mat` one for MATLAB, atomically.

    The same controller gives the same bytes of a parameter file.

    Parameters
    ----------
    controller
        The controller.
    path
        Path of the file.
    proof
        Lines of the controller's proof: comments at the top of the file.

    Raises
    ------
    AbraceError
        If the file cannot be written.
    """
    law = controller.law
    texts = {key: " ".join(getattr(controller, key).split()) for key in ("name", "model", "weights", "margins")}
    if str(path).endswith(".mat"):
        matrices = {"G": controller.correction, "P": controller.prediction, "force_limit": controller.force_limit}
        matrices["rig_period"] = np.array(controller.rig_period)
        save_mat(law, path, matrices | texts)
        return
    lines = [
        f"# Controller {texts['name']}: Eq. (13), U(n) = C_d q(n) + D_d y(n), q(n+1) = A_d q(n) + B_d y(n)",
        "# + G_d (U_acted(n) - U(n)), U_acted being what limits left of U; y(n) = P_d [q(n); U_acted(n)] is expected.",
        "# A ROS 2 parameter file, written by abrace; SI units; matrices row by row.",
        f"# Made from: {texts['model']}",
        f"# Weights: {texts['weights']}",
        f"# Predicted: {texts['margins']}",
        *(f"# {line}" for line in proof),
        "/**:",
        "  ros__parameters:",
        *(f"    {key}: {_quoted(value)}" for key, value in texts.items()),
        f"    sample_period: {yaml_number(law.sample_period)}",
        f"    measured: [{', '.join(map(_quoted, law.inputs))}]",
        f"    commands: [{', '.join(map(_quoted, law.outputs))}]",
        f"    states: {law.order}",
        f"    force_limit: [{_row(controller.force_limit)}]",
    ]
    if controller.rig_period != law.sample_period:
        lines.append(f"    rig_period: {yaml_number(controller.rig_period)}")
    if law.units:
        units = (f"{name}={unit}" for name, unit in law.units.items())
        lines.append(f"    units: [{', '.join(map(_quoted, units))}]")
    eq_13 = (("a_d", law.a), ("b_d", law.b), ("c_d", law.c), ("d_d", law.d))
    for key, matrix in (*eq_13, ("g_d", controller.correction), ("p_d", controller.prediction)):
        rows = ",\n      ".join(_row(row) for row in matrix)
        lines.append(f"    {key}: [\n      {rows}]")
    write_text(path, "\n".join(lines) + "\n")


def load_controller(path: Path | str) -> Controller:
    """Read a controller's parameter file, or MATLAB's `.mat` that `save_controller` wrote.

    Raises
    ------
    AbraceError
        Naming the file, the key and what was expected.
    """
    if str(path).endswith(".mat"):
        law, found = load_mat(path)
        missing = [name for name in ("G", "P", "force_limit") if name not in found]
        if missing:
            raise AbraceError(f"controller file {path}: no variable {missing[0]}, expected one of save_mat")
        texts = ["".join(np.ravel(found.get(key, ""))) for key in ("name", "model", "weights", "margins")]
        try:
            limit, period = np.ravel(found["force_limit"]), float(np.ravel(found.get("rig_period", 0.0))[0])
            name, model, weights, margins = texts
            return Controller(name, law, found["G"], found["P"], limit, model, weights, margins, period)
        except (TypeError, ValueError, AbraceError) as error:
            raise AbraceError(f"controller file {path}: {error}") from error
    content = read_config(path, _File, "controller")
    return _controller(content.nodes.ros__parameters, f"controller file {path}")


def controller_from_parameters(parameters: Mapping[str, Any], source: str) -> Controller:
    """A controller from the parameters of a node.

    Parameters
    ----------
    parameters
        A value for each field of `ControllerParameters`; lists may be arrays.
    source
        Named in error messages.

    Raises
    ------
    AbraceError
        Naming the source, the parameter and what was expected.
    """
    values = {
        key: list(value) if hasattr(value, "__iter__") and not isinstance(value, str) else value
        for key, value in parameters.items()
    }
    return _controller(validated(values, ControllerParameters, source), source)


def _controller(parameters: ControllerParameters, source: str) -> Controller:
    """The controller of checked parameters, once the matrices have the lengths that states and names call for."""
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
            units=dict(_name_and_unit(text) for text in parameters.units),
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
            parameters.rig_period,
        )
    except AbraceError as error:
        raise AbraceError(f"{source}: {error}") from error


def _name_and_unit(text: str) -> tuple[str, str]:
    name, _, unit = text.rpartition("=")
    if not (name and unit):
        raise AbraceError(f"units: {text!r}, expected NAME=UNIT")
    return name, unit


def _row(values: NDArray[np.float64]) -> str:
    """Numbers separated by commas; subnormal ones, which ROS's parser takes for text, are written as zero."""
    return ", ".join(yaml_number(0.0 if abs(value) < np.finfo(np.float64).tiny else value) for value in values)


def _quoted(text: str) -> str:
    """A YAML string in quotes, so that ROS never takes it for a number."""
    return yaml.safe_dump(text, default_style='"', width=10**9, allow_unicode=True).strip()

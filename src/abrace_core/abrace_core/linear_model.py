# SPDX-License-Identifier: Apache-2.0
"""State-space models with named signals: dx/dt = A x + B u(t - delay), y = C x + D u(t - delay).

The model type of all packages (Eqs. 3 to 9 of the paper). A model is immutable; it is kept in a JSON file with its
provenance, and converts to python-control's StateSpace and to MATLAB.
"""

from __future__ import annotations

import functools
import json
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from abrace_core import signals
from abrace_core.errors import AbraceError, not_json
from abrace_core.files import write_text
from abrace_core.tables import data_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import control
    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

FILE_FORMAT = "abrace model 1"


@dataclass(frozen=True)
class LinearModel:
    """A linear time-invariant model with named inputs and outputs.

    Parameters
    ----------
    a, b, c, d
        Matrices of shapes (states, states), (states, inputs), (outputs, states), (outputs, inputs). SI units.
    inputs, outputs
        Names of the signals, each once.
    sample_period
        Seconds; 0 for a continuous model.
    input_delay
        Seconds for each input; only in continuous models (a discrete one carries its delays in states).
    provenance
        Bags, method, options and version from which the model was made. Any JSON values.

    Raises
    ------
    AbraceError
        If shapes and names do not fit, or a number is not finite.
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    c: NDArray[np.float64]
    d: NDArray[np.float64]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sample_period: float = 0.0
    input_delay: tuple[float, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n, m, p = len(self.a), len(self.inputs), len(self.outputs)
        for name, shape in (("a", (n, n)), ("b", (n, m)), ("c", (p, n)), ("d", (p, m))):
            matrix = np.asarray(getattr(self, name), dtype=np.float64)
            if matrix.size == 0 and 0 in shape:
                matrix = np.zeros(shape)
            if matrix.shape != shape:
                raise AbraceError(f"model matrix {name}: shape {matrix.shape}, expected {shape}")
            if not np.isfinite(matrix).all():
                raise AbraceError(f"model matrix {name}: has a value that is not finite")
            object.__setattr__(self, name, matrix)
        object.__setattr__(self, "inputs", tuple(self.inputs))
        object.__setattr__(self, "outputs", tuple(self.outputs))
        for names in (self.inputs, self.outputs):
            if len(set(names)) != len(names):
                raise AbraceError(f"model signals {names}: expected each name once")
        delay = tuple(float(value) for value in self.input_delay) or (0.0,) * m
        if len(delay) != m or min(delay, default=0.0) < 0 or not np.isfinite(delay).all():
            raise AbraceError(f"model input_delay {delay}: expected one delay >= 0 for each of {m} inputs")
        if self.sample_period and any(delay):
            raise AbraceError("model input_delay: a discrete model carries its delays in states, expected zeros")
        object.__setattr__(self, "input_delay", delay)

    def __repr__(self) -> str:
        kind = f"every {self.sample_period:g} s" if self.sample_period else "continuous"
        return f"<LinearModel: {self.order} states, {', '.join(self.inputs)} to {', '.join(self.outputs)}, {kind}>"

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.a)

    def poles(self) -> NDArray[np.complex128]:
        """Continuous poles [rad/s], slowest first; those of a discrete model are log(z)/T, one at z = 0 is -inf."""
        poles = np.asarray(np.linalg.eigvals(self.a), dtype=np.complex128)
        if self.sample_period:
            z, moving = poles, poles != 0
            poles = np.full_like(z, -np.inf)
            poles[moving] = np.log(z[moving]) / self.sample_period
        return poles[np.argsort(np.abs(poles), kind="stable")]

    def is_stable(self) -> bool:
        """Whether every pole lies strictly inside the stability region."""
        return bool(np.all(self.poles().real < 0))

    def frequency_response(self, omega: ArrayLike) -> NDArray[np.complex128]:
        """Response at the angular frequencies `omega` [rad/s], shape (frequencies, outputs, inputs)."""
        omega = np.atleast_1d(np.asarray(omega, dtype=np.float64))
        s = np.exp(1j * omega * self.sample_period) if self.sample_period else 1j * omega
        delays = np.exp(-1j * omega[:, None, None] * np.array(self.input_delay))
        if not self.order:
            return self.d * delays
        values, vectors = np.linalg.eig(self.a)
        if np.linalg.cond(vectors) < 1e10:
            left = np.linalg.solve(vectors, self.b.astype(np.complex128))
            response = np.einsum("pn,fn,nm->fpm", self.c @ vectors, 1 / (s[:, None] - values), left, optimize=True)
        else:
            pencil = s[:, None, None] * np.eye(self.order) - self.a
            response = self.c @ np.linalg.solve(pencil, np.broadcast_to(self.b, (len(s), *self.b.shape)))
        return (response + self.d) * delays

    def select(self, outputs: Sequence[str] | None = None, inputs: Sequence[str] | None = None) -> LinearModel:
        """The same model with only these `outputs` and `inputs`, in this order; names in either form.

        Raises
        ------
        AbraceError
            With all names that the model has not (`signals.positions`).
        """
        rows = signals.positions(outputs or self.outputs, self.outputs, "model has no output")
        columns = signals.positions(inputs or self.inputs, self.inputs, "model has no input")
        return replace(
            self,
            b=self.b[:, columns],
            c=self.c[rows],
            d=self.d[np.ix_(rows, columns)],
            inputs=tuple(self.inputs[j] for j in columns),
            outputs=tuple(self.outputs[i] for i in rows),
            input_delay=tuple(self.input_delay[j] for j in columns),
        )

    def to_pandas(self) -> pandas.DataFrame:
        """The pole pairs, slowest first: frequency [Hz] and [rad/s], damping ratio; an unstable one has it below 0.

        Raises
        ------
        AbraceError
            If pandas is not installed.
        """
        pairs = np.array(pole_table(self.poles())).reshape(-1, 2)
        columns = {
            "frequency [Hz]": pairs[:, 0] / (2 * np.pi),
            "frequency [rad/s]": pairs[:, 0],
            "damping ratio": pairs[:, 1],
        }
        return data_frame(columns, "pole pair", range(1, len(pairs) + 1))

    def plot(
        self, outputs: Sequence[str] | None = None, inputs: Sequence[str] | None = None, band: Sequence[float] = ()
    ) -> Figure:
        """Gains over frequency.

        Parameters
        ----------
        outputs, inputs
            Names, in either form; None: all.
        band
            Lowest and highest frequency [Hz]; none: around the model's pole pairs.

        Raises
        ------
        AbraceError
            As in `select`, or if the band is none.
        """
        from abrace_core.signal_figure import gains

        shown = self.select(outputs, inputs)
        pairs = [frequency / (2 * np.pi) for frequency, _ in pole_table(self.poles())]
        low, high = band or (min(pairs, default=1.0) / 3, 3 * max(pairs, default=10.0))
        if not 0 < low < high < np.inf:
            raise AbraceError(f"band {low:g} to {high:g} Hz, expected two frequencies above 0 that rise")
        if self.sample_period:
            high = min(high, 0.5 / self.sample_period)
        frequency = np.geomspace(low, high, 2000)
        return gains(frequency, shown.frequency_response(2 * np.pi * frequency), shown.outputs, shown.inputs)

    def to_control(self) -> control.StateSpace:
        """The model as python-control's StateSpace, its signals by their names.

        Raises
        ------
        AbraceError
            If python-control is not installed, or the model has delays, which a StateSpace has not.
        """
        try:
            import control
        except ImportError as error:
            raise AbraceError("python-control is not installed, expected the package control (pip)") from error

        if any(self.input_delay):
            raise AbraceError(
                "model has input delays, which python-control's StateSpace cannot hold: "
                "sample it first (abrace.discretize), its delays become states"
            )
        dt = self.sample_period or 0
        return control.ss(self.a, self.b, self.c, self.d, dt, inputs=list(self.inputs), outputs=list(self.outputs))

    @classmethod
    def from_control(cls, system: control.StateSpace) -> LinearModel:
        """The model that a `system` of python-control, a StateSpace, holds in SI units, its signals by their labels.

        Raises
        ------
        AbraceError
            If its sample time is not specified, or a matrix has a value that is not finite.
        """
        if system.dt is None or system.dt is True:
            raise AbraceError(
                f"python-control's system {system.name}: dt {system.dt}, expected 0 (continuous) or a sample period [s]"
            )
        a, b, c, d = (np.array(matrix, dtype=np.float64) for matrix in (system.A, system.B, system.C, system.D))
        inputs, outputs = tuple(system.input_labels), tuple(system.output_labels)
        provenance = {"method": "python-control", "system": system.name}
        return cls(a, b, c, d, inputs, outputs, float(system.dt), provenance=provenance)


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def takes_models(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Let a `function` of models be given python-control's StateSpaces too, alone, in a list or tuple, or in a mapping.

    The one place where they are converted. Where python-control was not imported, nothing can be one of its systems.
    """

    @functools.wraps(function)
    def with_models(*args: Any, **kwargs: Any) -> Result:
        system = getattr(sys.modules.get("control"), "StateSpace", None)
        if system is not None:
            args = tuple(_converted(value, system) for value in args)
            kwargs = {name: _converted(value, system) for name, value in kwargs.items()}
        return function(*args, **kwargs)

    return with_models


def _converted(value: Any, system: type) -> Any:
    if isinstance(value, system):
        return LinearModel.from_control(value)
    if type(value) in (list, tuple):
        return type(value)(_converted(each, system) for each in value)
    return {name: _converted(each, system) for name, each in value.items()} if type(value) is dict else value


def pole_table(poles: NDArray[np.complex128]) -> list[tuple[float, float]]:
    """(frequency [rad/s], damping ratio) of each complex pair, slowest first; real poles are left out.

    >>> [(round(w, 3), round(z, 4)) for w, z in pole_table(np.array([-0.11 + 7.275j, -0.11 - 7.275j]))]
    [(7.276, 0.0151)]
    """
    upper = poles[poles.imag > 1e-9 * np.abs(poles)]
    upper = upper[np.argsort(np.abs(upper))]
    return [(float(abs(p)), float(-p.real / abs(p))) for p in upper]


@takes_models
def save_model(model: LinearModel, path: Path | str, covariance: NDArray[np.float64] | None = None) -> None:
    """Write the model to a JSON file, atomically.

    Parameters
    ----------
    model, path
        What is written, and where.
    covariance
        Of its parameters (`model_ensemble`), symmetric; None: not known.
    """
    content = {
        "format": FILE_FORMAT,
        "sample_period": model.sample_period,
        "inputs": model.inputs,
        "outputs": model.outputs,
        "input_delay": model.input_delay,
    }
    tables = {"a": model.a.tolist(), "b": model.b.tolist(), "c": model.c.tolist(), "d": model.d.tolist()}
    if covariance is not None:
        # its lower triangle: the other half is the same
        tables["covariance"] = [row[: i + 1] for i, row in enumerate(covariance.tolist())]
    parts = [f' "{key}": {json.dumps(value)}' for key, value in content.items()]
    # a row of a matrix is a line
    parts += [
        f' "{key}": [' + ",".join(f"\n  {json.dumps(row)}" for row in rows) + "\n ]" for key, rows in tables.items()
    ]
    parts.append(f' "provenance": {json.dumps(model.provenance)}')
    write_text(path, "{\n" + ",\n".join(parts) + "\n}\n")


def load_model(path: Path | str) -> LinearModel:
    """Read a model file.

    Raises
    ------
    AbraceError
        If the file is missing, is no JSON, or is not a model file.
    """
    content = _content_of(path)
    try:
        return LinearModel(
            **{key: np.asarray(content[key], dtype=np.float64) for key in "abcd"},
            inputs=tuple(content["inputs"]),
            outputs=tuple(content["outputs"]),
            sample_period=float(content["sample_period"]),
            input_delay=tuple(content["input_delay"]),
            provenance=content["provenance"],
        )
    except KeyError as error:
        raise AbraceError(f"model file {path}: key {error} is missing") from error
    except (TypeError, ValueError, AbraceError) as error:
        raise AbraceError(f"model file {path}: {error}") from error


def load_covariance(path: Path | str) -> NDArray[np.float64] | None:
    """The covariance of the parameters of the model in a file; None: the file has none.

    Raises
    ------
    AbraceError
        As `load_model`, or if it is no triangle of numbers.
    """
    rows = _content_of(path).get("covariance")
    if rows is None:
        return None
    try:
        found = np.zeros((len(rows), len(rows)))
        for i, row in enumerate(rows):
            found[i, : i + 1] = found[: i + 1, i] = np.asarray(row, dtype=np.float64).reshape(i + 1)
    except (TypeError, ValueError) as error:
        raise AbraceError(f"model file {path}: covariance: expected the rows of a lower triangle ({error})") from error
    return found


def _content_of(path: Path | str) -> dict[str, Any]:
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        what = "a folder, expected a file" if isinstance(error, IsADirectoryError) else error.strerror
        raise AbraceError(f"model file {path}: {what}") from error
    except ValueError as error:
        raise AbraceError(f"model file {path}: {not_json(error)}") from error
    if not isinstance(content, dict) or content.get("format") != FILE_FORMAT:
        raise AbraceError(f"model file {path}: expected a JSON object with format {FILE_FORMAT!r}")
    return content


@takes_models
def export_mat(model: LinearModel, path: Path | str) -> None:
    """Write the model's matrices, names and delays to a MATLAB `.mat` file, atomically."""
    from scipy.io import savemat

    from abrace_core.files import write_atomically

    with write_atomically(path) as temporary:
        savemat(
            str(temporary),
            {
                "A": model.a,
                "B": model.b,
                "C": model.c,
                "D": model.d,
                "Ts": model.sample_period,
                "inputs": np.array(model.inputs, dtype=object),
                "outputs": np.array(model.outputs, dtype=object),
                "input_delay": np.array(model.input_delay),
            },
        )

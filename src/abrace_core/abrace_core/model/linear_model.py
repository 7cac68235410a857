# SPDX-License-Identifier: Apache-2.0
"""State-space models with named signals: dx/dt = A x + B u(t - delay), y = C x + D u(t - delay).

The model type of all packages (Eqs. 3 to 9 of the paper). A model is a value: its arrays are copies that cannot be
written to, and two models are equal where their numbers and names are. It is kept in a JSON file with its provenance,
and converts to python-control's StateSpace and to MATLAB.
"""

from __future__ import annotations

import functools
import json
import sys
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec, TypeVar

import numpy as np
import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, validated
from abrace_core.files.matlab_loader import load_matlab
from abrace_core.files.reading import read_json
from abrace_core.files.table import name_and_unit
from abrace_core.files.writing import write_atomically, write_text
from abrace_core.model import signals
from abrace_core.model.plotted import figure_of
from abrace_core.model.values import Value, read_only

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import control
    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from abrace_core.model.run import Run

FILE_FORMAT = "abrace model 1"

LARGEST_CONDITION = 1e10
"""Condition number of the eigenvectors up to which a model is evaluated by its poles and residues."""


Rows = list[list[float]]


class _File(Checked, extra="ignore"):
    """A model file; `covariance` is the lower triangle of its parameters' (`model_ensemble`)."""

    format: str
    sample_period: Annotated[float, pydantic.Field(ge=0)]
    inputs: list[str]
    outputs: list[str]
    input_delay: list[float]
    units: dict[str, str] = {}
    a: Rows
    b: Rows
    c: Rows
    d: Rows
    covariance: Rows | None = None
    provenance: dict[str, Any]


@dataclass(frozen=True, eq=False)
class LinearModel(Value):
    """A linear time-invariant model with named inputs and outputs.

    Parameters
    ----------
    a, b, c, d
        Matrices of shapes (states, states), (states, inputs), (outputs, states), (outputs, inputs). SI units but for
        the signals in `units`.
    inputs, outputs
        Names of the signals, each once.
    sample_period
        Seconds; 0 for a continuous model.
    input_delay
        Seconds for each input; only in continuous models (a discrete one carries its delays in states).
    provenance
        Bags, method, options and version from which the model was made. Any JSON values; two models that differ in
        nothing else are equal.
    units
        Units of signals by name, as they were stated; others are in SI units (`signals.unit`). `si_units.in_si_units`
        converts.

    Raises
    ------
    AbraceError
        If shapes and names do not fit, a number is not finite, the sample period is below 0, or a unit is of no signal.
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    c: NDArray[np.float64]
    d: NDArray[np.float64]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sample_period: float = 0.0
    input_delay: tuple[float, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict, compare=False)
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key in ("inputs", "outputs"):
            names = getattr(self, key)
            if isinstance(names, str) or not all(isinstance(name, str) and name for name in names):
                raise AbraceError(f"model {key} {names!r:.60}: expected a list of names")
            object.__setattr__(self, key, tuple(names))
            if len(set(names)) != len(names):
                raise AbraceError(f"model {key} {tuple(names)}: expected each name once")
        n, m, p = len(self.a), len(self.inputs), len(self.outputs)
        for key, shape in (("a", (n, n)), ("b", (n, m)), ("c", (p, n)), ("d", (p, m))):
            object.__setattr__(self, key, read_only(getattr(self, key), shape, f"model matrix {key}"))
        period = float(self.sample_period)
        if not 0 <= period < np.inf:
            raise AbraceError(f"model sample_period {period:g} s: expected more than 0, or 0 for a continuous model")
        object.__setattr__(self, "sample_period", period)
        delay = tuple(float(value) for value in self.input_delay) or (0.0,) * m
        if len(delay) != m or min(delay, default=0.0) < 0 or not np.isfinite(delay).all():
            raise AbraceError(f"model input_delay {delay}: expected one delay >= 0 for each of {m} inputs")
        if period and any(delay):
            raise AbraceError("model input_delay: a discrete model carries its delays in states, expected zeros")
        object.__setattr__(self, "input_delay", delay)
        if unknown := [name for name in self.units if name not in (*self.inputs, *self.outputs)]:
            known = ", ".join((*self.inputs, *self.outputs))
            raise AbraceError(f"model units of {', '.join(map(str, unknown))}: expected of some of {known}")
        object.__setattr__(self, "units", {str(name): str(unit) for name, unit in self.units.items()})

    def __repr__(self) -> str:
        kind = f"every {self.sample_period:g} s" if self.sample_period else "continuous"
        return f"<LinearModel: {self.order} states, {', '.join(self.inputs)} to {', '.join(self.outputs)}, {kind}>"

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.a)

    A, B, C, D = (property(attrgetter(name), doc=f"As `{name}`.") for name in "abcd")

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Continuous poles [rad/s], slowest first; those of a discrete model are log(z)/T, one at z = 0 is -inf."""
        poles = np.asarray(np.linalg.eigvals(self.a), dtype=np.complex128)
        if self.sample_period:
            z, moving = poles, poles != 0
            poles = np.full_like(z, -np.inf)
            poles[moving] = np.log(z[moving]) / self.sample_period
        return poles[np.argsort(np.abs(poles), kind="stable")]

    def unit(self, name: str) -> str:
        """Unit of the input or output `name`: the stated one, or of a rig's signal SI units; "-": it is not known."""
        return self.units.get(name) or signals.unit(name)

    def is_stable(self) -> bool:
        """Whether every pole lies strictly inside the stability region."""
        return bool(np.all(self.poles.real < 0))

    def frequency_response(self, omega: ArrayLike) -> NDArray[np.complex128]:
        """Response at the angular frequencies `omega` [rad/s], shape (frequencies, outputs, inputs)."""
        omega = np.atleast_1d(np.asarray(omega, dtype=np.float64))
        s = np.exp(1j * omega * self.sample_period) if self.sample_period else 1j * omega
        delays = np.exp(-1j * omega[:, None, None] * np.array(self.input_delay))
        shape = (len(omega), *self.d.shape)
        if self._residues is not None:
            response = (1 / (s[:, None] - self._residues[0]) @ self._residues[1]).reshape(shape)
        else:
            pencil = s[:, None, None] * np.eye(self.order) - self.a
            response = self.c @ np.linalg.solve(pencil, np.broadcast_to(self.b, (len(s), *self.b.shape)))
        return (response + self.d) * delays

    @functools.cached_property
    def _residues(self) -> tuple[NDArray[np.complex128], NDArray[np.complex128]] | None:
        """Poles (states,) and residues (states, outputs times inputs); None: poles that coincide have no such."""
        poles, vectors = np.linalg.eig(self.a)
        if self.order and not np.linalg.cond(vectors) < LARGEST_CONDITION:
            return None
        left = np.linalg.solve(vectors, self.b.astype(np.complex128))
        residues = (self.c @ vectors).T[:, :, None] * left[:, None, :]
        return poles.astype(np.complex128), residues.reshape(self.order, self.d.size)

    def select(self, outputs: Sequence[str] | None = None, inputs: Sequence[str] | None = None) -> LinearModel:
        """The same model with only these `outputs` and `inputs`, in this order; names in either form; None: all.

        Raises
        ------
        AbraceError
            With all names that the model has not (`signals.positions`).
        """
        rows = signals.positions(self.outputs if outputs is None else outputs, self.outputs, "model has no output")
        columns = signals.positions(self.inputs if inputs is None else inputs, self.inputs, "model has no input")
        chosen = tuple(self.inputs[j] for j in columns), tuple(self.outputs[i] for i in rows)
        return replace(
            self,
            b=self.b[:, columns],
            c=self.c[rows],
            d=self.d[np.ix_(rows, columns)],
            inputs=chosen[0],
            outputs=chosen[1],
            input_delay=tuple(self.input_delay[j] for j in columns),
            units={name: unit for name, unit in self.units.items() if name in (*chosen[0], *chosen[1])},
        )

    def to_pandas(self) -> pandas.DataFrame:
        """The pole pairs, slowest first: frequency [Hz] and [rad/s], damping ratio; an unstable one has it below 0."""
        import pandas

        pairs = np.array(pole_table(self.poles)).reshape(-1, 2)
        columns = {
            "frequency [Hz]": pairs[:, 0] / (2 * np.pi),
            "frequency [rad/s]": pairs[:, 0],
            "damping ratio": pairs[:, 1],
        }
        return pandas.DataFrame(columns, index=pandas.Index(range(1, len(pairs) + 1), name="pole pair"))

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
        return figure_of(self, "plot", outputs, inputs, band)

    def bode(
        self, outputs: Sequence[str] | None = None, inputs: Sequence[str] | None = None, band: Sequence[float] = ()
    ) -> Figure:
        """Gains and phases over frequency; `outputs`, `inputs`, `band` and errors as of `plot`."""
        return figure_of(self, "bode", outputs, inputs, band)

    def step(
        self, outputs: Sequence[str] | None = None, inputs: Sequence[str] | None = None, duration: float = 0.0
    ) -> Figure:
        """Responses to a step of 1 of each input, in its unit.

        Parameters
        ----------
        outputs, inputs
            Names, in either form; None: all.
        duration
            [s]; 0: python-control's, by the poles.

        Raises
        ------
        AbraceError
            As in `select`.
        """
        return figure_of(self, "step", outputs, inputs, duration)

    def compare(self, test: Run | Path | str, channels: Sequence[str] = ()) -> Figure:
        """A recorded test and the model's simulation of it; `abrace.validate` has the numbers.

        Parameters
        ----------
        test
            A Run, or the folder of its bag.
        channels
            One row each; none: the top floor's displacement and the first acceleration.

        Raises
        ------
        AbraceError
            As in `abrace.validate`.
        """
        return figure_of(self, "compare", test, channels)

    def delays_as_states(self) -> LinearModel:
        """The same model with Pade's approximation (2, 2) of its inputs' delays as states, two for each.

        (1 - s t/2 + (s t)^2/12) / (1 + s t/2 + (s t)^2/12) is all-pass; for t = 3.8 ms the error of its phase is 0.02
        degrees at 30 Hz. The states are of one size, which those of python-control's `pade` are not.
        """
        a, b, c, d = self.a, self.b.copy(), self.c, self.d
        n, root = self.order, np.sqrt(12.0)
        share = np.array([[-root, 0.0]])
        for j, delay in enumerate(self.input_delay):
            if delay:
                a = np.block(
                    [
                        [a, np.pad(self.b[:, [j]] @ share, ((0, len(a) - n), (0, 0)))],
                        [np.zeros((2, len(a))), np.array([[-6.0, -root], [root, 0.0]]) / delay],
                    ]
                )
                drive = np.zeros((2, len(self.inputs)))
                drive[0, j] = root / delay
                b = np.vstack([b, drive])
                c = np.hstack([c, self.d[:, [j]] @ share])
        return replace(self, a=a, b=b, c=c, d=d, input_delay=())

    def to_control(self) -> control.StateSpace:
        """The model as python-control's StateSpace, with `delays_as_states`.

        Its signals have their names, with the unit where one is stated: `a1 [g]`.
        """
        import control

        held, dt = self.delays_as_states(), self.sample_period or 0
        inputs, outputs = ([self._label(name) for name in names] for names in (self.inputs, self.outputs))
        return control.ss(held.a, held.b, held.c, held.d, dt, inputs=inputs, outputs=outputs)

    def _label(self, name: str) -> str:
        """The name with its unit, if one is stated outside it."""
        unit = "" if name_and_unit_of(name)[1] else self.units.get(name, "")
        return f"{name} [{unit}]" if unit else name

    @classmethod
    def from_control(cls, system: control.StateSpace) -> LinearModel:
        """The model that a `system` of python-control, a StateSpace, holds, its signals by their labels.

        They are in SI units but for those whose label has another: `a1 [g]`.

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
        inputs, outputs = map(_named, (system.input_labels, system.output_labels))
        units = {name: unit for name, unit in (inputs | outputs).items() if unit}
        period, provenance = float(system.dt), {"method": "python-control", "system": system.name}
        return cls(a, b, c, d, tuple(inputs), tuple(outputs), period, provenance=provenance, units=units)


def _named(labels: Sequence[str]) -> dict[str, str]:
    """Units by name, from the `labels` of signals; as a label is where two would have one name."""
    found = dict(map(name_and_unit_of, labels))
    return found if len(found) == len(labels) else dict.fromkeys(labels, "")


def name_and_unit_of(label: str) -> tuple[str, str]:
    """Name and unit of a signal from its `label`, as `a1 [g]`; a number in brackets is part of the name.

    >>> name_and_unit_of("a1 [g]"), name_and_unit_of("a1"), name_and_unit_of("u (1)")
    (('a1', 'g'), ('a1', ''), ('u (1)', ''))
    """
    name, unit = name_and_unit(label)
    return (name, unit) if name and unit and not unit.isdecimal() else (label, "")


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


@takes_models
def balanced(model: LinearModel) -> LinearModel:
    """The same model with its states scaled (by powers of two) so that A's rows and columns have similar norms.

    The states of a rig are in metres, newtons and their rates, whose sizes differ by many powers of ten.
    """
    from scipy import linalg

    _, (scale, _) = linalg.matrix_balance(model.a, permute=False, separate=True)
    return replace(model, a=model.a * scale / scale[:, None], b=model.b / scale[:, None], c=model.c * scale)


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
        **({"units": model.units} if model.units else {}),
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
    """Read a model file, JSON or MATLAB's `.mat`.

    Raises
    ------
    AbraceError
        If the file is missing, or is not a model file.
    """
    if str(path).endswith(".mat"):
        return load_mat(path)[0]
    found = _read(path)
    try:
        return LinearModel(
            found.a,  # type: ignore[arg-type]
            found.b,  # type: ignore[arg-type]
            found.c,  # type: ignore[arg-type]
            found.d,  # type: ignore[arg-type]
            **{key: getattr(found, key) for key in ("inputs", "outputs", "sample_period", "input_delay")},
            provenance=found.provenance,
            units=found.units,
        )
    except AbraceError as error:
        raise AbraceError(f"model file {path}: {error}") from error


def load_covariance(path: Path | str) -> NDArray[np.float64] | None:
    """The covariance of the parameters of the model in a file; None: the file has none.

    Raises
    ------
    AbraceError
        As `load_model`, or if it is no triangle of numbers.
    """
    rows = _read(path).covariance
    if rows is None:
        return None
    found = np.zeros((len(rows), len(rows)))
    for i, row in enumerate(rows):
        if len(row) != i + 1:
            raise AbraceError(f"model file {path}: covariance: row {i + 1} has {len(row)} numbers, expected {i + 1}")
        found[i, : i + 1] = found[: i + 1, i] = row
    return found


def _read(path: Path | str) -> _File:
    content = read_json(path, "model")
    if not isinstance(content, dict) or content.get("format") != FILE_FORMAT:
        raise AbraceError(f"model file {path}: expected a JSON object with format {FILE_FORMAT!r}")
    return validated(content, _File, f"model file {path}")


@takes_models
def save_mat(model: LinearModel, path: Path | str, more: Mapping[str, Any] | None = None) -> None:
    """Write a model's matrices, names and delays to a MATLAB `.mat` file, atomically, as `load_model` reads it.

    Parameters
    ----------
    model, path
        What is written, and where.
    more
        Further variables: arrays or texts.
    """
    from scipy.io import savemat

    content = {
        "A": model.a,
        "B": model.b,
        "C": model.c,
        "D": model.d,
        "Ts": model.sample_period,
        "inputs": np.array(model.inputs, dtype=object),
        "outputs": np.array(model.outputs, dtype=object),
        "input_delay": np.array(model.input_delay),
    }
    if model.units:
        for key, names in (("input_units", model.inputs), ("output_units", model.outputs)):
            content[key] = np.array([model.units.get(name, "") for name in names], dtype=object)
    with write_atomically(path) as temporary:
        savemat(str(temporary), {**content, **(more or {})})


def _dense(matrix: Any) -> NDArray[np.float64]:
    return np.asarray(matrix.toarray() if hasattr(matrix, "toarray") else matrix, dtype=np.float64)


def load_mat(path: Path | str) -> tuple[LinearModel, dict[str, Any]]:
    """The model in a `.mat` file, and all variables there.

    Missing names are u1, y1, ... (u, y alone), delays and D zero, and a model without Ts is continuous, as in MATLAB.

    Raises
    ------
    AbraceError
        If it cannot be read, or A, B, C, D and Ts (0: continuous) make no model.
    """
    try:
        found = load_matlab(Path(path), f"model file {path}", as_stored=True)
    except OSError as error:
        raise AbraceError(f"model file {path}: {error.strerror or error}") from error
    try:
        a, b, c = (_dense(found[name]) for name in "ABC")
        d = _dense(found.get("D", np.zeros((len(c), b.shape[-1]))))
        inputs, outputs = (
            tuple(str(np.squeeze(each)) for each in np.ravel(found[key]))
            if key in found
            else signals.numbered(letter, count)
            for key, letter, count in (("inputs", "u", b.shape[1]), ("outputs", "y", len(c)))
        )
        delay = np.ravel(found.get("input_delay", ()))
        period = float(np.squeeze(found.get("Ts", 0.0)))
        units = {
            name: str(np.squeeze(unit))
            for key, names in (("input_units", inputs), ("output_units", outputs))
            for name, unit in zip(names, np.ravel(found.get(key, [""] * len(names))), strict=True)
            if np.size(unit) and str(np.squeeze(unit))
        }
        return LinearModel(a, b, c, d, inputs, outputs, period, tuple(delay), units=units), found
    except KeyError as error:
        raise AbraceError(f"model file {path}: no variable {error}, expected A, B, C (and D, Ts)") from error
    except (TypeError, ValueError, AbraceError) as error:
        raise AbraceError(f"model file {path}: {error}") from error

# SPDX-License-Identifier: Apache-2.0
"""Nonlinear elements of a rig: forces and impulses that act on its identified linear model.

Each element responds to a motion r of the model with a force or an impulse:

- Friction of a storey: a force on the floors above and below, up to a limit, against the rate of the storey drift.
- Joints of a storey: a force on the same floors. Part of the storey's stiffness yields (Bouc 1967, Wen 1976, with
  exponent 1 and a yield drift far beyond the tests' drifts), so that softening and loss grow with the drift.
- Deadband of a valve: a force added to the command, against the flow v + (tau / c) f'. The brace's force falls short of
  the command by the greatest force error at which the valve remains shut.
- Backlash of the pins: an impulse added to the command when the brace's force changes sign. While the rod crosses the
  clearance b, the servo's velocity feedback c reduces the impulse of the force by c b.
- Seals of a brace: an impulse added to the command when the stroke reverses. The servo compensates the friction within
  its lag.

Forces on floors act through the building's modes. The mode shapes are those of the model's displacements. By
reciprocity they also determine how a force on a floor drives the modes, once the floors' masses are known
(`validity.mechanics`). The linear model already contains the mean effect of each element, as a slope of force over r at
the amplitude of the tests (Bussgang 1952). This slope is subtracted when the element is simulated.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg

from abrace_core import signals
from abrace_core.linear_model import LinearModel, takes_models

if TYPE_CHECKING:
    from numpy.typing import NDArray

KEY = "not linear"
"""Key of the `Nonlinearity` in a model's provenance."""

OF_STOREYS, IMPULSES = ("friction", "joints"), ("backlash", "seals")
"""Kinds of elements that act between floors (the others act on brace groups), and kinds that act by impulses."""

UNITS = {"friction": "N", "joints": "N/m", "deadband": "N", "backlash": "N s", "seals": "N s"}

SERVO_LINES = 200
"""Number of frequencies at which the servo is fitted, from half the first mode's to twice the last mode's."""


@dataclass(frozen=True)
class Element:
    """One nonlinear element.

    Parameters
    ----------
    kind
        "friction", "joints", "deadband", "backlash" or "seals".
    place
        Number of the storey (1 is the lowest) or of the brace group (from 1).
    limit, deviation
        Size of the element and its standard deviation: greatest force of friction and deadband [N], half the impulse
        of backlash and seals [N s], the stiffness of joints that yields [N/m].
    slope
        Slope of the force over r that the linear model already contains.
    yield_drift
        Yield drift of joints [m]; 0 for other kinds.
    """

    kind: str
    place: int
    limit: float = 0.0
    deviation: float = 0.0
    slope: float = 0.0
    yield_drift: float = 0.0

    @property
    def name(self) -> str:
        """The element's name as an input of a model."""
        return f"{self.kind} {self.place}"


@dataclass(frozen=True)
class Nonlinearity:
    """All nonlinear elements of a rig, and the masses and modes with which they act on its model.

    Parameters
    ----------
    elements
        The elements.
    masses
        Masses of the floors, lowest first [kg].
    modes
        Frequencies of the building's modes [rad/s].
    """

    elements: tuple[Element, ...]
    masses: tuple[float, ...]
    modes: tuple[float, ...]

    @property
    def kinds(self) -> str:
        """The kinds of elements, each once, as text."""
        return ", ".join(dict.fromkeys(one.kind for one in self.elements))

    @property
    def text(self) -> str:
        """The elements as text; those with a force in newtons with its size."""
        texts = []
        for one in self.elements:
            where = f"{'storey' if one.kind in OF_STOREYS else 'brace group'} {one.place}"
            amount = f" {one.limit:.3g} N" if UNITS[one.kind] == "N" else ""
            texts.append(f"{one.kind} in {where}{amount}")
        return ", ".join(texts)

    @classmethod
    def of_model(cls, model: LinearModel) -> Nonlinearity | None:
        """The nonlinearity in a model's provenance; None: the model has none."""
        content: dict[str, Any] | None = model.provenance.get(KEY)
        if content is None:
            return None
        elements = tuple(Element(**one) for one in content["elements"])
        return cls(elements, tuple(content["masses"]), tuple(content["modes"]))

    def noted_in(self, model: LinearModel) -> LinearModel:
        """The `model` with this nonlinearity in its provenance."""
        return replace(model, provenance={**model.provenance, KEY: asdict(self)})


@takes_models
def with_elements(model: LinearModel, found: Nonlinearity) -> LinearModel:
    """The model with an additional input (force or impulse) and an additional output (motion r) for each element.

    Parameters
    ----------
    model
        Continuous; its outputs include all displacements and accelerations of the floors, strokes and forces.
    found
        The elements; limits and slopes are not used.
    """
    building, groups = _Building.of(model, found), len(model.inputs) - 1
    columns, direct, motions = [], [], []
    flows = np.zeros((len(found.elements), model.order))
    for i, element in enumerate(found.elements):
        place = element.place - 1
        if element.kind in OF_STOREYS:
            columns.append(building.drive[:, place])
            direct.append(building.direct[:, place])
            motions.append(building.drift_rates[place] if element.kind == "friction" else building.drifts[place])
            continue
        command = model.inputs.index(signals.command_names(groups)[place])
        stroke, force = signals.numbered("xf", groups)[place], signals.numbered("f", groups)[place]
        columns.append(model.b[:, command])
        direct.append(model.d[:, command])
        if element.kind == "backlash":
            motions.append(model.c[model.outputs.index(force)])
            continue
        motions.append(building.rate(model.c[model.outputs.index(stroke)]))
        if element.kind == "deadband":
            flows[i] = _compliance(model, stroke, force, found.modes) * model.c[model.outputs.index(force)]
    driven = np.column_stack([model.b, *columns])
    return LinearModel(
        model.a,
        driven,
        np.vstack([model.c, np.array(motions) + flows @ model.a]),
        np.vstack([np.column_stack([model.d, *direct]), flows @ driven]),
        (*model.inputs, *(one.name for one in found.elements)),
        (*model.outputs, *(f"motion of {one.name}" for one in found.elements)),
        input_delay=(*model.input_delay, *np.zeros(len(found.elements))),
    )


def _compliance(model: LinearModel, stroke: str, force: str, modes: tuple[float, ...]) -> float:
    """Lag over velocity feedback of a servo [m/N], from the model's response to the table.

    With zero command the force obeys f = - c v - lag f' - rate times the integral of f.
    """
    omega = np.linspace(0.5 * min(modes), 2.0 * max(modes), SERVO_LINES)
    response = model.select([stroke, force], [signals.GROUND]).frequency_response(omega)[:, :, 0]
    x, f = response.T
    columns = np.column_stack([-1j * omega * x, -1j * omega * f, -f / (1j * omega)])
    both, values = np.vstack([columns.real, columns.imag]), np.concatenate([f.real, f.imag])
    feedback, lag, _ = np.linalg.lstsq(both, values, rcond=None)[0]
    return float(lag / feedback)


@dataclass(frozen=True)
class _Building:
    """The building's modes in a model: the effect of forces between floors, and the motion of the floors.

    `drive` (states, storeys) and `direct` (outputs, storeys) are the B and D columns of a pair of forces that increases
    a storey's drift. `drifts` and `drift_rates` (storeys, states) are C rows of the drifts and of their rates.
    `vectors` (states, modes) and `rows` (modes, states) are right and left eigenvectors of the `poles` above the real
    axis.
    """

    poles: NDArray[np.complex128]
    vectors: NDArray[np.complex128]
    rows: NDArray[np.complex128]
    drive: NDArray[np.float64]
    direct: NDArray[np.float64]
    drifts: NDArray[np.float64]
    drift_rates: NDArray[np.float64]

    @classmethod
    def of(cls, model: LinearModel, found: Nonlinearity) -> _Building:
        poles, vectors = linalg.eig(model.a)
        rows, upper = np.linalg.inv(vectors), np.flatnonzero(poles.imag > 0)
        own = [upper[np.argmin(np.abs(np.abs(poles[upper]) - frequency))] for frequency in found.modes]
        poles, vectors, rows = poles[own], vectors[:, own], rows[own]
        floors, masses = len(found.masses), np.array(found.masses)
        seen = model.c[[model.outputs.index(f"x{floor}") for floor in range(1, floors + 1)]] @ vectors
        # scale each mode so that its shape is real and its modal mass is 1
        scale = np.exp(0.5j * np.angle(np.sum(seen**2, axis=0)))
        shapes = (seen / scale).real
        size = np.sqrt(masses @ shapes**2)
        shapes, scale = shapes / size, scale * size
        between = np.eye(floors) - np.eye(floors, k=-1)
        opened = between @ shapes
        drive = 2 * np.real(vectors @ (opened.T / (2j * poles.imag * scale)[:, None]))
        direct = np.zeros((len(model.outputs), floors))
        for floor in range(floors):
            direct[model.outputs.index(f"a{floor + 1}")] = shapes[floor] @ opened.T
        drifts, rates = (between @ (2 * np.real(each @ rows)) for each in (seen, poles * seen))
        return cls(poles, vectors, rows, drive, direct, drifts, rates)

    def rate(self, row: NDArray[np.float64]) -> NDArray[np.float64]:
        """(states,) the C row of the time derivative of a signal with C row `row`, in the building's modes only."""
        return np.asarray(2 * np.real((self.poles * (row @ self.vectors)) @ self.rows))

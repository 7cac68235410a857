# SPDX-License-Identifier: Apache-2.0
"""What is not linear in a rig, as forces on its identified model.

Each element answers to a motion r of the model, with a force or an impulse:

- Friction of a storey: a force within its limit on the floors above and below it, against the rate of its drift.
- Joints of a storey: a force on the same floors. Part of the storey's stiffness yields (Bouc 1967, Wen 1976, with
  exponent 1 and a yield drift far beyond the tests' drifts), so that softening and loss grow with the drift.
- Deadband of a valve: a force on the command, against the flow v + (tau / c) f'. The force is short of the command by
  the error at which the valve still is shut.
- Backlash of the pins: an impulse on the command when the brace's force changes sign. While the rod crosses the
  clearance b, the servo's velocity feedback c makes c b less of the force's impulse.
- Seals of a brace: an impulse on the command when the stroke turns. The servo takes the friction back within its lag.

The floors are moved by the building's modes, whose shapes are those of the model's displacements; by reciprocity they
say how a force on a floor drives the modes, once the floors' masses are known (`validity.mechanics`). What an element
does on the average the linear model has already, as a slope of the force over r at the amplitude of the tests (Bussgang
1952): it is taken off where the element acts.
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
"""In the provenance of a model: its `Nonlinearity`."""

OF_STOREYS, IMPULSES = ("friction", "joints"), ("backlash", "seals")
"""Kinds of elements between floors, the others being of brace groups; and those that act by impulses."""

UNITS = {"friction": "N", "joints": "N/m", "deadband": "N", "backlash": "N s", "seals": "N s"}

SERVO_LINES = 200
"""Frequencies at which the servo is looked at, between half the first and twice the last mode."""


@dataclass(frozen=True)
class Element:
    """One of them.

    Parameters
    ----------
    kind
        "friction", "joints", "deadband", "backlash" or "seals".
    place
        Storey, 1 the lowest, or brace group, 1 the first.
    limit, deviation
        Greatest force [N], of backlash and seals half the impulse [N s], of joints the stiffness that yields [N/m];
        and its standard deviation.
    slope
        Of the force over r in the linear model.
    yield_drift
        Of joints [m].
    """

    kind: str
    place: int
    limit: float = 0.0
    deviation: float = 0.0
    slope: float = 0.0
    yield_drift: float = 0.0

    @property
    def name(self) -> str:
        """As a signal of a model."""
        return f"{self.kind} {self.place}"


@dataclass(frozen=True)
class Nonlinearity:
    """All elements of a rig, and what they need to act on a model.

    Parameters
    ----------
    elements
        Each found in the tests.
    masses
        Of the floors, lowest first [kg].
    modes
        Frequencies of the building's modes [rad/s].
    """

    elements: tuple[Element, ...]
    masses: tuple[float, ...]
    modes: tuple[float, ...]

    @property
    def kinds(self) -> str:
        """Each kind once, as it is shown."""
        return ", ".join(dict.fromkeys(one.kind for one in self.elements))

    @property
    def text(self) -> str:
        """Each element with its limit, joints without."""
        said = []
        for one in self.elements:
            where = f"{'storey' if one.kind in OF_STOREYS else 'brace group'} {one.place}"
            amount = f" {one.limit:.3g} N" if UNITS[one.kind] == "N" else ""
            said.append(f"{one.kind} in {where}{amount}")
        return ", ".join(said)

    @classmethod
    def of_model(cls, model: LinearModel) -> Nonlinearity | None:
        """As it stands in a model's provenance; None: it is not there."""
        content: dict[str, Any] | None = model.provenance.get(KEY)
        if content is None:
            return None
        elements = tuple(Element(**one) for one in content["elements"])
        return cls(elements, tuple(content["masses"]), tuple(content["modes"]))

    def noted_in(self, model: LinearModel) -> LinearModel:
        """The `model` with this in its provenance."""
        return replace(model, provenance={**model.provenance, KEY: asdict(self)})


@takes_models
def with_elements(model: LinearModel, found: Nonlinearity) -> LinearModel:
    """The model with an input for the force or impulse of each element, and its motion r as an output.

    Parameters
    ----------
    model
        Continuous; with all displacements and accelerations of the floors, strokes and forces.
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
    """Lag over velocity feedback of a servo [m/N].

    With zero command f = - c v - lag f' - rate times the integral of f, which the response to the table shows.
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
    """The building's modes in a model: what forces between floors do to it, and how floors move.

    `drive` (states, storeys) and `direct` (outputs, storeys) are of forces that open a storey; `drifts` and
    `drift_rates` (storeys, states); `vectors` (states, modes) and `rows` (modes, states) of the modes above the real
    axis, with their `poles`.
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
        # of each mode the phase and size that make its shape real and of unit modal mass
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
        """(states,) that give the rate of what a `row` (states,) gives, as far as the building moves it."""
        return np.asarray(2 * np.real((self.poles * (row @ self.vectors)) @ self.rows))

"""The controller at run time: Eq. (13) as an observer that is told which command really acted.

U(n) = C_d q(n) + D_d y(n),     q(n+1) = A_d q(n) + B_d y(n) + G_d (U_acted(n) - U(n))

While nothing limits the command this is Eq. (13) as printed. Where it is cut, ramped or faded the estimate q follows
the command that acted, so that it neither winds up nor jumps when the command is its own again. Besides, the estimate
expects y(n) = P_d [q(n); U_acted(n)]; what is measured differs by the innovation.
"""

from __future__ import annotations

from collections import deque
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.controller_file import Controller

REMEMBERED = 5000
"""Samples whose innovations are remembered."""


class ControlLaw:
    """Eq. (13) with its state. Each `update` is followed by one `acted`.

    Parameters
    ----------
    controller
        The law with its observer.
    names
        Names of the values that `update` is given; those that the controller measures are picked out of them.

    Attributes
    ----------
    names
        Of the quantities that it measures.

    Raises
    ------
    AbraceError
        If a quantity that the controller measures is not among them.
    """

    def __init__(self, controller: Controller, names: Sequence[str]) -> None:
        law = controller.law
        missing = [name for name in law.inputs if name not in names]
        if missing:
            raise AbraceError(
                f"controller {controller.name} measures {', '.join(missing)}, expected some of {', '.join(names)}"
            )
        self.names = law.inputs
        self._pick = itemgetter(*[names.index(name) for name in law.inputs])
        states, commands = law.order, len(law.outputs)
        c_y, d_y = controller.prediction[:, :states], controller.prediction[:, states:]
        # one product gives commands, next state and innovation: [U; q+; e] = whole [q; y]
        whole = [[law.c, law.d], [law.a, law.b], [-c_y - d_y @ law.c, np.eye(len(c_y)) - d_y @ law.d]]
        self._whole = np.ascontiguousarray(np.block(whole))
        self._correction = np.ascontiguousarray(np.vstack([controller.correction, -d_y]))
        self._vector = np.zeros(self._whole.shape[1])
        self._result = np.zeros(self._whole.shape[0])
        self._state, self._measured = self._vector[:states], self._vector[states:]
        self._command, self._after = self._result[:commands], self._result[commands:]
        self._next, self._innovation = self._after[:states], self._after[states:]
        self._acted = [0.0] * commands
        self._innovations: deque[bytes] = deque(maxlen=REMEMBERED)

    def update(self, values: Sequence[float]) -> NDArray[np.float64]:
        """The commands (commands,) [N] that answer the measured `values`; valid until the next call."""
        self._measured[:] = self._pick(values)
        np.dot(self._whole, self._vector, out=self._result)
        return self._command

    def acted(self, force: list[float]) -> None:
        """The estimate goes on to the next sample, the command in force from this one being `force` (commands,) [N]."""
        self._advance(force)
        self._acted = force
        self._innovations.append(self._innovation.tobytes())

    def bridge(self, samples: int) -> None:
        """Go on over so many lost `samples`: the last measured values hold, as the command in force does.

        Predicted values instead of held ones would leave out how the ground moves, which is most of the innovation.
        """
        for _ in range(samples):
            np.dot(self._whole, self._vector, out=self._result)
            self._advance(self._acted)

    def innovation_rms(self) -> NDArray[np.float64]:
        """(measured,) rms of the innovation over the last REMEMBERED samples; zero before the first."""
        known = np.frombuffer(b"".join(self._innovations)).reshape(-1, len(self._innovation))
        return np.sqrt(np.mean(known**2, axis=0)) if len(known) else np.zeros(len(self._innovation))

    def _advance(self, force: list[float]) -> None:
        if force != self._command.tolist():
            self._after += self._correction @ (np.array(force) - self._command)
        self._state[:] = self._next

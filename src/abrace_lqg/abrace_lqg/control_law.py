# SPDX-License-Identifier: Apache-2.0
"""The control law at run time: Eq. (13) as an observer of the command that is really applied.

U(n) = C_d q(n) + D_d y(n),     q(n+1) = A_d q(n) + B_d y(n) + G_d (U_acted(n) - U(n))

As long as the law's command is applied unchanged this is Eq. (13) as printed. Where it is limited, ramped or faded, the
estimate q follows the applied command U_acted: it neither winds up during saturation nor jumps at its end. The estimate
predicts y(n) = P_d [q(n); U_acted(n)]; measured minus predicted is the innovation.
"""

from __future__ import annotations

from collections import deque
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.model.controller_file import Controller

INNOVATION_WINDOW = 5000
"""Number of samples over which the rms of the innovation is taken."""


class ControlLaw:
    """Eq. (13) with its state. Each `update` is followed by one `advance`.

    Parameters
    ----------
    controller
        The law with its observer.
    names
        Names of the values that `update` is given; the controller's measured quantities are picked from them.

    Attributes
    ----------
    names
        Names of the controller's measured quantities.

    Raises
    ------
    AbraceError
        If a measured quantity of the controller is not among the names.
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
        # one product gives commands, next state and innovation: [U; q+; e] = step_matrix [q; y]
        blocks = [[law.c, law.d], [law.a, law.b], [-c_y - d_y @ law.c, np.eye(len(c_y)) - d_y @ law.d]]
        self._step_matrix = np.ascontiguousarray(np.block(blocks))
        self._correction = np.ascontiguousarray(np.vstack([controller.correction, -d_y]))
        self._vector = np.zeros(self._step_matrix.shape[1])
        self._result = np.zeros(self._step_matrix.shape[0])
        # views: [q; y], and [U; [q+; e]]
        self._state, self._measured = self._vector[:states], self._vector[states:]
        self._command, self._corrected = self._result[:commands], self._result[commands:]
        self._next_state, self._innovation = self._corrected[:states], self._corrected[states:]
        self._applied = [0.0] * commands
        self._innovations: deque[bytes] = deque(maxlen=INNOVATION_WINDOW)

    def update(self, values: Sequence[float]) -> NDArray[np.float64]:
        """The commands (commands,) [N] that answer the measured `values`; valid until the next call."""
        self._measured[:] = self._pick(values)
        # np.dot, a little quicker, lets other threads have the interpreter meanwhile
        np.matmul(self._step_matrix, self._vector, self._result)
        return self._command

    def advance(self, force: list[float]) -> None:
        """Advance the estimate to the next sample, `force` (commands,) [N] being the command that was applied."""
        self._advance(force)
        self._applied = force
        self._innovations.append(self._innovation.tobytes())

    def bridge(self, samples: int) -> None:
        """Advance the estimate over lost `samples`, holding the last measured values and the last applied command.

        Predicted values instead would leave out the ground motion, which is most of the innovation.
        """
        for _ in range(samples):
            np.matmul(self._step_matrix, self._vector, self._result)
            self._advance(self._applied)

    def innovation_rms(self) -> NDArray[np.float64]:
        """(measured,) rms of the innovation over the last INNOVATION_WINDOW samples; zero before the first."""
        innovations = np.frombuffer(b"".join(self._innovations)).reshape(-1, len(self._innovation))
        return np.sqrt(np.mean(innovations**2, axis=0)) if len(innovations) else np.zeros(len(self._innovation))

    def _advance(self, force: list[float]) -> None:
        if force != self._command.tolist():
            self._corrected += self._correction @ (np.array(force) - self._command)
        np.positive(self._next_state, self._state)  # an assignment in NumPy 1 lets other threads have the interpreter

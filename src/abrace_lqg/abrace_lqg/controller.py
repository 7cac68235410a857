"""The controller at run time: Eq. (13), one matrix product a sample.

U(n) = C_d q(n) + D_d y(n),     q(n+1) = A_d q(n) + B_d y(n)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


class ControlLaw:
    """Eq. (13) with its state.

    Parameters
    ----------
    a, b, c, d
        A_d, B_d, C_d, D_d of shapes (states, states), (states, measured), (commands, states), (commands, measured).
    force_limit
        (commands,) [N]: commands are cut to it, either way.
    """

    def __init__(
        self,
        a: NDArray[np.float64],
        b: NDArray[np.float64],
        c: NDArray[np.float64],
        d: NDArray[np.float64],
        force_limit: NDArray[np.float64],
    ) -> None:
        states, commands = len(a), len(c)
        try:
            # one product gives the commands and the next state: [U; q+] = [C D; A B] [q; y]
            self._whole = np.ascontiguousarray(np.block([[c, d], [a, b]]), dtype=np.float64)
        except ValueError as error:
            raise AbraceError(f"control law: matrices do not fit together ({error})") from error
        if a.shape != (states, states) or c.shape != (commands, states) or force_limit.shape != (commands,):
            raise AbraceError(
                f"control law: shapes a {a.shape}, c {c.shape}, force_limit {force_limit.shape}, "
                f"expected ({states}, {states}), ({commands}, {states}), ({commands},)"
            )
        self._limit, self._least = force_limit, -force_limit
        self._vector = np.zeros(self._whole.shape[1])
        self._result = np.zeros(self._whole.shape[0])
        self._state, self._measured = self._vector[:states], self._vector[states:]
        self._command, self._next = self._result[:commands], self._result[commands:]

    def update(self, y: NDArray[np.float64] | Sequence[float]) -> NDArray[np.float64]:
        """The commands (commands,) [N] for the measured values `y` (measured,); valid until the next call."""
        self._measured[:] = y
        np.dot(self._whole, self._vector, out=self._result)
        self._state[:] = self._next
        np.minimum(self._command, self._limit, out=self._command)
        np.maximum(self._command, self._least, out=self._command)
        return self._command

    def reset(self) -> None:
        """Forget the past: q = 0."""
        self._vector[:] = 0.0

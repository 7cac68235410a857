# SPDX-License-Identifier: Apache-2.0
"""The controller in use: fades its command in, and changes over to another controller without a jump in force.

A fade follows half a cosine: at activation and after a fault from the force that is applied then, in a change from the
command of the law in use to that of the incoming law. Both estimates are updated with the same samples and with the
force that is really applied, a mixture of both commands, so that neither has a transient when the fade ends.

A controller whose sample period is n of the rig's answers samples 0, n, 2n, ... from where it begins on; in between its
command is held. Its estimates take the mean of the force that was applied until the next one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_lqg.control_law import ControlLaw

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from abrace_core.model.controller_file import Controller

SETTLING_TIME = 2.0
"""Seconds for which the estimate of an incoming law settles, in parallel with the law in use, before its fade."""


class ActiveController:
    """A controller in use.

    Parameters
    ----------
    controller
        The first controller.
    ramp_time
        Duration of a fade [s].
    rig_period
        Sample period of the rig [s]; 0: that for which the controller was made.

    Attributes
    ----------
    controller
        The controller in use or, during a change, the incoming one.
    rig_period
        Sample period of the rig [s].

    Raises
    ------
    AbraceError
        If the controller is for a rig of another sample period.
    """

    def __init__(self, controller: Controller, ramp_time: float, rig_period: float = 0.0) -> None:
        self.controller = controller
        self.rig_period = rig_period or controller.rig_period
        self._samples = controller.of_rig(self.rig_period)
        self._until_next = 0
        self._applied: list[list[float]] = []
        self._stepped: tuple[ControlLaw | None, ...] = ()
        self._period = controller.law.sample_period
        steps = round(ramp_time / self._period)
        self._fade = [(1 - math.cos(math.pi * j / steps)) / 2 for j in range(1, steps)]
        self._names: tuple[str, ...] = ()
        self._law: ControlLaw | None = None
        self._incoming: ControlLaw | None = None
        self._initial_force = self._command = np.zeros(len(controller.law.outputs))
        self._settling_left = self._fade_step = 0

    @property
    def state(self) -> str:
        """The state in words, for diagnostics."""
        if self._incoming is None:
            return "in use" if self._law else "waiting for samples"
        return "warming up" if self._settling_left else "fading in"

    def reset(self, names: Sequence[str], commands: Sequence[str], force: NDArray[np.float64]) -> None:
        """Start with the next sample: the estimate at zero, the command fading in from the `force` applied until then.

        Parameters
        ----------
        names, commands
            Names of the rig's measured values, and of its commands.
        force
            (commands,) [N].

        Raises
        ------
        AbraceError
            If the controller is for another rig.
        """
        law = self.controller.law
        if law.outputs != tuple(commands):
            raise AbraceError(
                f"controller {self.controller.name} gives {', '.join(law.outputs)}, the rig takes {', '.join(commands)}"
            )
        incoming = ControlLaw(self.controller, names)
        self._names, self._law, self._incoming = tuple(names), None, incoming
        self._initial_force, self._settling_left, self._fade_step = np.array(force), 0, 0
        self._until_next, self._applied, self._stepped = 0, [], ()

    def prepare_change(self, controller: Controller) -> Callable[[], None]:
        """What changes over to another `controller` by a fade, after SETTLING_TIME; nothing is changed before.

        Raises
        ------
        AbraceError
            If no controller is in use yet, a change is under way, or the controller is for another rig or another rate.
        """
        current = self.controller
        if self._law is None or self._incoming is not None:
            raise AbraceError(f"controller {current.name} is {self.state}, expected one in use")
        law = controller.law
        if abs(law.sample_period - self._period) > 1e-12:
            raise AbraceError(
                f"controller {controller.name}: sample period {law.sample_period} s, expected {self._period} s"
            )
        if law.outputs != current.law.outputs or controller.force_limit.tolist() != current.force_limit.tolist():
            raise AbraceError(
                f"controller {controller.name}: {', '.join(law.outputs)} within {controller.force_limit.tolist()} N, "
                f"expected {', '.join(current.law.outputs)} within {current.force_limit.tolist()} N as {current.name}"
            )
        controller.of_rig(self.rig_period)
        incoming = ControlLaw(controller, self._names)

        def change() -> None:
            self._incoming = incoming
            self.controller, self._settling_left, self._fade_step = controller, round(SETTLING_TIME / self._period), 0

        return change

    def require_finite(self, number: int, values: Sequence[float]) -> None:
        """Refuse sample `number` if one of its `values` that a law measures is not finite: before `force`.

        Raises
        ------
        AbraceError
            Naming the first of them.
        """
        used = [name for law in (self._law, self._incoming) if law is not None for name in law.names]
        signals.require_finite(number, values, self._names, used)

    def force(self, values: Sequence[float], lost: int) -> NDArray[np.float64]:
        """The force wanted in answer to a sample.

        Parameters
        ----------
        values
            Measured values, in the order of the names.
        lost
            Number of samples lost just before.

        Returns
        -------
        NDArray
            (commands,) [N], valid until the next call.
        """
        if lost:
            self._bridge(lost)
        if self._until_next:
            self._until_next -= 1
            return self._command
        self._advance()
        self._until_next = self._samples - 1
        self._command = self._answer(values)
        if self._until_next:
            self._command = self._command.copy()
        self._stepped = self._law, self._incoming
        return self._command

    def _answer(self, values: Sequence[float]) -> NDArray[np.float64]:
        """The force wanted in answer to a sample that the controller answers."""
        law, incoming = self._law, self._incoming
        before = self._initial_force if law is None else law.update(values)
        if incoming is None:
            return before
        after = incoming.update(values)
        if self._settling_left:
            self._settling_left -= 1
            return before
        if self._fade_step == len(self._fade):
            self._law, self._incoming = incoming, None
            return after
        share = self._fade[self._fade_step]
        self._fade_step += 1
        return before + share * (after - before)

    def advance(self, force: list[float]) -> None:
        """Advance the estimates to the next sample, `force` (commands,) [N] being applied; once after each `force`."""
        self._applied.append(force)
        if len(self._applied) == self._samples:
            self._advance()

    def _advance(self) -> None:
        """Advance the estimates that have answered to the controller's next sample, by the mean of what was applied."""
        if self._applied:
            force = self._applied[0]
            if len(self._applied) > 1:
                count, columns = len(self._applied), zip(*self._applied, strict=True)
                force = [first + sum(one - first for one in (first, *more)) / count for first, *more in columns]
            for one in self._stepped:
                if one is not None:
                    one.advance(force)
            self._applied = []
        self._stepped = ()

    def _bridge(self, lost: int) -> None:
        """Go on over `lost` samples; those of them that the controller answers are bridged by its estimates."""
        beyond = lost - self._until_next
        if beyond <= 0:
            self._until_next = -beyond
            return
        self._advance()
        answered = -(-beyond // self._samples)
        self._until_next = answered * self._samples - beyond
        for one in (self._law, self._incoming):
            if one is not None:
                one.bridge(answered)

    def innovation_rms(self) -> dict[str, float]:
        """Rms of the innovation by name of the measured quantity; of the incoming law if none is in use yet."""
        law = self._law or self._incoming
        if law is None:
            return {}
        return dict(zip(law.names, law.innovation_rms().tolist(), strict=True))

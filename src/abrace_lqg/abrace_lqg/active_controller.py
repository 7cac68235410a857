"""What the node `controller` does with its samples: a force that comes in smoothly and changes laws smoothly.

A law comes into use by a fade along half a cosine, from the force that acts (when the node is activated, after a
fault) or from the law before it. The estimates of both are fed with the same samples and with the force that really
acted, a mixture of the two, so that neither has anything to catch up with when the fade is over.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_lqg.control_law import ControlLaw

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.controller_file import Controller

WARM_UP = 2.0
"""Seconds for which the estimate of a law that is to follow another runs beside it before the fade begins."""


class ActiveController:
    """A controller in use.

    Parameters
    ----------
    controller
        The one to begin with.
    ramp_time
        [s] of a fade.

    Attributes
    ----------
    controller
        The one in use, or the one that is coming into use.
    """

    def __init__(self, controller: Controller, ramp_time: float) -> None:
        self.controller = controller
        self._period = controller.law.sample_period
        steps = round(ramp_time / self._period)
        self._shares = [(1 - math.cos(math.pi * j / steps)) / 2 for j in range(1, steps)]
        self._names: tuple[str, ...] = ()
        self._law: ControlLaw | None = None
        self._coming: ControlLaw | None = None
        self._held = np.zeros(len(controller.law.outputs))
        self._waiting = self._faded = 0

    @property
    def state(self) -> str:
        """What it is doing, in words."""
        if self._coming is None:
            return "in use" if self._law else "waiting for samples"
        return "warming up" if self._waiting else "fading in"

    def begin(self, names: Sequence[str], commands: Sequence[str], force: NDArray[np.float64]) -> None:
        """Begin anew with the next sample: the estimate at zero, fading in from the force that acts.

        Parameters
        ----------
        names, commands
            Of the rig's measured values and of its commands.
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
        coming = ControlLaw(self.controller, names)
        self._names, self._law, self._coming = tuple(names), None, coming
        self._held, self._waiting, self._faded = np.array(force), 0, 0

    def change(self, controller: Controller) -> None:
        """Let another `controller` follow the one in use: after WARM_UP beside it, by a fade.

        Raises
        ------
        AbraceError
            If nothing is in use yet, a change is under way, or the controller is for another rig.
        """
        now, then = self.controller, controller
        if self._law is None or self._coming is not None:
            raise AbraceError(f"controller {now.name} is {self.state}, expected one in use")
        if abs(then.law.sample_period - self._period) > 1e-12:
            raise AbraceError(
                f"controller {then.name}: sample period {then.law.sample_period} s, expected {self._period} s"
            )
        if then.law.outputs != now.law.outputs or then.force_limit.tolist() != now.force_limit.tolist():
            raise AbraceError(
                f"controller {then.name}: {', '.join(then.law.outputs)} within {then.force_limit.tolist()} N, "
                f"expected {', '.join(now.law.outputs)} within {now.force_limit.tolist()} N as {now.name}"
            )
        self._coming = ControlLaw(then, self._names)
        self.controller, self._waiting, self._faded = then, round(WARM_UP / self._period), 0

    def force(self, values: Sequence[float], lost: int) -> NDArray[np.float64]:
        """The force wanted in answer to a sample.

        Parameters
        ----------
        values
            What was measured, in the order of the names.
        lost
            Samples lost just before.

        Returns
        -------
        NDArray
            (commands,) [N], valid until the next call.
        """
        law, coming = self._law, self._coming
        if lost:
            for one in (law, coming):
                if one is not None:
                    one.bridge(lost)
        before = self._held if law is None else law.update(values)
        if coming is None:
            return before
        after = coming.update(values)
        if self._waiting:
            self._waiting -= 1
            return before
        if self._faded == len(self._shares):
            self._law, self._coming = coming, None
            return after
        share = self._shares[self._faded]
        self._faded += 1
        return before + share * (after - before)

    def acted(self, force: list[float]) -> None:
        """The force (commands,) [N] that acts in answer to the sample; once after each `force`."""
        if self._law is not None:
            self._law.acted(force)
        if self._coming is not None:
            self._coming.acted(force)

    def innovation_rms(self) -> dict[str, float]:
        """Rms of measured minus expected value, by name, of the law in use or, before there is one, coming into use."""
        law = self._law or self._coming
        if law is None:
            return {}
        return dict(zip(law.names, law.innovation_rms().tolist(), strict=True))

# SPDX-License-Identifier: Apache-2.0
"""A control law of your own: a Python class that receives each sample and returns forces. No ROS is needed for it.

    class Skyhook:
        def __init__(self, damping: float = 2.0e5) -> None: ...
        def begin(self, floors: int, groups: int, sample_period: float) -> None: ...
        def force(self, sample: LawSample) -> Sequence[float]: ...

`abrace_node.law_node.run_law` makes a node of it.
"""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.signals import require_finite, response_names

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Force = Sequence[float] | NDArray[np.float64] | float


@dataclass(frozen=True)
class LawSample:
    """What the rig measured at one instant, SI units.

    Parameters
    ----------
    number
        Number of the sample in its run.
    displacement, acceleration
        (floors,) of the floors: relative to the table, and absolute. NaN: the rig has no such sensor.
    stroke, force
        (groups,) of one brace of each group; the force is the mean of the group's load cells. NaN likewise.
    applied
        (groups,) [N], the command for one brace of each group that acted until this sample: what saturation, rate limit
        and fade left of the answer to the last sample but one, unless that was lost or late.
    lost
        Samples that were lost just before this one.
    """

    number: int
    displacement: NDArray[np.float64]
    stroke: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    force: NDArray[np.float64]
    applied: NDArray[np.float64]
    lost: int


class Law(Protocol):
    """A control law. The arguments of its constructor, each with a default, are the node's parameters."""

    def begin(self, floors: int, groups: int, sample_period: float) -> None:
        """Start from rest: the next sample is the first of a run, or the first after a stop.

        The rig has so many `floors` and brace `groups`, and a `sample_period` [s].
        """

    def force(self, sample: LawSample) -> Force:
        """The force of one brace of each group (groups,) [N] from this `sample` on, positive as the load cells'."""


def law_options(law: Callable[..., Law]) -> dict[str, Any]:
    """The arguments of a `law`'s constructor with their defaults: the parameters of its node.

    Raises
    ------
    AbraceError
        If one has no default, or one that no ROS parameter can have.
    """
    found = {}
    for name, parameter in inspect.signature(law).parameters.items():
        value = list(parameter.default) if isinstance(parameter.default, tuple) else parameter.default
        if "float" in inspect.formatannotation(parameter.annotation):
            # `damping: float = 200000` is no parameter for whole numbers
            value = [_as_float(one) for one in value] if isinstance(value, list) else _as_float(value)
        first = value[0] if isinstance(value, list) and value else value
        if not isinstance(first, (bool, int, float, str)):
            given = "nothing" if value is parameter.empty else repr(value)
            raise AbraceError(
                f"{law.__name__}: {name} = {given}, expected a default that is a number, a text, true or false, "
                "or a list of them"
            )
        found[name] = value
    return found


def _as_float(value: Any) -> Any:
    return float(value) if type(value) is int else value


def make_law(law: Callable[..., Law], options: dict[str, Any]) -> Law:
    """The `law` with these `options`; an AbraceError says why it cannot be made."""
    try:
        return law(**options)
    except Exception as error:
        raise AbraceError(f"{law.__name__}: {_in_one_line(error)}") from error


def _in_one_line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")


class GuardedLaw:
    """A law as a node uses it: its forces fade in, and its exceptions become AbraceErrors.

    Parameters
    ----------
    law
        The law.
    sample_period
        [s].
    ramp_time
        Duration of the fade [s].
    """

    def __init__(self, law: Law, sample_period: float, ramp_time: float) -> None:
        self._law = law
        self._period = sample_period
        steps = round(ramp_time / sample_period)
        self._fade = [(1 - math.cos(math.pi * j / steps)) / 2 for j in range(1, steps)]
        self._step = 0
        self._floors = self._groups = 0
        self._names: tuple[str, ...] = ()
        self._measured: list[str] = []

    def begin(self, floors: int, groups: int) -> None:
        """Restart with the next sample of a rig with these numbers of `floors` and brace `groups`."""
        self._floors, self._groups, self._step = floors, groups, 0
        self._names, self._measured = response_names(floors, groups), []
        self._call("begin", floors, groups, self._period)

    def force(self, number: int, z: Sequence[float], applied: Sequence[float], lost: int) -> list[float]:
        """The law's force (groups,) [N] in answer to sample `number`, faded in.

        `z` is [displacements, strokes, accelerations, forces], as measured, NaN where the first sample has NaN: the rig
        has no such sensor; `applied` (groups,) [N] acted until the sample; `lost` samples were lost just before.

        Raises
        ------
        AbraceError
            If a value is not finite, or the law fails.
        """
        if not self._measured:
            self._measured = [name for name, value in zip(self._names, z, strict=True) if not math.isnan(value)]
        require_finite(number, z, self._names, self._measured)
        if not all(map(math.isfinite, applied)):
            raise AbraceError(f"command of sample {number} is {[*applied]}, expected finite numbers")
        floors, groups, values = self._floors, self._groups, np.array(z)
        x, stroke, a, f = np.split(values, np.cumsum([floors, groups, floors]))
        found = self._call("force", LawSample(number, x, stroke, a, f, np.array(applied), lost))
        try:
            force = np.atleast_1d(np.asarray([] if found is None else found, dtype=np.float64))
        except (TypeError, ValueError, OverflowError):
            force = np.empty(0)
        if force.shape != (groups,):
            raise AbraceError(
                f"{self._name('force')}: returned {found!r:.60}, expected a number for each of {groups} brace groups"
            )
        if self._step < len(self._fade):
            force = force * self._fade[self._step]
            self._step += 1
        given: list[float] = force.tolist()
        return given

    def _name(self, method: str) -> str:
        return f"{type(self._law).__name__}.{method}"

    def _call(self, method: str, *arguments: Any) -> Any:
        try:
            return getattr(self._law, method)(*arguments)
        except (Exception, SystemExit) as error:
            raise AbraceError(f"{self._name(method)}: {_in_one_line(error)}") from error

# SPDX-License-Identifier: Apache-2.0
"""Samples of a rig with a name for every number: `x1`, `a3`, `fb`, where the message has `displacement[0]`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from abrace_bags.cdr import decode
from abrace_bags.definitions import message_definition, parse_message_type
from abrace_bringup.viewing.decimation import greatest
from abrace_core.errors import AbraceError
from abrace_core.safety.rig_safety import State
from abrace_core.signals import GROUND, command_names, load_cell_names, response_names, unit

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

RESPONSE_TYPE = "abrace_interfaces/msg/Response"
UTILISATION = "_utilisation"
"""After the name of a load cell: its force over the actuator's capacity."""
_VECTORS = ("displacement", "acceleration", "stroke", "force", "command")


class Samples(NamedTuple):
    """Samples of a rig.

    Parameters
    ----------
    names
        Of the channels.
    values
        (samples, channels) [SI units; of utilisations: 1].
    sequence, state, cause
        Of the last sample, in words where Response.msg has numbers.
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    sequence: int
    state: str
    cause: str

    @property
    def last(self) -> dict[str, float]:
        """The last value of each channel, by name."""
        return dict(zip(self.names, self.values[-1].tolist(), strict=True))

    @property
    def loaded(self) -> dict[str, float]:
        """The last displacements, and of all other channels the value of the greatest magnitude, by name."""
        return dict(zip(self.names, greatest(self.values).tolist(), strict=True)) | {
            name: value for name, value in self.last.items() if name[0] == "x"
        }


def names_of(floors: int, braces: Sequence[int], utilised: bool = True) -> tuple[str, ...]:
    """Names of the channels of a rig.

    >>> names_of(1, [2])
    ('x1', 'xf', 'a1', 'f', 'w', 'U', 'fa_utilisation', 'fb_utilisation', 'fa', 'fb')

    Parameters
    ----------
    floors
        How many.
    braces
        How many are in each group.
    utilised
        Whether the capacity of the actuators is known.
    """
    cells = load_cell_names(braces)
    named = [*response_names(floors, len(braces)), GROUND, *command_names(len(braces))] if braces else []
    named = named or [*(f"{letter}{floor + 1}" for letter in "xa" for floor in range(floors)), GROUND]
    named += [f"{cell}{UTILISATION}" for cell in cells if utilised]
    return (*named, *(cells if max(braces, default=1) > 1 else ()))


class ResponseReader:
    """Reads the messages of a rig's topic `response`.

    Parameters
    ----------
    capacity
        (groups,) greatest force of one brace of each group [N]; of a rig with another number of groups no utilisation
        is given.
    """

    def __init__(self, capacity: Sequence[float]) -> None:
        self._type = parse_message_type(RESPONSE_TYPE, message_definition(RESPONSE_TYPE).text)
        self._capacity = tuple(capacity)

    def read(self, payloads: Sequence[bytes]) -> Samples:
        """The samples of at least one message; where their sizes change, those of the last size alone.

        Parameters
        ----------
        payloads
            The messages as they came from the wire.

        Raises
        ------
        AbraceError
            If one is no Response, or the lengths of the last one's arrays do not belong together.
        """
        fields = self._decode(payloads)
        if any(fields[name].dtype == object for name in (*_VECTORS, "braces")):
            fields = self._decode(payloads[-1:])
        braces = tuple(fields["braces"][-1].tolist())
        force, floors = fields["force"], fields["displacement"].shape[1]
        lengths = [fields[name].shape[1] for name in _VECTORS]
        if lengths != [floors, floors, len(braces), sum(braces), len(braces)] or 0 in braces:
            raise AbraceError(
                f"{', '.join(_VECTORS)} of {lengths} values, {len(braces)} groups of {sum(braces)} braces, expected "
                "floors, floors, groups, braces, groups"
            )
        starts = np.concatenate([[0], np.cumsum(braces)[:-1]]).astype(np.intp)
        mean = np.add.reduceat(force, starts, axis=1) / braces if braces else force
        z = [fields["displacement"], fields["stroke"], fields["acceleration"], mean]
        parts = [*z, fields["ground_acceleration"][:, None], fields["command"]]
        known = len(self._capacity) == len(braces)
        if known:
            parts.append(np.abs(force) / np.repeat(self._capacity, braces))
        if max(braces, default=1) > 1:
            parts.append(force)
        state = int(fields["state"][-1])
        words = State(state).words if state in list(State) else f"state {state}"
        names = names_of(floors, braces, known)
        return Samples(names, np.hstack(parts), int(fields["sequence"][-1]), words, str(fields["cause"][-1]))

    def _decode(self, payloads: Sequence[bytes]) -> Mapping[str, Any]:
        sizes = np.array([len(payload) for payload in payloads])
        blocks = []
        for size in np.unique(sizes).tolist():
            numbers = np.flatnonzero(sizes == size)
            joined = b"".join(payloads[number] for number in numbers.tolist())
            blocks.append((numbers, np.frombuffer(joined, np.dtype((np.void, size)))))
        return decode(self._type, blocks)


def schema(names: Sequence[str]) -> dict[str, Any]:
    """The JSON schema of messages that have these channels: each with its unit, and `null` where it is not finite.

    Parameters
    ----------
    names
        Of the channels, as `Samples.names`.
    """
    units = {name: "1" if name.endswith(UTILISATION) else unit(name) for name in names}
    channels = {name: {"type": "number", "description": f"[{units[name]}]"} for name in names}
    others = {"sequence": {"type": "integer"}, "state": {"type": "string"}, "cause": {"type": "string"}}
    return {"title": "abrace.Channels", "type": "object", "properties": {**channels, **others}}


def message(samples: Samples, row: NDArray[np.float64]) -> dict[str, Any]:
    """A message of such a schema.

    Parameters
    ----------
    samples
        What came; its last state and number are given.
    row
        (channels,) values.
    """
    channels = {
        name: value if np.isfinite(value) else None for name, value in zip(samples.names, row.tolist(), strict=True)
    }
    return {**channels, "sequence": samples.sequence, "state": samples.state, "cause": samples.cause}

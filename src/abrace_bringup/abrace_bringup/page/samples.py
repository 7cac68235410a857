# SPDX-License-Identifier: Apache-2.0
"""Samples of a rig with a name for every number: `x1`, `a3`, `U`, where the message has `displacement[0]`."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_bags.cdr import decode_each
from abrace_bags.definitions import message_definition, parse_message_type
from abrace_bags.run import RESPONSE_TYPE
from abrace_core import AbraceError
from abrace_core.model.signals import GROUND, command_names, response_names

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_VECTORS = ("displacement", "acceleration", "stroke", "force", "command")


class Samples(NamedTuple):
    """Samples of a rig, all of one size.

    Parameters
    ----------
    names
        Of the channels.
    values
        (samples, channels) [SI units]; the force of a group is the mean of its load cells.
    stamps, runs
        (samples,) when each was taken [ns], and in which run.
    floors, groups
        Of the rig that sent them.
    state, flags, cause
        Of the last sample, as in Response.msg.
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    stamps: NDArray[np.int64]
    runs: NDArray[np.uint64]
    floors: int
    groups: int
    state: int
    flags: int
    cause: str


def names_of(floors: int, groups: int) -> tuple[str, ...]:
    """Names of the channels of a rig with so many `floors` and brace `groups`.

    >>> names_of(1, 1)
    ('x1', 'xf', 'a1', 'f', 'w', 'U')
    """
    return (*response_names(floors, groups), GROUND, *command_names(groups))


class ResponseReader:
    """Reads the messages of a rig's topic `response`."""

    def __init__(self) -> None:
        self._type = parse_message_type(RESPONSE_TYPE, message_definition(RESPONSE_TYPE).text)

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
        fields = decode_each(self._type, payloads).fields
        if any(fields[name].dtype == object for name in (*_VECTORS, "braces")):
            fields = decode_each(self._type, payloads[-1:]).fields
        braces = tuple(fields["braces"][-1].tolist())
        force, floors = fields["force"], fields["displacement"].shape[1]
        lengths = [fields[name].shape[1] for name in _VECTORS]
        if lengths != [floors, floors, len(braces), sum(braces), len(braces)] or 0 in braces:
            raise AbraceError(
                f"{', '.join(_VECTORS)} of {lengths} values, {len(braces)} groups of {sum(braces)} braces, expected "
                "floors, floors, groups, braces, groups"
            )
        cells = np.split(force, np.cumsum(braces)[:-1], axis=1) if braces else []
        means = [one[:, there].mean(axis=1) if (there := ~np.isnan(one[-1])).any() else one[:, 0] for one in cells]
        z = [fields["displacement"], fields["stroke"], fields["acceleration"], *means]
        values = np.column_stack([*z, fields["ground_acceleration"], fields["command"]])
        stamps = fields["header.stamp.sec"].astype(np.int64) * 10**9 + fields["header.stamp.nanosec"]
        return Samples(
            names=names_of(floors, len(braces)),
            values=values,
            stamps=stamps,
            runs=fields["run"],
            floors=floors,
            groups=len(braces),
            state=int(fields["state"][-1]),
            flags=int(fields["flags"][-1]),
            cause=str(fields["cause"][-1]),
        )

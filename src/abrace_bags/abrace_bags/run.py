# SPDX-License-Identifier: Apache-2.0
"""A bag's `response` topic as a recorded test of the rig."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_bags.reader import TopicArrays
from abrace_bags.stamps import stamped_times
from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.model.run import Run
from abrace_core.safety.wire import LOCKSTEP

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.files.sample_times import StampFault

RESPONSE_TYPE = "abrace_interfaces/msg/Response"
_FLOORS = ("displacement", "acceleration")
_GROUPS = ("stroke", "command")
_VECTORS = (*_FLOORS, *_GROUPS, "force")
_PERIOD_ERROR = 0.01
"""How far the clock of a rig may be from the sample period that the facts state."""
_LEAST_JUMP = 0.03
"""Seconds by which stamps depart before a run is warned of whose facts state its period."""
_MOST_TOLD = 3
"""Faults of stamps that are named; of more the number."""


def runs_of(
    source: str, response: TopicArrays, facts: Mapping[str, str], warnings: Sequence[str], every: int = 1
) -> list[list[Run]]:
    """The runs of each time that the rig was activated; in one none of its samples is missing.

    Parameters
    ----------
    source
        The bag's name.
    response
        The samples.
    facts, warnings
        Of the bag; both become facts of each run, with what is missing between the runs.
    every
        Of so many samples one was to be recorded.

    Raises
    ------
    AbraceError
        If there is no sample, or they have no known period, change their size, or a value is not finite.
    """
    if not response.log_time.size:
        raise AbraceError("has no messages, expected a recorded test")
    missing = [name for name in (*_VECTORS, "sequence", "ground_acceleration") if name not in response.fields]
    if missing:
        raise AbraceError(f"has no field {missing[0]}, expected this version's {RESPONSE_TYPE}")
    response = _said_once(response)
    sequence = response.fields["sequence"]
    again = sequence[1:] <= sequence[:-1]
    if "run" in response.fields:
        again |= np.diff(response.fields["run"]) != 0
    activated = [0, *(np.flatnonzero(again) + 1).tolist(), sequence.size]
    bounds = [0, *(np.flatnonzero(again | (np.diff(sequence) != every)) + 1).tolist(), sequence.size]
    of_rig, note, faults = _sample_period(response, facts)
    period = every * of_rig
    if every > 1:
        folded = f"motion above {0.5 / period:g} Hz is folded into what is below"
        note = [*note, f"{source}: one of {every} samples was recorded, without a filter: {folded}"]
    runs = []
    for number, (begin, end) in enumerate(itertools.pairwise(activated), start=1):
        name = f"{source}, run {number} of {len(activated) - 1}" if len(activated) > 2 else source
        edges = [bound for bound in bounds if begin <= bound <= end]
        pieces = []
        for first, last in itertools.pairwise(edges):
            told = [fault.text for fault in faults if first < fault.sample < last or fault.sample == first == begin]
            found = [*warnings, *note]
            if told:
                more = [f"and {len(told) - _MOST_TOLD} more"] if len(told) > _MOST_TOLD else []
                wrong = "; ".join([*told[:_MOST_TOLD], *more])
                found.append(f"{name}: {wrong}; the sample rate by all stamps is {1 / of_rig:.6g} Hz")
            if len(edges) > 2:
                span = f"samples {sequence[first]} to {sequence[last - 1]} are used, {(last - first) * period:g} s of"
                found.append(f"{name}: {_gaps(sequence, edges, every, period)}; {span} {(end - begin) * period:g}")
            of_piece: dict[str, Any] = dict(facts)
            if found:
                of_piece["warnings"] = found
            if every > 1:
                of_piece["every"] = every
            pieces.append(_run(name, _part(response, slice(first, last)), period, every, of_piece))
        runs.append(pieces)
    return runs


def _gaps(sequence: NDArray[np.uint64], edges: list[int], every: int, period: float) -> str:
    """What is missing in a run, of which a piece begins at each of the `edges` but the last."""
    before, after = int(sequence[edges[1] - 1]), int(sequence[edges[1]])
    missing = (after - before) // every - 1
    more = f" and {len(edges) - 3} more" if len(edges) > 3 else ""
    return f"a gap after sample {before} ({missing} samples, {missing * period:g} s){more}"


def _said_once(response: TopicArrays) -> TopicArrays:
    """The samples without those that a rig in lockstep has said again, until they were answered.

    `logger` does not record them, `ros2 bag record` does.
    """
    fields = response.fields
    if not {"flags", "run"} <= fields.keys():
        return response
    stamp = ("header.stamp.sec", "header.stamp.nanosec")
    same = fields["flags"][1:] & LOCKSTEP != 0
    for name in ("sequence", "run", *stamp):
        same = same & (np.diff(fields[name]) == 0)
    return _part(response, np.concatenate([[True], ~same])) if same.any() else response


def _part(response: TopicArrays, which: slice | NDArray[np.bool_]) -> TopicArrays:
    return TopicArrays(
        response.type_name,
        {name: values[which] for name, values in response.fields.items()},
        response.log_time[which],
        response.publish_time[which],
    )


def _run(source: str, response: TopicArrays, period: float, every: int, facts: dict[str, Any]) -> Run:
    sequence = response.fields["sequence"]
    values = {name: _measured(name, response.fields[name], sequence) for name in (*_VECTORS, "ground_acceleration")}
    for names in (_FLOORS, _GROUPS):
        sizes = [values[name].shape[1] for name in names]
        if len(set(sizes)) > 1:
            raise AbraceError(f"{', '.join(names)} have {sizes} values, expected equal numbers")
    braces = _braces(response, values["stroke"].shape[1], values["force"].shape[1])
    floors, groups = values["displacement"].shape[1], len(braces)
    kinds = ("displacement", "stroke", "acceleration", "force", "ground_acceleration")
    channels = np.column_stack([values[name] for name in kinds])
    known = signals.channel_names(floors, braces)
    without = tuple(name for name, column in zip(known, channels[0].tolist(), strict=True) if math.isnan(column))
    cells, ends = values["force"], np.cumsum([0, *braces]).tolist()
    there = [[i for i in range(*edges) if not math.isnan(cells[0, i])] for edges in itertools.pairwise(ends)]
    forces = [cells[:, some].sum(axis=1) / len(some) for some in there if some]
    others = channels[:, : 2 * floors + groups]
    cause = next(filter(None, response.fields.get("cause", ())), "")
    return Run(
        source=source,
        sample_period=period,
        sequence=sequence // every,
        floors=floors,
        groups=groups,
        outputs=np.column_stack([others[:, ~np.isnan(others[0])], *forces]),
        ground_acceleration=values["ground_acceleration"],
        command=values["command"],
        facts=facts | ({"stopped": str(cause)} if cause else {}),
        clipped=response.fields.get("clipped"),
        braces=braces,
        forces=cells[:, [i for some in there for i in some]],
        without=without,
    )


def _braces(response: TopicArrays, groups: int, forces: int) -> tuple[int, ...]:
    """Braces in each group; responses that do not say have one force for each group."""
    counts = response.fields.get("braces", np.ones((1, groups), dtype=np.uint8))
    if counts.dtype == object or (counts != counts[0]).any():
        raise AbraceError("braces are not the same in all samples")
    braces = tuple(counts[0].tolist())
    if len(braces) != groups or sum(braces) != forces or 0 in braces:
        raise AbraceError(f"braces {list(braces)} of {groups} groups with {forces} forces, expected one of each brace")
    return braces


def _measured(name: str, values: NDArray[np.float64], sequence: NDArray[np.uint64]) -> NDArray[np.float64]:
    """The `values`, finite, or NaN throughout where there is no sensor."""
    if values.dtype == object:
        raise AbraceError(f"{name} does not have the same number of values in all samples")
    wrong = ~np.isfinite(values).reshape(len(values), -1)
    if name != "command":
        wrong &= ~np.isnan(values.reshape(len(values), -1)).all(axis=0)
    bad = np.flatnonzero(wrong.any(axis=1))
    if bad.size:
        raise AbraceError(f"{name} of sample {sequence[bad[0]]} is {values[bad[0]]}, expected finite values")
    return values


def _sample_period(response: TopicArrays, facts: Mapping[str, str]) -> tuple[float, list[str], list[StampFault]]:
    """Seconds between two samples, a warning if the facts and the stamps contradict each other, faults of stamps.

    The stamps are when samples were really taken. The facts say the period exactly, unless the stamps say something
    else, which then holds. Without facts it is that of the stamps: a whole number of samples a second, if one lies
    within their jitter.
    """
    stated = None
    if "sample_period" in facts:
        try:
            stated = float(facts["sample_period"])
        except ValueError:
            stated = math.nan
        if not 0.0 < stated < math.inf:
            raise AbraceError(f"fact sample_period is {facts['sample_period']!r}, expected seconds above 0")
    seconds, nanoseconds = (response.fields[f"header.stamp.{part}"].astype(np.int64) for part in ("sec", "nanosec"))
    found = stamped_times(seconds * 1_000_000_000 + nanoseconds, response.fields["sequence"].astype(np.int64))
    if not found.period > 0:
        if stated is None:
            raise AbraceError("its stamps do not increase and the facts have no sample_period")
        return stated, [], []
    if stated is None:
        return found.whole, [], list(found.faults)
    if abs(found.period / stated - 1) > _PERIOD_ERROR + 2 * found.jitter / max(found.span, found.period):
        warning = (
            f"fact sample_period is {stated:g} s, but the samples' stamps are {found.whole:g} s apart, which is used"
        )
        return found.whole, [warning], list(found.faults)
    return stated, [], [fault for fault in found.faults if fault.size >= _LEAST_JUMP]

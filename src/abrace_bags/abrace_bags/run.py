# SPDX-License-Identifier: Apache-2.0
"""A bag's `response` topic as a recorded test of the rig."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_bags.bag import in_brackets
from abrace_bags.reader import TopicArrays, read_selected
from abrace_core.errors import AbraceError
from abrace_core.run import Run
from abrace_core.sequence import breaks

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

RESPONSE_TYPE = "abrace_interfaces/msg/Response"
_FLOORS = ("displacement", "acceleration")
_GROUPS = ("stroke", "command")
_VECTORS = (*_FLOORS, *_GROUPS, "force")


def read_run(bag: Path | str, topic: str | None = None) -> Run:
    """Read a recorded test of the rig from a bag, of which no sample may be missing.

    Parameters
    ----------
    bag
        A bag directory or a single file.
    topic
        The topic of the responses; when None, the only one of their type.

    Returns
    -------
    Run
        The test. The reader's warnings of a bag that was cut off or damaged are in its facts, as `warnings`.

    Raises
    ------
    AbraceError
        If there is no such bag or topic, it has no messages, lacks samples, has several runs, or a value is not finite.
    """
    return _runs(bag, topic, whole=True)[0]


def read_runs(bag: Path | str, topic: str | None = None) -> list[Run]:
    """Read the recorded tests of the rig from a bag: a new run begins where the rig was activated again.

    `bag`, `topic` and what is raised are as for `read_run`, but samples may be missing: each run has those of the bag,
    with their numbers.
    """
    return _runs(bag, topic, whole=False)


def _runs(bag: Path | str, topic: str | None, whole: bool) -> list[Run]:
    contents = read_selected(bag, lambda channel: channel.type_name == RESPONSE_TYPE)
    why = in_brackets(contents.warnings)
    if topic is None and len(contents) > 1:
        raise AbraceError(f"{bag}: has {len(contents)} topics of responses, name one of {', '.join(contents)}")
    if topic is None:
        topic = next(iter(contents), None)
    if topic is None or topic not in contents:
        raise AbraceError(f"{bag}: no topic {topic or ''} of type {RESPONSE_TYPE} in it{why}".replace("  ", " "))
    facts: dict[str, Any] = dict(contents.facts)
    if contents.warnings:
        facts["warnings"] = list(contents.warnings)
    try:
        parts = _parts(contents[topic], whole)
        names = [f"{bag}, run {k} of {len(parts)}" if len(parts) > 1 else f"{bag}" for k in range(1, len(parts) + 1)]
        return [_run(name, part, facts) for name, part in zip(names, parts, strict=True)]
    except AbraceError as error:
        raise AbraceError(f"{bag}: topic {topic}: {error}{why}") from error


def _parts(response: TopicArrays, whole: bool) -> list[TopicArrays]:
    """The runs of a topic of responses; of a `whole` one, which lacks no sample, there is one."""
    if not response.log_time.size:
        raise AbraceError("has no messages, expected a recorded test")
    missing = [name for name in (*_VECTORS, "sequence", "ground_acceleration") if name not in response.fields]
    if missing:
        raise AbraceError(f"has no field {missing[0]}, expected this version's {RESPONSE_TYPE}")
    sequence = response.fields["sequence"]
    if whole:
        _check_sequence(sequence)
    again = sequence[1:] <= sequence[:-1]
    if "run" in response.fields:
        again |= np.diff(response.fields["run"]) != 0
    restarts = np.flatnonzero(again) + 1
    bounds = [0, *restarts.tolist(), sequence.size]
    return [
        TopicArrays(
            response.type_name,
            {name: values[begin:end] for name, values in response.fields.items()},
            response.log_time[begin:end],
            response.publish_time[begin:end],
        )
        for begin, end in itertools.pairwise(bounds)
    ]


def _run(source: str, response: TopicArrays, facts: dict[str, Any]) -> Run:
    sequence = response.fields["sequence"]
    values = {name: _finite(name, response.fields[name], sequence) for name in _VECTORS}
    for names in (_FLOORS, _GROUPS):
        sizes = [values[name].shape[1] for name in names]
        if len(set(sizes)) > 1:
            raise AbraceError(f"{', '.join(names)} have {sizes} values, expected equal numbers")
    braces = _braces(response, values["stroke"].shape[1], values["force"].shape[1])
    starts = np.concatenate([[0], np.cumsum(braces)[:-1]]).astype(np.intp)
    forces = values["force"]
    values["force"] = np.add.reduceat(forces, starts, axis=1) / braces if braces else forces
    return Run(
        source=source,
        sample_period=_sample_period(response, facts),
        sequence=sequence,
        floors=values["displacement"].shape[1],
        groups=values["stroke"].shape[1],
        outputs=np.hstack([values[name] for name in ("displacement", "stroke", "acceleration", "force")]),
        ground_acceleration=_finite("ground_acceleration", response.fields["ground_acceleration"], sequence),
        command=values["command"],
        facts=dict(facts),
        clipped=response.fields.get("clipped"),
        braces=braces,
        forces=forces,
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


def _check_sequence(sequence: NDArray[np.uint64]) -> None:
    gaps = breaks(sequence)
    if gaps.size:
        before, after = sequence[gaps[0]], sequence[gaps[0] + 1]
        again = " (the rig was activated again)" if after < before else ""
        raise AbraceError(f"sample {before} is followed by sample {after}{again}, expected {before + np.uint64(1)}")


def _finite(name: str, values: NDArray[np.float64], sequence: NDArray[np.uint64]) -> NDArray[np.float64]:
    if values.dtype == object:
        raise AbraceError(f"{name} does not have the same number of values in all samples")
    bad = np.flatnonzero(~np.isfinite(values).reshape(len(values), -1).all(axis=1))
    if bad.size:
        raise AbraceError(f"{name} of sample {sequence[bad[0]]} is {values[bad[0]]}, expected finite values")
    return values


def _sample_period(response: TopicArrays, facts: dict[str, Any]) -> float:
    """Seconds: as the facts say, else as the stamps have it, which are when samples were really taken.

    Then it is a whole number of samples a second, if one lies within the jitter of the stamps.
    """
    if "sample_period" in facts:
        try:
            period = float(facts["sample_period"])
        except ValueError:
            period = math.nan
        if not 0.0 < period < math.inf:
            raise AbraceError(f"fact sample_period is {facts['sample_period']!r}, expected seconds above 0")
        return period
    seconds, nanoseconds = response.fields["header.stamp.sec"], response.fields["header.stamp.nanosec"]
    stamps = seconds.astype(np.int64) * 1_000_000_000 + nanoseconds
    # the middle half: at the beginning a rig may take its time
    middle = slice(stamps.size // 4, stamps.size - stamps.size // 4)
    numbers = response.fields["sequence"][middle].astype(np.int64)
    times = (stamps[middle] - stamps[0]) * 1e-9
    numbers, times = numbers - numbers[:1], times - times[:1]
    if numbers.size < 2 or times[-1] <= 0.0 or numbers[-1] <= 0:
        raise AbraceError("its stamps do not increase and the facts have no sample_period")
    period = float(times[-1] / numbers[-1])
    jitter = float(np.abs(times - numbers * period).max() / times[-1])
    rate = round(1 / period)
    return 1 / rate if rate and abs(rate * period - 1) <= 2 * jitter + 1e-9 else period

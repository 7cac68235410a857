"""A bag's `response` topic as a recorded test of the rig."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from abrace_bags.bag import in_brackets
from abrace_bags.reader import read_selected
from abrace_core.errors import AbraceError
from abrace_core.run import Run
from abrace_core.sequence import breaks

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace_bags.reader import TopicArrays

RESPONSE_TYPE = "abrace_interfaces/msg/Response"
_FLOORS = ("displacement", "acceleration")
_GROUPS = ("stroke", "force", "command")


def read_run(bag: Path | str, topic: str | None = None, whole: bool = True) -> Run:
    """Read a recorded test of the rig from a bag.

    Parameters
    ----------
    bag
        A bag directory or a single MCAP file.
    topic
        The topic of the responses; when None, the only one of their type.
    whole
        Whether missing samples are an error; if not, the run has the samples of the bag, with their numbers.

    Returns
    -------
    Run
        The test. The reader's warnings of a bag that was cut off or damaged are in its facts, as `warnings`.

    Raises
    ------
    AbraceError
        If there is no such bag or topic, it has no messages, a test that has to be whole lacks samples, or a value is
        not finite.
    """
    contents = read_selected(bag, lambda channel: channel.type_name == RESPONSE_TYPE)
    why = in_brackets(contents.warnings)
    if topic is None and len(contents) > 1:
        raise AbraceError(f"{bag}: has {len(contents)} topics of responses, name one of {', '.join(contents)}")
    if topic is None:
        topic = next(iter(contents), None)
    if topic is None or topic not in contents:
        raise AbraceError(f"{bag}: no topic {topic or ''} of type {RESPONSE_TYPE} in it{why}".replace("  ", " "))
    response = contents[topic]
    try:
        run = _run(str(bag), response, contents.facts, whole)
    except AbraceError as error:
        raise AbraceError(f"{bag}: topic {topic}: {error}{why}") from error
    if contents.warnings:
        run.facts["warnings"] = list(contents.warnings)
    return run


def _run(source: str, response: TopicArrays, facts: dict[str, str], whole: bool) -> Run:
    if not response.log_time.size:
        raise AbraceError("has no messages, expected a recorded test")
    missing = [name for name in (*_FLOORS, *_GROUPS, "sequence", "ground_acceleration") if name not in response.fields]
    if missing:
        raise AbraceError(f"has no field {missing[0]}, expected this version's {RESPONSE_TYPE}")
    sequence = response.fields["sequence"]
    if whole:
        _check_sequence(sequence)
    values = {name: _finite(name, response.fields[name], sequence) for name in (*_FLOORS, *_GROUPS)}
    for names in (_FLOORS, _GROUPS):
        sizes = [values[name].shape[1] for name in names]
        if len(set(sizes)) > 1:
            raise AbraceError(f"{', '.join(names)} have {sizes} values, expected equal numbers")
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
    )


def _check_sequence(sequence: NDArray[np.uint64]) -> None:
    gaps = breaks(sequence)
    if gaps.size:
        before, after = sequence[gaps[0]], sequence[gaps[0] + 1]
        raise AbraceError(f"sample {before} is followed by sample {after}, expected {before + np.uint64(1)}")


def _finite(name: str, values: NDArray[np.float64], sequence: NDArray[np.uint64]) -> NDArray[np.float64]:
    if values.dtype == object:
        raise AbraceError(f"{name} has not the same number of values in all samples")
    bad = np.flatnonzero(~np.isfinite(values).reshape(len(values), -1).all(axis=1))
    if bad.size:
        raise AbraceError(f"{name} of sample {sequence[bad[0]]} is {values[bad[0]]}, expected finite values")
    return values


def _sample_period(response: TopicArrays, facts: dict[str, str]) -> float:
    """Seconds: as the facts say, else the median step of the stamps."""
    if "sample_period" in facts:
        try:
            period = float(facts["sample_period"])
        except ValueError:
            period = math.nan
        if not 0.0 < period < math.inf:
            raise AbraceError(f"fact sample_period is {facts['sample_period']!r}, expected seconds above 0")
        return period
    seconds, nanoseconds = response.fields["header.stamp.sec"], response.fields["header.stamp.nanosec"]
    steps = np.diff(seconds.astype(np.int64) * 1_000_000_000 + nanoseconds)
    period = float(np.median(steps)) * 1e-9 if steps.size else 0.0
    if period <= 0.0:
        raise AbraceError("its stamps don't count up and the facts have no sample_period")
    return period

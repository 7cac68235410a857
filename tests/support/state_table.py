# SPDX-License-Identifier: Apache-2.0
"""The states of a rig with all events, written by hand, and a walk of a real RigSafety through all of them.

The expected states are those of a person, never read from the code: `TRANSITIONS` is what is tested.
docs/rig.md is compared with this table as well.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from unittest import mock

from abrace_core import AbraceError
from abrace_core.safety import rig_safety
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import RAMP_TIME, TRANSITIONS, Event, RigSafety, State
from abrace_core.safety.table_guard import TableGuard
from abrace_core.safety.table_stop import Table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from abrace_core.safety.rig_safety import Output

    Action = Callable[[RigSafety], object]

EXPECTED = """
| event                              | unconfigured    | standby         | arming          | fading in    | running      | ramping down    | latched         | protective stop | not at rest     |
| configure                          | standby         | refused         | refused         | refused      | refused      | refused         | -               | -               | refused         |
| cleanup                            | refused         | unconfigured    | refused         | refused      | refused      | refused         | -               | -               | latched         |
| activate                           | refused         | arming          | refused         | refused      | refused      | refused         | refused         | refused         | refused         |
| deactivate                         | refused         | -               | standby         | ramping down | ramping down | -               | -               | -               | -               |
| a fault                            | latched         | latched         | latched         | ramping down | ramping down | -               | -               | -               | -               |
| a stop is pressed                  | protective stop | protective stop | protective stop | ramping down | ramping down | -               | protective stop | -               | -               |
| the last stop is released          | -               | -               | -               | -            | -            | -               | -               | latched         | -               |
| clear_fault while unconfigured     | refused         |                 |                 |              |              |                 | unconfigured    | refused         |                 |
| clear_fault while inactive         |                 | refused         |                 |              |              | refused         | standby         | refused         | refused         |
| clear_fault while active           |                 |                 | refused         | refused      | refused      | refused         | arming          | refused         | refused         |
| the target is armed                |                 |                 | fading in       |              |              |                 |                 |                 |                 |
| the fade is over                   |                 |                 |                 | running      |              |                 |                 |                 |                 |
| all at rest, no fault              |                 |                 |                 |              |              | standby         |                 |                 |                 |
| all at rest after a fault          |                 |                 |                 |              |              | latched         |                 |                 | latched         |
| all at rest, a stop pressed        |                 |                 |                 |              |              | protective stop |                 |                 | protective stop |
| a force is measured after the ramp |                 |                 |                 |              |              | not at rest     | not at rest     | not at rest     |                 |
"""  # noqa: E501
"""-: no change; refused: the caller gets the reason; empty: it cannot happen."""


def cells(text: str) -> dict[tuple[str, str], str]:
    """By (state, event), the expected state of a table like EXPECTED, without the empty cells."""
    head, *rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in text.strip().splitlines())
    return {
        (state, row[0]): state if cell == "-" else cell
        for row in rows
        for state, cell in zip(head[1:], row[1:], strict=True)
        if cell
    }


PRESSED = "pressed by panel"


def _act(safety: RigSafety) -> None:
    safety.act([[100.0] * len(output.value) if i == 0 else [0.05] for i, output in enumerate(safety.outputs)])


def _until_it_changes(safety: RigSafety) -> None:
    before = safety.state
    for _ in range(3000):
        if safety.state is not before:
            return
        _act(safety)
        safety.look("")


def _begin(safety: RigSafety) -> None:
    safety.begin()


def _measure(safety: RigSafety) -> None:
    """A force is measured after the ramp, for longer than REST_TIME."""
    before = safety.state
    for _ in range(1000):
        if safety.state is not before:
            return
        _act(safety)
        safety.look("fa 20000 N")


def _measure_once_within(safety: RigSafety) -> None:
    safety.look("")


def _fault(safety: RigSafety) -> None:
    safety.fault("planted")


def _press(safety: RigSafety) -> None:
    safety.press(PRESSED)


ACTIONS: dict[str, Action] = {
    "cleanup": RigSafety.clean_up,
    "activate": RigSafety.activate,
    "deactivate": RigSafety.deactivate,
    "a fault": _fault,
    "a stop is pressed": _press,
    "the last stop is released": RigSafety.release,
    "clear_fault while unconfigured": RigSafety.clear,
    "clear_fault while inactive": RigSafety.clear,
    "clear_fault while active": RigSafety.clear,
    "the target is armed": _begin,
    "the fade is over": _until_it_changes,
    "all at rest, no fault": _until_it_changes,
    "all at rest after a fault": _until_it_changes,
    "all at rest, a stop pressed": _until_it_changes,
    "a force is measured after the ramp": _measure,
}
"""What brings the events about, but for `configure`, which takes the outputs."""

REQUESTS = ["configure", *(event for event in ACTIONS if ACTIONS[event] not in (_until_it_changes, _measure))]
"""The events that people and nodes bring about; the others come by themselves."""

_ARMING = ("configure", "activate")
_RUN = (*_ARMING, "the target is armed", _until_it_changes)
_LATCH = (*_RUN, "a fault", _until_it_changes)
PREPARATIONS: dict[str, Sequence[str | Action]] = {
    "unconfigured": (),
    "standby": ("configure",),
    "arming": _ARMING,
    "fading in": (*_ARMING, "the target is armed", _act),
    "running": _RUN,
    "ramping down": (*_RUN, "a fault"),
    "latched": _LATCH,
    "protective stop": (*_LATCH, "a stop is pressed"),
    "not at rest": (*_RUN, "a fault", _measure),
}
"""How a new RigSafety comes into each state."""

OTHER_PREPARATIONS: dict[tuple[str, str], Sequence[str | Action]] = {
    ("ramping down", "clear_fault while inactive"): (*_RUN, "a fault", "deactivate"),
    ("ramping down", "all at rest, no fault"): (*_RUN, "deactivate"),
    ("ramping down", "all at rest, a stop pressed"): (*_RUN, "a stop is pressed"),
    ("not at rest", "clear_fault while active"): (*_RUN, "a fault", _measure, _measure_once_within),
    ("not at rest", "clear_fault while inactive"): (*_RUN, "a fault", _measure, "deactivate", _measure_once_within),
    ("not at rest", "all at rest, a stop pressed"): (*_RUN, "a fault", "a stop is pressed", _measure),
    ("latched", "clear_fault while unconfigured"): ("a fault",),
    ("latched", "clear_fault while inactive"): ("configure", "a fault"),
    ("protective stop", "clear_fault while unconfigured"): ("a stop is pressed",),
    ("protective stop", "clear_fault while inactive"): ("configure", "a stop is pressed"),
}
"""The same for events that need another way there."""


TABLE = Table(10.0, 2000.0, 1.0, 0.25)
LONG = 0.05
"""Sample period [s] with which ramps have few samples."""


def _outputs() -> Sequence[Output]:
    return [CommandGuard([1000.0], [1e5], LONG, RAMP_TIME), TableGuard(TABLE, LONG)]


class StateWalk:
    """Takes new RigSafety objects into every state, and tries every event there.

    Parameters
    ----------
    outputs
        Makes the outputs: the braces' forces and the table.
    sample_period
        [s].
    """

    def __init__(self, outputs: Callable[[], Sequence[Output]] = _outputs, sample_period: float = LONG) -> None:
        self._configure: Action = lambda safety: safety.configure(outputs(), sample_period)

    def do(self, safety: RigSafety, step: str | Action) -> None:
        """Bring about an event, given by its text, or do something else."""
        action = step if callable(step) else self._configure if step == "configure" else ACTIONS[step]
        action(safety)

    def prepared(self, state: str, event: str = "") -> RigSafety:
        """A new RigSafety in a `state`, ready for an `event`; raises an AbraceError if it does not come there."""
        safety = RigSafety()
        for step in OTHER_PREPARATIONS.get((state, event), PREPARATIONS[state]):
            self.do(safety, step)
        if safety.state.words != state:
            raise AbraceError(f"{safety.state.words}, expected {state}")
        return safety

    def outcome(self, state: str, event: str) -> str:
        """What an `event` does in a `state`: the next state, or "refused" if the state is then the same."""
        try:
            safety = self.prepared(state, event)
        except AbraceError as error:
            return f"not there: {error}"
        try:
            self.do(safety, event)
        except AbraceError:
            return "refused" if safety.state.words == state else f"refused, but {safety.state.words}"
        return safety.state.words

    def differences(self) -> Iterator[str]:
        """Each cell of EXPECTED whose outcome is another one."""
        for (state, event), expected in cells(EXPECTED).items():
            if (found := self.outcome(state, event)) != expected:
                yield f"{event} in {state}: {found}, expected {expected}"

    def planted(self, state: str, event: str) -> tuple[int, list[str]]:
        """Plant each other outcome of a cell in the machine; how many there are, and those that make no difference."""
        now = next(one for one in State if one.words == state)
        key = next(one for one in Event if one.value == event)
        right, count, survivors = TRANSITIONS[now].get(key, now), 0, []
        for wrong in [*State, "planted"]:
            if wrong is right or (wrong == "planted" and isinstance(right, str)):
                continue
            count += 1
            cell = {**TRANSITIONS[now], key: wrong}
            with mock.patch.object(rig_safety, "TRANSITIONS", {**TRANSITIONS, now: cell}):
                if self.outcome(state, event) == cells(EXPECTED)[state, event]:
                    survivors.append(f"{event} in {state}: {wrong!r} instead of {right!r}")
        return count, survivors

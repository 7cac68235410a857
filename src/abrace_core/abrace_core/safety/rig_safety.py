# SPDX-License-Identifier: Apache-2.0
"""The state machine that decides whether commands act on a rig, common to table and braces, without ROS.

Every rig, simulated or real, has one. Each node that commands the rig has another one for its own commands, and reads
the rig's state from every sample. `TRANSITIONS` alone defines the transitions, for every state and every event.
"""

from __future__ import annotations

import math
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Protocol

from abrace_core.errors import AbraceError
from abrace_core.safety.stop_senders import UNNAMED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

RAMP_TIME = 0.5
"""Seconds in which forces ramp down to zero, and in which they fade in after a fault has been cleared."""


class State(IntEnum):
    """The states; the numbers are those of Response.msg."""

    UNCONFIGURED = 0
    STANDBY = 1
    FADING_IN = 2
    RUNNING = 3
    RAMPING_DOWN = 4
    LATCHED = 5
    PROTECTIVE_STOP = 6

    @property
    def words(self) -> str:
        """The state's name in messages."""
        return self.name.lower().replace("_", " ")


ACTING = (State.FADING_IN, State.RUNNING)
"""States in which commands act."""


class Event(Enum):
    """The events; the values are their texts."""

    CONFIGURE = "configure"
    CLEAN_UP = "cleanup"
    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"
    FAULT = "a fault"
    STOP = "a stop is pressed"
    RELEASE = "the last stop is released"
    CLEAR_UNCONFIGURED = "clear_fault while unconfigured"
    CLEAR_INACTIVE = "clear_fault while inactive"
    CLEAR_ACTIVE = "clear_fault while active"
    FADED_IN = "the fade is over"
    AT_REST = "all at rest, no fault"
    AT_REST_FAULT = "all at rest after a fault"
    AT_REST_STOP = "all at rest, a stop pressed"


_CLEARS = (Event.CLEAR_UNCONFIGURED, Event.CLEAR_INACTIVE, Event.CLEAR_ACTIVE)


def _row(state: State, refused: Mapping[Event, str] | None = None, **leads: State) -> dict[Event, State | str]:
    """The outcomes of all events in a `state`: next states (`leads`), reasons (`refused`); others change nothing."""
    row: dict[Event, State | str] = dict.fromkeys(Event, state)
    row.update({Event[name]: following for name, following in leads.items()})
    row.update(refused or {})
    return row


_NO_FAULT = dict.fromkeys(_CLEARS, "no fault")
_LIFE_CYCLE = (Event.CONFIGURE, Event.CLEAN_UP, Event.ACTIVATE, Event.DEACTIVATE)
_ACTIVE = dict.fromkeys((Event.CONFIGURE, Event.CLEAN_UP, Event.ACTIVATE), "active")

TRANSITIONS: Mapping[State, Mapping[Event, State | str]] = {
    State.UNCONFIGURED: _row(
        State.UNCONFIGURED,
        {**_NO_FAULT, **dict.fromkeys((Event.CLEAN_UP, Event.ACTIVATE, Event.DEACTIVATE), "unconfigured")},
        CONFIGURE=State.STANDBY,
        FAULT=State.LATCHED,
        STOP=State.PROTECTIVE_STOP,
    ),
    State.STANDBY: _row(
        State.STANDBY,
        {**_NO_FAULT, **dict.fromkeys((Event.CONFIGURE, Event.DEACTIVATE), "inactive")},
        CLEAN_UP=State.UNCONFIGURED,
        ACTIVATE=State.RUNNING,
        FAULT=State.LATCHED,
        STOP=State.PROTECTIVE_STOP,
    ),
    State.FADING_IN: _row(
        State.FADING_IN,
        {**_NO_FAULT, **_ACTIVE},
        DEACTIVATE=State.RAMPING_DOWN,
        FAULT=State.RAMPING_DOWN,
        STOP=State.RAMPING_DOWN,
        FADED_IN=State.RUNNING,
    ),
    State.RUNNING: _row(
        State.RUNNING,
        {**_NO_FAULT, **_ACTIVE},
        DEACTIVATE=State.RAMPING_DOWN,
        FAULT=State.RAMPING_DOWN,
        STOP=State.RAMPING_DOWN,
    ),
    State.RAMPING_DOWN: _row(
        State.RAMPING_DOWN,
        {
            **dict.fromkeys(_CLEARS, "still ramping down"),
            **dict.fromkeys((Event.CONFIGURE, Event.CLEAN_UP, Event.ACTIVATE), "still ramping down"),
        },
        AT_REST=State.STANDBY,
        AT_REST_FAULT=State.LATCHED,
        AT_REST_STOP=State.PROTECTIVE_STOP,
    ),
    # life cycle transitions end neither a fault nor a stop: all are allowed except those after which commands would act
    State.LATCHED: _row(
        State.LATCHED,
        {Event.ACTIVATE: "a fault is latched, expected a person to clear it first"},
        STOP=State.PROTECTIVE_STOP,
        CLEAR_UNCONFIGURED=State.UNCONFIGURED,
        CLEAR_INACTIVE=State.STANDBY,
        CLEAR_ACTIVE=State.FADING_IN,
    ),
    State.PROTECTIVE_STOP: _row(
        State.PROTECTIVE_STOP,
        {
            Event.ACTIVATE: "a stop is pressed, expected it to be released and cleared first",
            **dict.fromkeys(_CLEARS, "a stop is still pressed"),
        },
        RELEASE=State.LATCHED,
    ),
}
"""By state and event: the next state, or the reason why the event is refused."""


class Output(Protocol):
    """A command with its limits: the forces of the braces, or the acceleration of the table."""

    value: list[float]
    """The values that act from the last sample on."""

    @property
    def moving(self) -> bool:
        """Whether the output acts on the rig, so that it needs a sender and a loop that is in time."""

    @property
    def at_rest(self) -> bool:
        """Whether the output has come to rest."""

    def problem(self, command: Sequence[float]) -> str | None:
        """Why a command cannot act; None: it can."""

    def follow(self, command: Sequence[float] | None, share: float) -> None:
        """Apply a `share` of the command within the limits, or all of it; None: of the last command."""

    def hold(self, samples: int) -> None:
        """Count `samples` in which the last values went on acting, because no command could be given."""

    def begin_to_rest(self) -> None:
        """Begin the ramp to rest; it advances from the next sample on."""

    def come_to_rest(self, samples: int) -> None:
        """Advance the ramp to rest by this number of samples."""

    def reset(self) -> None:
        """Set the output to rest at once."""


class RigSafety:
    """The state machine, and the only owner of the outputs.

    Attributes
    ----------
    state
        The present state.
    cause
        Cause of the first fault or stop since a person cleared the last one; empty: none.
    pressed
        The senders that press a stop; empty: none.
    outputs
        The outputs given to `configure`.
    """

    def __init__(self) -> None:
        self.state = State.UNCONFIGURED
        self.cause = ""
        self.pressed = ""
        self.outputs: Sequence[Output] = ()
        self._life = State.UNCONFIGURED
        self._fade: list[float] = []
        self._faded = 0
        self._entered = False
        """Whether the state is new since the last sample."""

    @property
    def acting(self) -> bool:
        """Whether commands act."""
        return self.state in ACTING

    @property
    def at_rest(self) -> bool:
        """Whether no command acts and no ramp to rest is in progress."""
        return self.state not in (*ACTING, State.RAMPING_DOWN)

    def _take(self, event: Event) -> None:
        """Take the transition of an event; an AbraceError gives the reason for a refusal."""
        outcome = TRANSITIONS[self.state][event]
        if isinstance(outcome, str):
            raise AbraceError(f"{outcome}{f' ({self.cause})' if self.cause else ''}")
        before, self.state = self.state, outcome
        self._entered |= before is not outcome
        if outcome is State.RAMPING_DOWN and before is not outcome:
            for output in self.outputs:
                output.begin_to_rest()
        elif outcome is State.FADING_IN and before is not outcome:
            self._faded = 0

    def configure(self, outputs: Sequence[Output], sample_period: float) -> None:
        """Take over the `outputs` of a rig with this `sample_period` [s].

        Raises
        ------
        AbraceError
            If the state does not allow it; so do `activate`, `deactivate` and `clean_up`.
        """
        self._take(Event.CONFIGURE)
        self._life = State.STANDBY
        self.outputs = outputs
        steps = round(RAMP_TIME / sample_period)
        self._fade = [(1 - math.cos(math.pi * j / steps)) / 2 for j in range(1, steps)]

    def activate(self) -> None:
        """Let commands act, from rest."""
        self._take(Event.ACTIVATE)
        self._life = State.RUNNING
        for output in self.outputs:
            output.reset()

    def deactivate(self) -> None:
        """Begin to come to rest; `at_rest` is true when that is done."""
        self._take(Event.DEACTIVATE)
        self._life = State.STANDBY

    def clean_up(self) -> None:
        """Release the outputs; a fault stays latched."""
        self._take(Event.CLEAN_UP)
        self._life = State.UNCONFIGURED
        self.outputs = ()

    def fault(self, cause: str) -> None:
        """Report a fault: all outputs come to rest until a person clears it; the first cause is kept."""
        self.cause = self.cause or cause
        self._take(Event.FAULT)

    def stop(self, who: str) -> None:
        """Report that the senders named in `who` press a stop; empty: the last stop has been released."""
        if who:
            # the sender's name may become known after its message
            renamed = UNNAMED in self.pressed and self.cause == f"protective stop: {self.pressed}"
            if not self.cause or renamed:
                self.cause = f"protective stop: {who}"
            self.pressed = who
            self._take(Event.STOP)
        elif self.pressed:
            self.pressed = ""
            self._take(Event.RELEASE)

    def clear(self, moving: str = "") -> str:
        """Clear the fault, by a person's request; commands then fade in. Returns the cause that was cleared.

        `moving` names the input that is not at rest; empty: all are at rest.

        Raises
        ------
        AbraceError
            If there is no fault, a stop is pressed, or something is not at rest yet.
        """
        event = {
            State.UNCONFIGURED: Event.CLEAR_UNCONFIGURED,
            State.STANDBY: Event.CLEAR_INACTIVE,
            State.RUNNING: Event.CLEAR_ACTIVE,
        }[self._life]
        outcome = TRANSITIONS[self.state][event]
        if moving and not isinstance(outcome, str):
            raise AbraceError(f"{moving}, expected every input at rest first")
        self._take(event)
        for output in self.outputs:
            output.reset()
        cause, self.cause = self.cause, ""
        return cause

    def act(self, commands: Sequence[Sequence[float] | None], samples: int = 1) -> None:
        """Apply the commands from this sample on; called once for each sample.

        Parameters
        ----------
        commands
            The new command of each output; None: the last one holds. A command that cannot act is a fault.
        samples
            Sample periods since the last call.
        """
        if self.state in ACTING:
            for output, command in zip(self.outputs, commands, strict=True):
                if command is not None and (problem := output.problem(command)):
                    self.fault(problem)
                    break
        since = samples
        # a new ramp or fade advances by one sample, even if samples were lost before this one
        samples, self._entered = 1 if self._entered else samples, False
        # a ramp to rest counts those that it advances by
        if since > 1 and (held := since - (samples if self.state is State.RAMPING_DOWN else 1)):
            for output in self.outputs:
                output.hold(held)
        if self.state is State.RUNNING:
            for output, command in zip(self.outputs, commands, strict=True):
                output.follow(command, 1.0)
        elif self.state is State.FADING_IN:
            self._faded += samples
            share = self._fade[self._faded - 1] if self._faded <= len(self._fade) else 1.0
            for output, command in zip(self.outputs, commands, strict=True):
                output.follow(command, share)
            if share == 1.0:
                self._take(Event.FADED_IN)
        elif self.state is State.RAMPING_DOWN:
            for output in self.outputs:
                output.come_to_rest(samples)
            self._look_for_rest()

    def rest(self) -> None:
        """Set all outputs to rest at once, because the commands do not act anyway: the rig has stopped or is silent."""
        for output in self.outputs:
            output.reset()
        self._look_for_rest()

    def _look_for_rest(self) -> None:
        if self.state is State.RAMPING_DOWN and all(output.at_rest for output in self.outputs):
            self._take(Event.AT_REST_STOP if self.pressed else Event.AT_REST_FAULT if self.cause else Event.AT_REST)

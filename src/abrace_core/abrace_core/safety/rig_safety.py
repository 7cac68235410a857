# SPDX-License-Identifier: Apache-2.0
"""The state machine that decides whether commands act on a rig, common to table and braces, without ROS.

Every rig, simulated or real, has one. Each node that commands the rig has another one for its own commands, and reads
the rig's state from every sample. `TRANSITIONS` alone defines the transitions; docs/rig.md shows them.
"""

from __future__ import annotations

import math
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Protocol

from abrace_core import AbraceError
from abrace_core.safety.stop_senders import UNNAMED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

RAMP_TIME = 0.5
"""Seconds in which forces ramp down to zero, the table stops if its limits allow, and commands fade in after `activate`
or `clear`."""
REST_TIME = 0.2
"""Seconds after the ramp within which what is measured has to be at rest."""
STOPPED = "protective stop: "
"""Beginning of the cause of a stop; the senders that press it follow."""

NOT_AT_REST = "not at rest after the ramp: "
"""The same of what is measured then; it is added to the first cause."""
NOT_MEASURED = "not yet known to be at rest: "
"""The same of why a fault is not cleared, a moment after a stop."""


class State(IntEnum):
    """The states; the numbers are those of Response.msg."""

    UNCONFIGURED = 0
    STANDBY = 1
    FADING_IN = 2
    RUNNING = 3
    RAMPING_DOWN = 4
    LATCHED = 5
    PROTECTIVE_STOP = 6
    ARMING = 7
    NOT_AT_REST = 8

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
    ARMED = "the target is armed"
    FADED_IN = "the fade is over"
    AT_REST = "all at rest, no fault"
    AT_REST_FAULT = "all at rest after a fault"
    AT_REST_STOP = "all at rest, a stop pressed"
    FORCE_MEASURED = "a force is measured after the ramp"


_ACTIVE: Mapping[Event, State | str] = {
    Event.CONFIGURE: "active",
    Event.CLEAN_UP: "active",
    Event.ACTIVATE: "active",
    Event.CLEAR_ACTIVE: "no fault",
}
_ACTING: Mapping[Event, State | str] = {
    **_ACTIVE,
    Event.DEACTIVATE: State.RAMPING_DOWN,
    Event.FAULT: State.RAMPING_DOWN,
    Event.STOP: State.RAMPING_DOWN,
}

TRANSITIONS: Mapping[State, Mapping[Event, State | str]] = {
    State.UNCONFIGURED: {
        Event.CONFIGURE: State.STANDBY,
        Event.CLEAN_UP: "unconfigured",
        Event.ACTIVATE: "unconfigured",
        Event.DEACTIVATE: "unconfigured",
        Event.FAULT: State.LATCHED,
        Event.STOP: State.PROTECTIVE_STOP,
        Event.CLEAR_UNCONFIGURED: "no fault",
    },
    State.STANDBY: {
        Event.CONFIGURE: "inactive",
        Event.CLEAN_UP: State.UNCONFIGURED,
        Event.ACTIVATE: State.ARMING,
        Event.FAULT: State.LATCHED,
        Event.STOP: State.PROTECTIVE_STOP,
        Event.CLEAR_INACTIVE: "no fault",
    },
    State.ARMING: {
        **_ACTIVE,
        Event.DEACTIVATE: State.STANDBY,
        Event.FAULT: State.LATCHED,
        Event.STOP: State.PROTECTIVE_STOP,
        Event.ARMED: State.FADING_IN,
    },
    State.FADING_IN: {**_ACTING, Event.FADED_IN: State.RUNNING},
    State.RUNNING: _ACTING,
    State.RAMPING_DOWN: {
        Event.CONFIGURE: "still ramping down",
        Event.CLEAN_UP: "still ramping down",
        Event.ACTIVATE: "still ramping down",
        Event.CLEAR_INACTIVE: "still ramping down",
        Event.CLEAR_ACTIVE: "still ramping down",
        Event.AT_REST: State.STANDBY,
        Event.AT_REST_FAULT: State.LATCHED,
        Event.AT_REST_STOP: State.PROTECTIVE_STOP,
        Event.FORCE_MEASURED: State.NOT_AT_REST,
    },
    # the life cycle ends neither a fault nor a stop: every change is allowed but the one after which commands would act
    State.LATCHED: {
        Event.ACTIVATE: "a fault is latched, expected a person to clear it first",
        Event.STOP: State.PROTECTIVE_STOP,
        Event.CLEAR_UNCONFIGURED: State.UNCONFIGURED,
        Event.CLEAR_INACTIVE: State.STANDBY,
        Event.CLEAR_ACTIVE: State.ARMING,
        Event.FORCE_MEASURED: State.NOT_AT_REST,
    },
    State.PROTECTIVE_STOP: {
        Event.ACTIVATE: "a stop is pressed, expected it to be released and cleared first",
        Event.RELEASE: State.LATCHED,
        Event.CLEAR_UNCONFIGURED: "a stop is still pressed",
        Event.CLEAR_INACTIVE: "a stop is still pressed",
        Event.CLEAR_ACTIVE: "a stop is still pressed",
        Event.FORCE_MEASURED: State.NOT_AT_REST,
    },
    State.NOT_AT_REST: {
        Event.CONFIGURE: "not at rest",
        Event.CLEAN_UP: State.LATCHED,
        Event.ACTIVATE: "not at rest",
        Event.CLEAR_INACTIVE: "not at rest",
        Event.CLEAR_ACTIVE: "not at rest",
        Event.AT_REST_FAULT: State.LATCHED,
        Event.AT_REST_STOP: State.PROTECTIVE_STOP,
    },
}
"""By state and event: the next state, or the reason why the event is refused; an event that is not there changes
nothing."""


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
        Cause of the first fault or stop since a person cleared the last one, and what was measured after the ramp;
        empty: none.
    pressed
        The senders that press a stop; empty: none.
    outputs
        The outputs given to `configure`.
    measured
        What was measured last that is not at rest; empty: all is at rest, or nobody measures.
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
        self.measured = ""
        self._rest_samples = self._otherwise = 0
        """Samples of REST_TIME, and how many in a row have measured something else than the state says."""

    @property
    def acting(self) -> bool:
        """Whether commands act."""
        return self.state in ACTING

    @property
    def at_rest(self) -> bool:
        """Whether no command acts, no ramp to rest is in progress, and no force has been measured after one."""
        return self.state not in (*ACTING, State.RAMPING_DOWN, State.NOT_AT_REST)

    def _outcome(self, event: Event) -> State | str:
        return TRANSITIONS[self.state].get(event, self.state)

    def _take(self, event: Event) -> None:
        """Take the transition of an event; an AbraceError gives the reason for a refusal."""
        outcome = self._outcome(event)
        if isinstance(outcome, str):
            raise AbraceError(f"{outcome}{f' ({self.cause})' if self.cause else ''}")
        before, self.state = self.state, outcome
        self._entered |= before is not outcome
        if outcome is State.RAMPING_DOWN and before is not outcome:
            for output in self.outputs:
                output.begin_to_rest()
        elif outcome is State.FADING_IN and before is not outcome:
            self._faded = 0

    def configure(self, outputs: Sequence[Output], sample_period: float, fade_time: float = RAMP_TIME) -> None:
        """Take over the `outputs` of a rig with this `sample_period` [s]; commands fade in within `fade_time` [s].

        Raises
        ------
        AbraceError
            If the state does not allow it; so do `activate`, `deactivate` and `clean_up`.
        """
        self._take(Event.CONFIGURE)
        self._life = State.STANDBY
        self.outputs = outputs
        self.measured = ""
        self._rest_samples = round(REST_TIME / sample_period)
        steps = round(fade_time / sample_period)
        self._fade = [(1 - math.cos(math.pi * j / steps)) / 2 for j in range(1, steps)]

    def activate(self) -> None:
        """Ask for commands to act: `begin` lets them."""
        self._take(Event.ACTIVATE)
        self._life = State.RUNNING

    def begin(self, moving: str = "") -> None:
        """Report that the target is armed: after `activate` or `clear` commands now fade in, from rest.

        `moving` is as for `clear`. That, or anything that is measured, is a fault instead.
        """
        if self.state is not State.ARMING:
            return
        if problem := self._not_at_rest(moving):
            self.fault(problem)
            return
        self._take(Event.ARMED)
        for output in self.outputs:
            output.reset()
        if not self._fade:
            self._take(Event.FADED_IN)

    def _not_at_rest(self, moving: str) -> str:
        """Why commands may not act yet: `moving`, or what is measured; empty: they may."""
        return moving or (f"measured {self.measured}, expected the rig at rest first" if self.measured else "")

    def deactivate(self) -> None:
        """Begin to come to rest; `at_rest` is true when that is done."""
        self._take(Event.DEACTIVATE)
        self._life = State.STANDBY

    def stay_active(self, cause: str) -> None:
        """Take back `deactivate`: the rig has not come to rest, with this `cause`, and is latched when it does."""
        self._life = State.RUNNING
        self.cause = self.cause or cause

    def clean_up(self) -> None:
        """Release the outputs; a fault stays latched, and a stop pressed."""
        unheard = self.state is State.NOT_AT_REST and self.pressed
        self._take(Event.CLEAN_UP)
        self._life = State.UNCONFIGURED
        self.outputs, self.measured = (), ""
        if unheard:
            self._take(Event.STOP)

    def fault(self, cause: str) -> None:
        """Report a fault: all outputs come to rest until a person clears it; the first cause is kept."""
        self.cause = self.cause or cause
        self._take(Event.FAULT)

    def press(self, who: str) -> None:
        """Report that the senders named in `who` press a stop."""
        # the sender's name may become known after its message
        renamed = UNNAMED in self.pressed and self.cause == f"{STOPPED}{self.pressed}"
        if not self.cause or renamed:
            self.cause = f"{STOPPED}{who}"
        self.pressed = who
        self._take(Event.STOP)

    def release(self) -> None:
        """Report that no sender presses a stop any more."""
        self.pressed = ""
        self._take(Event.RELEASE)

    def clear(self, moving: str = "") -> str:
        """Clear the fault, by a person's request; an active rig then arms. Returns the cause that was cleared.

        `moving` says which input is not at rest, or what else keeps commands from acting; empty: nothing does.

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
        if not isinstance(self._outcome(event), str) and (problem := self._not_at_rest(moving)):
            raise AbraceError(problem)
        self._take(event)
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
        # a ramp or fade that begins with this sample has made one step, however many samples were missed before
        steps, self._entered = 1 if self._entered else samples, False
        # the sample periods in which the last values went on acting
        held = samples - (steps if self.state is State.RAMPING_DOWN else 1)
        if held > 0:
            for output in self.outputs:
                output.hold(held)
        if self.state is State.RUNNING:
            for output, command in zip(self.outputs, commands, strict=True):
                output.follow(command, 1.0)
        elif self.state is State.FADING_IN:
            self._faded += steps
            share = self._fade[self._faded - 1] if self._faded <= len(self._fade) else 1.0
            for output, command in zip(self.outputs, commands, strict=True):
                output.follow(command, share)
            if share == 1.0:
                self._take(Event.FADED_IN)
        elif self.state is State.RAMPING_DOWN:
            for output in self.outputs:
                output.come_to_rest(steps)
            self._look_for_rest()

    def rest(self) -> None:
        """Set all outputs to rest at once, because the commands do not act anyway: the rig has stopped or is silent."""
        for output in self.outputs:
            output.reset()
        self._look_for_rest()

    def look(self, measured: str, samples: int = 1) -> None:
        """Compare what the load cells and the table show with the state, at each sample.

        Parameters
        ----------
        measured
            What is not at rest, as text; empty: all is.
        samples
            Sample periods since the last call.
        """
        self.measured = measured
        ramping = self.state is State.RAMPING_DOWN
        if ramping and not measured:
            self._look_for_rest()
        elif self.state in (State.LATCHED, State.PROTECTIVE_STOP, State.NOT_AT_REST) or (ramping and self._still):
            as_it_says = bool(measured) is (self.state is State.NOT_AT_REST)
            self._otherwise = 0 if as_it_says else self._otherwise + samples
            if self._otherwise > self._rest_samples:
                self._otherwise = 0
                if measured:
                    if NOT_AT_REST not in self.cause:
                        self.cause = "; ".join(filter(None, (self.cause, f"{NOT_AT_REST}{measured}")))
                    self._take(Event.FORCE_MEASURED)
                else:
                    self._take(self._rest)
        else:
            self._otherwise = 0

    @property
    def _still(self) -> bool:
        """Whether all outputs have come to rest."""
        return all(output.at_rest for output in self.outputs)

    @property
    def _rest(self) -> Event:
        """The event with which all comes to rest now."""
        return Event.AT_REST_STOP if self.pressed else Event.AT_REST_FAULT if self.cause else Event.AT_REST

    def _look_for_rest(self) -> None:
        if self.state is State.RAMPING_DOWN and self._still and not self.measured:
            self._otherwise = 0
            self._take(self._rest)

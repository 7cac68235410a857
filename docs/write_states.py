# SPDX-License-Identifier: Apache-2.0
"""Write docs/states.md from the table that the rig's safety runs from: `python docs/write_states.py`."""

from __future__ import annotations

from pathlib import Path

from abrace_core.files import write_text
from abrace_core.safety.rig_safety import RAMP_TIME, TRANSITIONS, Event, State

PAGE = Path(__file__).parent / "states.md"

INTRODUCTION = f"""# The states of a rig

Written by `python docs/write_states.py` from the table that the code uses, `abrace_core.safety.rig_safety.TRANSITIONS`;
a test tries every event in every state.

Braces and table have one common state. The rig, simulated or behind the bridge, decides it, and every `response`
carries it (`state`), with the first cause (`cause`) and what was limited (`flags`). The controller and the signals
(excitation, ground motion) have the same state machine for what they send; while the rig lets nothing act they command
zero.

| state | what acts |
|---|---|
| unconfigured | nothing; there is no rig yet |
| standby | nothing: configured, but not active |
| fading in | forces, times a factor that grows to one in {RAMP_TIME:g} s after a person cleared a fault; the table |
| running | commands, within capacity, rate limit and the limits of the table |
| ramping down | forces go to zero along a half cosine in {RAMP_TIME:g} s, the table stops within its stroke |
| latched | nothing: there was a fault, and a person has to clear it |
| protective stop | nothing: a stop is pressed, or its heartbeat is missing |

A stop that comes over a network is a *protective stop* of stop category 1 in the terms of IEC 60204-1: the motion is
brought to rest under control with power on, and then power is removed. abrace does the first part; the second one is
for the laboratory's hardware, and where nothing removes power, the stop is one of category 2. It is never the
*emergency stop* of category 0, which removes power at once and which only hardware can provide: a laboratory needs
such a button as well, wired to the hydraulics.

## Every event in every state

"-": no change; *refused*: the caller gets the reason.

"""

END = """
A fault and a stop outlast the life cycle: a latched rig can be deactivated, cleaned up and configured again,
and is still latched; `activate` is refused until a person calls `clear_fault`. That is refused while force or table are
still on the way to zero, while an input still requests a force or a motion, or while its sender reports a fault of its
own.

## How it is tested

`make verify` tries every event in every state on a real `RigSafety`, and 20 times each on running nodes the following
cases (`python benchmarks/safety.py`, results in `safety` of `results/verify.json`): stop buttons of each QoS on both
names, two of them, one whose sender is gone, and one whose heartbeat falls silent; `clear_fault` while another node
commands and during the ramp; a rig that is deactivated, interrupted or delayed for 3 s, and a controller that is
deactivated or interrupted; commands that are not finite, of wrong length, of two senders, or of one that reports a
fault of its own; a second rig in the namespace; a node that joins; old and repeated samples; a law with the wrong
sign; a stop in El Centro, and its release, after which the record does not play again; motions beyond the table's
limits, refused or cut; a sensor at the end of its range; services of a controller in use. A controller is killed,
stopped (SIGSTOP) and made to flood the rig, 100 times each, behind `sensor_bridge` and the emulator: the force has to
be zero within `command_timeout`, ramp and 5 samples, with no step beyond the rate limit, in the samples and at the
emulated actuators.

Measured on two virtual processors with nothing else running, in one run of 23 minutes: 98 of 98 pairs, 16 of 16
interlocks, all 28 cases 20 of 20; killed, stopped and flooding 100 of 100 each; no step beyond the rate limit. One of
the cases, services of a controller in use, passes only if not one answer acts late: on a worse day it passed 17 of 20
runs, or 1 of 5. In turns with it the same is tried without a service (`without_services`), for what the machine itself
delays ([numbers](real_time.md#threads)). With other work on the same processors up to 3 of 20 runs of three cases
failed, and 1 of 100 of killed, while the machine stalled.

A rig's fault before the controller is killed, stopped or floods is cleared, and `faults_before` counts it. Runs that
fail while the machine itself stalls for 1 ms or more in a sample period (`benchmarks/machine_stalls.py`) count as
failed, and `while_stalled` says how many. Where other programs keep all processors busy, cases by the clock fail now
and then: samples or answers are late.

`make soak` sends 10 000 messages of correct type and wrong content to every topic and service of two running graphs
(`python benchmarks/wrong_endurance.py`), which are asked what they have: one of `sensor_bridge`, its device the
emulator, with every other node (`excitation`, `ground_motion`, `controller`, `logger`, `replay` by the clock and in
lockstep, `supervisor`, `jitter`, `operator` with an open page, `viewer` with a client of all topics), and one of
`plant`, `excitation` and `ground_motion`. No node may end. Every command, as the samples report it and as the emulated
device receives it before it limits it, has to be finite and within capacity, and every step within the rate limit; the
table's acceleration and its steps likewise. Whenever that has stopped the rig, the fault is cleared and force acts
again. Transitions that the life cycle has are not requested: a node that is shut down has to end. Up to 1000 samples
are then answered by a sender that is alone, in right form and with any finite values: these commands act, up to
capacity, peak acceleration, rate limit and limit of jerk.

Measured in one run of 52 minutes on two virtual processors: 1 670 000 messages on 25 topics and 142 services, while the
rigs took 1 327 049 samples, 1 129 819 of them with a force, and were stopped 1358 times. No node ended, nothing was not
finite, and at the emulated device nothing exceeded capacity, rate limit, peak acceleration or limit of jerk.

`make soak` also runs 20 minutes of lockstep (`python benchmarks/lockstep_endurance.py`): no node may grow by 1 MB after
the first minute, and two runs have to give the same bytes.

`make test` has a short form of each: one run of killed, stopped and flooding behind bridge and emulator, 10 wrong
messages of each kind, two runs of lockstep with at most 0.2 MB in the last 5500 samples, and four
[interlocks](planted_causes.md) tripped on the running node.

A rig whose loop was delayed begins its ramp when it detects the delay: the time before does not count, and during the
ramp no step of force exceeds the rate limit, however many samples are missed.
"""


def cell(state: State, event: Event) -> str:
    """What an event does in a state."""
    outcome = TRANSITIONS[state][event]
    if isinstance(outcome, str):
        return "*refused*"
    return "-" if outcome is state else f"**{outcome.words}**"


def page() -> str:
    """The whole page."""
    lines = [f"| event | {' | '.join(state.words for state in State)} |", "|---" * (len(State) + 1) + "|"]
    lines += [f"| {event.value} | {' | '.join(cell(state, event) for state in State)} |" for event in Event]
    return INTRODUCTION + "\n".join(lines) + "\n" + END


if __name__ == "__main__":
    write_text(PAGE, page())

"""Write docs/states.md from the table that the rig's safety runs from: `python docs/write_states.py`."""

from __future__ import annotations

from pathlib import Path

from abrace_core.files import write_text
from abrace_core.safety.rig_safety import RAMP_TIME, TRANSITIONS, Event, State

PAGE = Path(__file__).parent / "states.md"

INTRODUCTION = f"""# What may act: the states of a rig

Written by `python docs/write_states.py` from the table that decides, `abrace_core.safety.rig_safety.TRANSITIONS`; a
test walks every state with every event.

One state holds for braces and table together. The rig decides it, simulated or behind the bridge, and every `response`
says it (`state`), with the first cause (`cause`) and what was limited (`flags`). Whoever commands has the same machine
for what it sends, and while the rig lets nothing act it asks for nothing.

| state | what acts |
|---|---|
| unconfigured | nothing; there is no rig yet |
| standby | nothing: configured, but not active |
| fading in | commands, with a share that grows from zero to one in {RAMP_TIME:g} s: a person has just cleared a fault |
| running | commands, within capacity, rate and what the table can do |
| ramping down | the way to rest: forces along a half cosine in {RAMP_TIME:g} s, the table by a stop within its stroke |
| latched | nothing: a fault was, and a person has to clear it |
| protective stop | nothing: a stop is pressed, or its heartbeat is missing |

A stop that comes over a network is a *protective stop* of stop category 1 in the words of IEC 60204-1: the motion is
brought to rest under control, and power stays on. It is never the *emergency stop* of category 0, which takes the
power away and which hardware alone can give: a laboratory has that button besides, wired to the hydraulics.

## Every event in every state

"-" changes nothing; *refused* is said with the reason to whoever asked.

"""

END = """
A fault and a stop outlive the life cycle: a rig that is latched can be deactivated, cleaned up and configured again,
and is latched still; `activate` is refused until a person calls `clear_fault`. That is refused while anything is on the
way to rest, while an input still asks for a force or a motion, or while its sender reports a fault of its own.

## How it is tried

`make verify` walks every state with every event on a real `RigSafety`, and tries on running nodes, 20 times each,
what may go wrong (`python benchmarks/safety.py`, results in `safety` of `results/verify.json`): stop buttons of each
QoS on both names, two of them, and one whose sender is gone; `clear_fault` while somebody commands and during the
ramp; a rig that is deactivated, interrupted or held up for 3 s, and a commander that is interrupted; commands that
are not finite, of wrong length or of two senders; old and repeated samples; a law with the wrong sign; a stop in El
Centro; motions beyond the table; a sensor at its end; services of a controller in use. A controller is killed,
stopped (SIGSTOP) and made to flood the rig, 100 times each: the force has to be zero within `command_timeout`, ramp
and 5 samples, and no step in it beyond the rate limit. In one run on two virtual processors, shared with other
machines: 98 of 98 pairs, 20 of 20 in 20 cases and 19 of 20 in one (an answer acted a sample late), killed 100 of 100,
stopped 97 (three times the machine stood still for 12 to 32 ms before the case began), flooding 99 (zero after 265
samples, one too many); no step beyond the rate limit.

`make soak` sends 10 000 messages of right type and wrong content to every topic and service of every node that
streams (`python benchmarks/wrong_endurance.py`), and runs 20 minutes of lockstep (`python
benchmarks/lockstep_endurance.py`): no node may grow by 1 MB after the first minute, and two runs have to be the same
bytes.

A rig that was held up begins its ramp when it notices: the time before does not count, and while it lasts no step of
force is beyond the rate limit, however many samples are missed.
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

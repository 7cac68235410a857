# SPDX-License-Identifier: Apache-2.0
"""The node `ground_motion`: plays a record, white noise or a multisine, one value for each sample of the rig.

abrace run abrace_plant ground_motion --ros-args -p record:=quake.csv -p peak_acceleration:=0.98
abrace play ground_motion
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from geometry_msgs.msg import AccelStamped
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from std_srvs.srv import Trigger

from abrace_core import AbraceError
from abrace_core.model.noise import LONGEST_SIGNAL
from abrace_core.safety.table_stop import LONGEST
from abrace_core.safety.wire import Head, pack_acceleration
from abrace_interfaces.action import PlayGroundMotion
from abrace_node.commander import CANCELLED, OVER, PLAYING, READY, Commander
from abrace_node.parameters import Parameter
from abrace_node.process import run
from abrace_node.transport import published_stream_qos
from abrace_plant.live.playback import Playback
from abrace_plant.nodes.record_parameters import MOTION_PARAMETERS, motion_as_given, rig_as_given
from abrace_plant.records.table_motion import RECORD_REMEDIES, check_motion
from abrace_plant.rig.table_file import NOT_DRIVEN

FEEDBACK_EVERY = 50
"""Samples between feedback messages: ten a second at 500 Hz."""

PARAMETERS = [
    Parameter(
        "record", "", "what ~/play plays: a known name, white_noise, multisine, or a file; empty: only the action plays"
    ),
    *MOTION_PARAMETERS,
]


class PlayServer(ActionServer):
    """An action server whose goals end by an explicit `notify_execute`.

    `goal.execute()` only marks a goal as executing. In rclpy a goal's callback waits for the end of the motion, and the
    events executor of rclpy 7.1 spends a whole processor on a callback that waits.
    """

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Callable | None) -> None:
        """Have `execute_callback` return the goal's result; without a result the goal continues."""
        if execute_callback is not None:
            super().notify_execute(goal_handle, self._node.catching(execute_callback))


class GroundMotion(Commander):
    """Answers each sample with the ground acceleration of the next."""

    ramp_time = LONGEST
    signal = READY

    def __init__(self) -> None:
        super().__init__("ground_motion", PARAMETERS)
        self.create_service(Trigger, "~/play", self.on_play)
        self.keep_endpoints()
        self.playback: Playback | None = None
        self.goal: ServerGoalHandle | None = None
        # kept through every clean-up: rclpy 7.1 can crash where a server with requests and goals is destroyed
        self.server = PlayServer(
            self,
            PlayGroundMotion,
            "play_ground_motion",
            execute_callback=self.on_end,
            goal_callback=self.on_goal,
            handle_accepted_callback=self.on_accepted,
            cancel_callback=self.on_cancel,
        )

    def configure(self) -> None:
        """Load the record of the parameters, for a table in the middle of its stroke, and create the topics."""
        given = self.parameters
        rig = rig_as_given(given)
        if not rig.table.driven:
            raise AbraceError(f"rig {rig.name}: {NOT_DRIVEN}")
        self.table, self.sample_rate = rig.table.table(), rig.sample_rate
        asked = (given.record, given.peak_acceleration, given.duration)
        self.own_motion = self.motion(*asked, 0.0) if given.record else None
        self.awaits_goal = self.own_motion is not None
        self.gate.configure([], 1 / self.sample_rate, moving=self.moving)
        self.publisher = self.publish_on(AccelStamped, "ground_motion", published_stream_qos())
        self.listen()

    def motion(self, record: str, peak_acceleration: float, duration: float, displacement: float) -> np.ndarray:
        """The ground motion (samples,) [m/s^2] at the rig's sample rate, if the table can play it from there."""
        asked = (record, peak_acceleration, duration, displacement)
        return motion_as_given(self.parameters, self.table, self.sample_rate, *asked)

    @property
    def displacement(self) -> float:
        """Where the table is, as the rig says [m]; NaN: unknown."""
        return self.responses.table_displacement

    def moving(self) -> bool:
        """Whether the table moves."""
        return self.playback is not None and self.playback.played > 0 and not self.playback.done

    def play(self) -> None:
        """Begin the record of the parameters, if the table has room for it from where it is."""
        if self.own_motion is None:
            raise AbraceError("parameter record: empty, expected what to play")
        if abs(self.displacement) > 0:  # where it is unknown, `begin_goal` refuses
            move = "the table in the middle: move it there, then cleanup and configure rig and ground_motion"
            remedies, name = {**RECORD_REMEDIES, "displacement": move}, self.parameters.record
            check_motion(self.own_motion, self.sample_rate, self.table, name, remedies, self.displacement)
        self.begin_goal()
        self.begin(self.own_motion)

    def begin_goal(self) -> None:
        """Accept a goal, once the table is at rest in a known place."""
        self._end_motion_before(self.gate.watch.run)
        if self.signal != PLAYING and self.moving():
            raise AbraceError("the table moves")
        super().begin_goal()
        if math.isnan(self.displacement):
            self.end_goal("the rig does not know where the table is")
            raise AbraceError(self.cancelled)
        self.playback = None

    def begin(self, motion: np.ndarray) -> None:
        """Begin a motion with the next sample, from where the table is."""
        self.playback = Playback(motion, self.sample_rate, self.table, self.displacement)

    def end_goal(self, cause: str) -> None:
        """Bring the table to rest, if a motion plays."""
        super().end_goal(cause)
        if self.playback is not None:
            self.playback.cancel()
            if self.playback.done:
                self.send_result(self.playback)

    def let_go(self) -> None:
        """Take the table as at rest."""
        super().let_go()
        if self.playback is not None:
            self.end_motion(self.playback)

    def _end_motion_before(self, run: int) -> None:
        """End the motion of a run before this one, if there is one."""
        if self.playback is not None and run != self.gate.goal_run:
            self.end_motion(self.playback)

    def end_motion(self, playback: Playback) -> None:
        """End the motion of a run that has ended: the rig has brought the table to rest."""
        playback.finish()
        self.send_result(playback)

    @property
    def at_rest(self) -> bool:
        """Whether the table is at rest, as far as known."""
        return self.playback is None or self.playback.done

    def cleanup(self) -> None:
        """Forget the motion."""
        super().cleanup()
        if self.playback is not None:
            self.send_result(self.playback)
        self.playback = None

    def destroy_node(self) -> None:
        """Destroy the node, with its action server."""
        self.server.destroy()
        super().destroy_node()

    def answer(self, stamp: int, head: Head, z: tuple[float, ...], lost: int) -> None:
        """Answer a sample."""
        self.safety.act([])
        self._end_motion_before(head.run)
        playback, goal = self.playback, self.goal
        acceleration = playback.answer(head.sequence) if playback is not None else 0.0
        self.publish_answer(pack_acceleration(stamp, acceleration))
        if playback is not None and playback.done and self.signal == PLAYING:
            self.signal = OVER
        if playback is not None and goal is not None:
            if playback.done:
                self.send_result(playback)
            elif head.sequence % FEEDBACK_EVERY == 0:
                feedback = PlayGroundMotion.Feedback(elapsed=playback.elapsed, duration=playback.duration)
                self.defer(lambda: goal.publish_feedback(feedback))

    def send_result(self, playback: Playback) -> None:
        """Send the result of the goal that played, if there is one."""
        goal, self.goal = self.goal, None
        if goal is not None:
            self.server.notify_execute(goal, lambda goal: self.on_end(goal, playback))

    def on_goal(self, request: PlayGroundMotion.Goal) -> GoalResponse:
        """Accept a goal unless a motion plays, or nothing may act."""
        with self.lock:
            try:
                self.begin_goal()
            except AbraceError as error:
                self.get_logger().error(f"play_ground_motion refused: {error}")
                return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def on_accepted(self, goal: ServerGoalHandle) -> None:
        """Load the motion of a goal and play it from the next sample on."""
        request, motion, problem = goal.request, None, ""
        try:
            if not 0 <= request.peak_acceleration < np.inf:
                raise AbraceError(f"goal: peak_acceleration {request.peak_acceleration:g} m/s^2, expected 0 or more")
            if not 0 <= request.duration <= LONGEST_SIGNAL:
                raise AbraceError(f"goal: duration {request.duration:g} s, expected 0 to {LONGEST_SIGNAL:g} s")
            if not request.record:
                raise AbraceError("goal: record is empty, expected a known name or a file")
            motion = self.motion(request.record, request.peak_acceleration, request.duration, self.displacement)
        except AbraceError as error:
            problem = str(error)
        goal.execute()
        with self.lock:
            if motion is None:
                self.end_goal(problem)
            elif self.signal == PLAYING:
                self.begin(motion)
                self.goal = goal
            self.answer_held_back()
            refusal = self.cancelled
        if refusal:
            self.get_logger().error(f"play_ground_motion refused: {refusal}")
            self.server.notify_execute(goal, lambda goal: self.refuse(goal, refusal))

    def refuse(self, goal: ServerGoalHandle, message: str) -> PlayGroundMotion.Result:
        """The result of a goal that cannot be played."""
        goal.abort()
        return PlayGroundMotion.Result(success=False, message=message)

    def on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        """Bring the table to rest."""
        with self.lock:
            self.end_goal("by the sender of the goal")
        return CancelResponse.ACCEPT

    def on_end(self, goal: ServerGoalHandle, playback: Playback) -> PlayGroundMotion.Result:
        """The result of a goal that has ended, or was cancelled and has come to rest."""
        result = PlayGroundMotion.Result(success=not playback.cancelled, samples=playback.played)
        if goal.is_cancel_requested:
            goal.canceled()
            result.message = f"cancelled after {playback.elapsed:g} s"
        elif playback.cancelled:
            goal.abort()
            result.message = f"stopped: {self.cancelled}"
        else:
            goal.succeed()
            result.message = f"played {Path(goal.request.record).name}, {playback.duration:g} s"
        return result

    @property
    def status(self) -> str:
        """What the node does, for its diagnostics."""
        if not self.active or self.gate.held or self.signal == CANCELLED:
            return super().status
        return "playing" if self.signal == PLAYING else "ready"

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`, with how far the motion is."""
        fault, message, values = super().diagnose()
        if self.playback is not None and self.signal != READY:
            values |= {"elapsed": self.playback.elapsed, "duration": self.playback.duration}
        return fault, message, values


def main() -> int:
    """Entry point."""
    return run(GroundMotion)

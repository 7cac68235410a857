# SPDX-License-Identifier: Apache-2.0
"""The node `ground_motion`: plays a record, white noise or a multisine, one value for each sample of the rig.

abrace run abrace_plant ground_motion --ros-args -p record:=quake.csv -p peak_acceleration:=0.98
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from geometry_msgs.msg import AccelStamped
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from abrace_core.errors import AbraceError
from abrace_core.node import Parameter, published_stream_qos, run
from abrace_core.node.commander import Commander
from abrace_core.safety.answering import RESTART
from abrace_core.safety.table_stop import LONGEST
from abrace_core.wire import Head, pack_acceleration
from abrace_interfaces.action import PlayGroundMotion
from abrace_plant.live.playback import Playback
from abrace_plant.nodes.record_parameters import MOTION_PARAMETERS, motion_as_given, table_as_given
from abrace_plant.records.table_motion import RECORD_REMEDIES, check_motion

FEEDBACK_EVERY = 50
"""Samples between feedback messages: ten a second at 500 Hz."""

PARAMETERS = [
    Parameter(
        "record", "", "played at once: a known name, white_noise, multisine, or a file; empty: wait for the action"
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
            super().notify_execute(goal_handle, execute_callback)


class GroundMotion(Commander):
    """Answers each sample with the ground acceleration of the next."""

    ramp_time = LONGEST

    def __init__(self) -> None:
        super().__init__("ground_motion", PARAMETERS)
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
        """Load the record that is played at once, create the topics."""
        given = self.parameters
        self.rests_at, self.run_of_table = 0.0, -1
        self.table = table_as_given(given)
        self.first_motion = self.motion(given.record, given.peak_acceleration, given.duration) if given.record else None
        self.cancelled = ""
        self.answering.configure([], 1 / given.sample_rate, moving=self.moving)
        self.publisher = self.publish_on(AccelStamped, "ground_motion", published_stream_qos())
        self.listen()

    def motion(self, record: str, peak_acceleration: float, duration: float) -> np.ndarray:
        """The ground motion (samples,) [m/s^2] at the rig's sample rate, if the table can play it."""
        return motion_as_given(self.parameters, self.table, record, peak_acceleration, duration, self.displacement)

    @property
    def displacement(self) -> float:
        """Where the table is, as commanded since the run began [m]."""
        return self.playback.displacement if self.playback is not None else self.rests_at

    def moving(self) -> bool:
        """Whether the table moves."""
        return self.playback is not None and self.playback.played > 0 and not self.playback.done

    def play(self, motion: np.ndarray) -> Playback:
        """The playback of a motion from where the table is."""
        return Playback(motion, self.parameters.sample_rate, self.table, self.displacement)

    def activate(self) -> None:
        """Answer from the next sample on, and play the record of the parameters once in each run of the rig."""
        self.check_from_here()
        super().activate()
        self.cancelled = ""
        self.played_in_run = -1
        self.let_go = False

    def check_from_here(self) -> None:
        """Refuse the record of the parameters if the table would not have room for it from where it is."""
        if self.first_motion is not None and self.displacement:
            given = self.parameters
            remedies = {**RECORD_REMEDIES, "displacement": "the table in the middle: move it there, cleanup, configure"}
            check_motion(self.first_motion, given.sample_rate, self.table, given.record, remedies, self.displacement)

    def come_to_rest(self) -> None:
        """Cancel the motion, if one plays; the answers go on until the table is at rest."""
        super().come_to_rest()
        self.let_go = self.answering.silent(time.monotonic())
        self.cancel()

    @property
    def at_rest(self) -> bool:
        """Whether the table is at rest, as far as known."""
        return self.playback is None or self.playback.done or self.let_go

    def cleanup(self) -> None:
        """End the goal of a table that was let go."""
        super().cleanup()
        if self.playback is not None:
            self.end_goal(self.playback)
        self.playback = None

    def destroy_node(self) -> None:
        """Destroy the node, with its action server."""
        self.server.destroy()
        super().destroy_node()

    def cancel(self) -> None:
        """Bring the table to rest, if a motion plays."""
        if self.playback is not None:
            self.playback.cancel()
            if self.playback.done:
                self.end_goal(self.playback)

    def interrupt(self, cause: str) -> None:
        """A fault or stop ends the motion, also one that waits: neither begins by itself when that is cleared."""
        waits = self.first_motion is not None and self.played_in_run < 0
        plays = self.playback is not None and not self.playback.done and not self.playback.cancelled
        if (waits or plays) and not self.cancelled:
            self.cancelled = cause
            self.cancel()

    def answer(self, stamp: int, head: Head, z: tuple[float, ...], lost: int) -> None:
        """Answer a sample."""
        self.safety.act([])
        if cause := self.safety.cause or self.answering.cause:
            self.interrupt(cause)
        if lost == RESTART and self.safety.acting:
            self.restart(head.run)
        playback, goal = self.playback, self.goal
        acceleration = playback.answer(head.sequence) if playback is not None else 0.0
        self.publisher.publish(pack_acceleration(stamp, acceleration))
        if playback is not None and goal is not None:
            if playback.done:
                self.end_goal(playback)
            elif head.sequence % FEEDBACK_EVERY == 0:
                feedback = PlayGroundMotion.Feedback(elapsed=playback.elapsed, duration=playback.duration)
                self.later(lambda: goal.publish_feedback(feedback))

    def end_goal(self, playback: Playback) -> None:
        """Send the result of the goal that played, if there is one."""
        goal, self.goal = self.goal, None
        if goal is not None:
            self.server.notify_execute(goal, lambda goal: self.on_end(goal, playback))

    def restart(self, run: int) -> None:
        """A run of the rig begins: end the motion of the one before, and begin the record of the parameters."""
        if run == self.played_in_run:
            return
        self.played_in_run = run
        if self.goal is not None and self.playback is not None:
            if not self.playback.played:
                return
            self.playback.cancelled = True
            self.end_goal(self.playback)
        # the table of another run is taken to be in the middle
        self.rests_at = self.displacement if run == self.run_of_table else 0.0
        self.playback, self.run_of_table = None, run
        if self.first_motion is None or self.cancelled:
            return
        try:
            self.check_from_here()
        except AbraceError as error:
            self.cancelled = str(error)
            self.get_logger().error(self.cancelled)
            return
        self.playback = self.play(self.first_motion)

    def busy(self) -> str:
        """Why no goal can be played now; empty: one can."""
        if problem := self.fault or self.answering.held:
            return problem
        waiting = self.first_motion is not None and self.played_in_run < 0 and not self.cancelled
        plays = self.playback is not None and not self.playback.done
        return "a motion is playing" if waiting or plays else ""

    def on_goal(self, request: PlayGroundMotion.Goal) -> GoalResponse:
        """Accept a goal unless a motion plays or is about to, or nothing may act."""
        reason = self.busy() if self.active else "not active"
        if reason:
            self.get_logger().error(f"play_ground_motion refused: {reason}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def on_accepted(self, goal: ServerGoalHandle) -> None:
        """Load the motion of a goal and play it from the next sample on."""
        request = goal.request
        try:
            if not np.isfinite([request.peak_acceleration, request.duration]).all():
                raise AbraceError("goal: peak_acceleration and duration have to be finite")
            if request.peak_acceleration < 0 or request.duration < 0:
                raise AbraceError("goal: peak_acceleration and duration have to be 0 or more")
            if not request.record:
                raise AbraceError("goal: record is empty, expected a known name or a file")
            motion = self.motion(request.record, request.peak_acceleration, request.duration)
        except AbraceError as error:
            message = str(error)
            self.get_logger().error(f"play_ground_motion refused: {message}")
            self.server.notify_execute(goal, lambda goal: self.refuse(goal, message))
            return
        goal.execute()
        with self.lock:
            self.playback = self.play(motion)
            self.goal = goal
            self.cancelled = ""

    def refuse(self, goal: ServerGoalHandle, message: str) -> PlayGroundMotion.Result:
        """The result of a goal that cannot be played."""
        goal.execute()
        goal.abort()
        return PlayGroundMotion.Result(success=False, message=message)

    def on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        """Bring the table to rest."""
        with self.lock:
            self.cancel()
        return CancelResponse.ACCEPT

    def on_end(self, goal: ServerGoalHandle, playback: Playback) -> PlayGroundMotion.Result:
        """The result of a goal that has ended, or was cancelled and has come to rest."""
        result = PlayGroundMotion.Result(success=not playback.cancelled, samples=playback.played)
        if goal.is_cancel_requested:
            goal.canceled()
            result.message = f"cancelled after {playback.elapsed:g} s"
        elif playback.cancelled:
            goal.abort()
            result.message = "stopped: deactivation, or a fault or stop of the rig; see its diagnostics"
        else:
            goal.succeed()
            result.message = f"played {Path(goal.request.record).name}, {playback.duration:g} s"
        return result

    @property
    def status(self) -> str:
        """What the node does, for its diagnostics."""
        playback = self.playback
        if self.cancelled:
            return f"cancelled: {self.cancelled}; deactivate and activate it to play again"
        if not self.active or self.answering.held:
            return super().status
        if playback is None or playback.done:
            return "ready"
        return "coming to rest" if playback.cancelled else "playing"

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`, with how far the motion is."""
        fault, message, values = super().diagnose()
        playback = self.playback
        if playback is not None:
            signal = "playing" if not playback.done else "cancelled" if playback.cancelled else "over"
            values |= {"elapsed": playback.elapsed, "duration": playback.duration, "signal": signal}
        elif self.configured and self.cancelled:
            values |= {"elapsed": 0.0, "signal": "cancelled"}
        return fault, message, values


def main() -> int:
    """Entry point."""
    return run(GroundMotion)

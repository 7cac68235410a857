"""The node `ground_motion`: plays a record, white noise or a multisine, one value for each sample of the rig."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from geometry_msgs.msg import AccelStamped
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from std_msgs.msg import Bool

from abrace_core.errors import AbraceError
from abrace_core.node import KEPT_STREAM_QOS, TRANSIENT_LOCAL_QOS, AbraceLifecycleNode, Parameter, run
from abrace_core.safety.sample_watch import SampleWatch
from abrace_core.wire import Responses, pack_acceleration
from abrace_interfaces.action import PlayGroundMotion
from abrace_interfaces.msg import Response
from abrace_plant.live.playback import Playback
from abrace_plant.nodes.record_parameters import MOTION_PARAMETERS, motion_as_given, table_as_given

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
        """Have `execute_callback` return the goal's result; without one the goal goes on."""
        if execute_callback is not None:
            super().notify_execute(goal_handle, execute_callback)


class GroundMotion(AbraceLifecycleNode):
    """Answers each sample with the ground acceleration of the next."""

    remedy = "the table comes to rest; release the button to play again"

    def __init__(self) -> None:
        super().__init__("ground_motion", PARAMETERS)
        self.playback: Playback | None = None
        self.goal: ServerGoalHandle | None = None
        self.stopped = False

    def configure(self) -> None:
        """Load the record that is played at once, create the topics and the action."""
        given = self.parameters
        self.watch = SampleWatch(1 / given.sample_rate)
        self.table = table_as_given(given)
        self.first_motion = self.motion(given.record, given.peak_acceleration, given.duration) if given.record else None
        self.responses = Responses()
        self.publisher = self.publish_on(AccelStamped, "ground_motion", KEPT_STREAM_QOS)
        self.subscribe_to(Response, "response", self.on_response, KEPT_STREAM_QOS, raw=True)
        self.create_subscription(Bool, "emergency_stop", self.on_emergency_stop, TRANSIENT_LOCAL_QOS)
        self.server = PlayServer(
            self,
            PlayGroundMotion,
            "play_ground_motion",
            execute_callback=self.on_end,
            goal_callback=self.on_goal,
            handle_accepted_callback=self.on_accepted,
            cancel_callback=self.on_cancel,
        )

    def motion(self, record: str, peak_acceleration: float, duration: float) -> np.ndarray:
        """The ground motion (samples,) [m/s^2] at the rig's sample rate, if the table can play it."""
        at = self.playback.displacement if self.playback is not None else 0.0
        return motion_as_given(self.parameters, self.table, record, peak_acceleration, duration, at)

    def play(self, motion: np.ndarray) -> Playback:
        """The playback of a motion from where the table is."""
        at = self.playback.displacement if self.playback is not None else 0.0
        return Playback(motion, self.parameters.sample_rate, self.table, at)

    def activate(self) -> None:
        """Answer from the next sample on, with the record of the parameters unless the table still moves."""
        if self.playback is None or self.playback.done:
            self.watch.sequence = -1

    def deactivate(self) -> None:
        """Cancel the motion; the answers go on until the table is at rest."""
        self.come_to_rest()

    def cleanup(self) -> None:
        """Destroy the action server."""
        self.server.destroy()
        self.playback, self.goal = None, None

    def come_to_rest(self) -> None:
        """Cancel the motion, if one plays."""
        if self.playback is not None:
            self.playback.cancel()
            if self.playback.done:
                self.end_goal(self.playback)

    def on_response(self, payload: bytes) -> None:
        """Answer a sample."""
        if not self.active and (self.playback is None or self.playback.done):
            return
        try:
            stamp, sequence, _ = self.responses.unpack(payload)
        except AbraceError as error:
            self.get_logger().error(str(error), throttle_duration_sec=1.0)
            self.come_to_rest()
            return
        if self.watch.update(sequence, stamp) < 0:
            self.restart(sequence)
        playback = self.playback
        if self.watch.problem and playback is not None and playback.played and not playback.cancelled:
            self.get_logger().error(f"the table comes to rest: {self.watch.problem}")
            playback.cancel()
        acceleration = playback.answer(sequence) if playback is not None else 0.0
        self.publisher.publish(pack_acceleration(stamp, acceleration))
        if playback is not None and self.goal is not None:
            if playback.done:
                self.end_goal(playback)
            elif sequence % FEEDBACK_EVERY == 0:
                feedback = PlayGroundMotion.Feedback(elapsed=playback.elapsed, duration=playback.duration)
                self.goal.publish_feedback(feedback)

    def end_goal(self, playback: Playback) -> None:
        """Send the result of the goal that played, if there is one."""
        goal, self.goal = self.goal, None
        if goal is not None:
            self.server.notify_execute(goal, lambda goal: self.on_end(goal, playback))

    def restart(self, sequence: int) -> None:
        """The rig has restarted: end the motion and begin the record of the parameters, or a goal that waited."""
        if self.goal is not None and self.playback is not None:
            if not self.playback.played:
                return
            self.playback.cancelled = True
            self.end_goal(self.playback)
        self.playback = None
        if self.first_motion is not None and not self.stopped:
            self.playback = self.play(self.first_motion)

    def on_goal(self, request: PlayGroundMotion.Goal) -> GoalResponse:
        """Accept a goal unless a motion plays or is about to."""
        waiting = self.first_motion is not None and self.watch.sequence < 0
        busy = waiting or (self.playback is not None and not self.playback.done)
        if not self.active or busy or self.stopped:
            reason = "emergency stop" if self.stopped else "a motion plays" if busy else "not active"
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
        self.playback = self.play(motion)
        self.goal = goal
        goal.execute()

    def refuse(self, goal: ServerGoalHandle, message: str) -> PlayGroundMotion.Result:
        """The result of a goal that cannot be played."""
        goal.execute()
        goal.abort()
        return PlayGroundMotion.Result(success=False, message=message)

    def on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        """Ramp the table to rest."""
        self.come_to_rest()
        return CancelResponse.ACCEPT

    def on_end(self, goal: ServerGoalHandle, playback: Playback) -> PlayGroundMotion.Result:
        """The result of a goal that has ended, or was cancelled and has come to rest."""
        result = PlayGroundMotion.Result(success=not playback.cancelled, samples=playback.played)
        if goal.is_cancel_requested:
            goal.canceled()
            result.message = f"cancelled after {playback.elapsed:g} s"
        elif playback.cancelled:
            goal.abort()
            result.message = "stopped: emergency stop, deactivation, or the rig stopped or lost samples"
        else:
            goal.succeed()
            result.message = f"played {Path(goal.request.record).name}, {playback.duration:g} s"
        return result

    def on_emergency_stop(self, message: Bool) -> None:
        """The emergency stop is pressed or released."""
        self.stopped = message.data
        if self.stopped:
            self.come_to_rest()
        self.report_fault(self.fault)

    @property
    def fault(self) -> str | None:
        """The fault, if there is one: the emergency stop, while it is pressed."""
        return "emergency stop" if self.stopped else None

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        playback = self.playback
        values: dict[str, object] = {"lost": self.watch.missing} if self.active else {}
        if playback is not None:
            signal = "playing" if not playback.done else "cancelled" if playback.cancelled else "over"
            values |= {"elapsed": playback.elapsed, "duration": playback.duration, "signal": signal}
        if self.fault:
            return self.fault, "", values
        if playback is None or playback.done:
            return None, "ready" if self.active else "not active", values
        return None, "coming to rest" if playback.cancelled else "playing", values


def main() -> int:
    """Entry point."""
    return run(GroundMotion)

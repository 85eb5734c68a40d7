# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Navigator node: the actions of Nav2 for the goals of the controller, if nav2_msgs is installed.

actions     navigate_to_pose, navigate_through_poses
subscribes  pose, controller/status
publishes   goals
requests    controller/cancel
"""

import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Goals
from rclpy.action.server import ServerGoalHandle
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_srvs.srv import Trigger

from sphere_nmpc.control.navigation import (
    Ending,
    Navigation,
    NavigatorSettings,
    Outcome,
    Requests,
)
from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.ros.guarded_node import NEWEST
from sphere_nmpc.ros.lifetime import RunnableNode, run
from sphere_nmpc.ros.messages import message_object, stamp_text, stamp_to_ros
from sphere_nmpc.ros.navigator.action_server import GoalServer
from sphere_nmpc.ros.navigator.requests import (
    action_types,
    feedback_of,
    goals_of,
    report_of,
    result_of,
)
from sphere_nmpc.ros.settings import FrameSettings

_PERIOD = 0.1
"""Wall time between two messages of feedback [s]."""
_RANDOM = 1_000_000
"""Part of a stamp [ns] that is random, so that those of a navigator that is started again differ,
also where the clock stands still."""
_LAST = 0.5
"""Wall time at the end in which the result of a goal is sent and received [s]."""


@dataclass
class _Accepted:
    """Goal of an action that has not ended, with the message that is sent for it."""

    server: GoalServer
    handle: ServerGoalHandle
    goals: Goals
    stamp: int
    """Time of acceptance [ns; clock of the node]."""


class NavigatorNode(RunnableNode):
    """Node that passes goals of actions to the controller, and its statuses to a `Navigation`."""

    def __init__(self, parameter_overrides: list[Parameter] | None = None) -> None:
        types = action_types()
        super().__init__("navigator", parameter_overrides)
        settings = self.parameters.declare(NavigatorSettings()).settings
        self._frame = self.parameters.declare(FrameSettings()).settings.world_frame
        self.parameters.warn_of_unknown()
        self._navigation = Navigation(settings)
        self._goals: dict[bytes, _Accepted] = {}
        """Goals that have not ended, by their ids."""
        self._pose: bytes | None = None
        self._answer: Future | None = None
        self._last_stamp = 0
        self._ends = False
        self._sender = self.create_publisher(Goals, "goals", 1)
        self._cancel_client = self.create_client(Trigger, "controller/cancel")
        self.create_subscription(
            DiagnosticStatus, "controller/status", self._receive_status, 10
        )
        self.create_subscription(PoseStamped, "pose", self._receive_pose, NEWEST, raw=True)
        self._servers = [
            GoalServer(self, kind, name, self._check, self._begin, self._cancel)
            for name, kind in types.items()
        ]
        self.create_wall_timer(_PERIOD, self._tick)

    def finish(self) -> None:
        """Abort the goal, and have the controller stop the sphere on its path."""
        self._ends = True
        requests = self._navigation.abandon("the navigator has ended")
        self._carry_out(requests)
        end = time.monotonic() + (_LAST if requests.ended else 0.0)
        while self.executor is not None and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=_PERIOD)

    def destroy_node(self) -> None:
        """Destroy the action servers and the node."""
        for server in self._servers:
            server.destroy()
        super().destroy_node()

    def _check(self, request: Any) -> None:
        if self._ends:
            raise SphereNmpcError("the navigator ends")
        goals_of(request, self._frame)

    def _begin(self, server: GoalServer, handle: ServerGoalHandle) -> None:
        stamp = self._new_stamp()
        goals = goals_of(handle.request, self._frame)
        goals.header.stamp = stamp_to_ros(stamp)
        key = bytes(handle.goal_id.uuid)
        self._goals[key] = _Accepted(server, handle, goals, self.get_clock().now().nanoseconds)
        self._event_log.report("goal", f"{len(goals.goals)} poses, stamp {stamp_text(stamp)}")
        self._carry_out(self._navigation.begin(key, stamp_text(stamp), time.monotonic()))

    def _cancel(self, handle: ServerGoalHandle) -> bool:
        return self._navigation.cancel(bytes(handle.goal_id.uuid), time.monotonic())

    def _receive_pose(self, message: bytes) -> None:
        self._pose = message

    def _receive_status(self, message: DiagnosticStatus) -> None:
        report = report_of({pair.key: pair.value for pair in message.values})
        self._carry_out(self._navigation.receive(report, time.monotonic()))

    def _tick(self) -> None:
        self._carry_out(self._navigation.update(time.monotonic()))
        self._event_log.flush()
        self._fault_log.flush()
        goal = self._navigation.goal
        if goal is None:
            return
        accepted = self._goals[goal]
        pose = None if self._pose is None else message_object(self._pose, PoseStamped)
        feedback = feedback_of(
            accepted.server.action_type, self._navigation.report,
            (self.get_clock().now().nanoseconds - accepted.stamp) / NANOSECONDS,
            self._navigation.replans, len(accepted.goals.goals), pose,
        )
        accepted.handle.publish_feedback(feedback)

    def _carry_out(self, requests: Requests) -> None:
        for ending in requests.ended:
            self._end(ending)
        if requests.cancel and self._cancel_client.service_is_ready():
            self._request_cancel()
        goal = self._navigation.goal
        if requests.send and goal is not None and self._sender.get_subscription_count() > 0:
            self._sender.publish(self._goals[goal].goals)
            self._navigation.sent(time.monotonic())

    def _end(self, ending: Ending) -> None:
        accepted = self._goals.pop(ending.goal)
        result = result_of(accepted.server.action_type, ending)
        accepted.server.finish(accepted.handle, ending.outcome, result)
        is_fault = ending.outcome is Outcome.ABORTED
        log = self._fault_log if is_fault else self._event_log
        log.report(f"goal {ending.outcome.value}", ending.reason)

    def _request_cancel(self) -> None:
        if self._answer is not None:
            self._cancel_client.remove_pending_request(self._answer)
        self._navigation.cancel_requested(time.monotonic())
        self._answer = self._cancel_client.call_async(Trigger.Request())
        self._answer.add_done_callback(self._receive_answer)

    def _receive_answer(self, answer: Future) -> None:
        if answer is self._answer:
            self._answer = None
            self._navigation.cancel_answered(time.monotonic())

    def _new_stamp(self) -> int:
        """Return a stamp [ns] that no other goal has."""
        now = self.get_clock().now().nanoseconds
        while True:
            stamp = now - now % _RANDOM + secrets.randbelow(_RANDOM)
            if stamp > 0 and stamp != self._last_stamp:
                self._last_stamp = stamp
                return stamp


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see `sphere_nmpc.ros.lifetime.run`."""
    return run(NavigatorNode, args, __doc__ or "")

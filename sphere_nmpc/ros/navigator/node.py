# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Navigator node: the actions of Nav2 for the goals of the controller, if nav2_msgs is installed.

actions     navigate_to_pose, navigate_through_poses, follow_waypoints
services    bt_navigator/get_state, amcl/get_state
subscribes  pose, controller/status
publishes   goals, amcl_pose
requests    controller/cancel
"""

import secrets
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from action_msgs.msg import GoalStatusArray
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from nav_msgs.msg import Goals
from rclpy.action.server import ServerGoalHandle
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_srvs.srv import Trigger

from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.control.navigation import (
    Ending,
    Navigation,
    NavigatorSettings,
    Outcome,
    Requests,
)
from sphere_nmpc.errors import InvalidInputError, SphereNmpcError
from sphere_nmpc.quantity import NANOSECONDS, stamp_text
from sphere_nmpc.ros.graph_monitor import GraphMonitor, names_of, several_publishers
from sphere_nmpc.ros.guarded_node import LATCHED, NEWEST
from sphere_nmpc.ros.lifetime import RunnableNode, run
from sphere_nmpc.ros.messages import message_object, stamp_to_ros
from sphere_nmpc.ros.navigator.action_server import GoalServer
from sphere_nmpc.ros.navigator.requests import (
    action_types,
    feedback_of,
    result_of,
    stages_of,
)
from sphere_nmpc.ros.settings import FrameSettings

_PERIOD = 0.1
"""Wall time between two messages of feedback [s]."""
_LOOK_EVERY = 1.0
"""Wall time between two looks for another navigator [s]."""
_OFFERED = "navigate_to_pose/_action/status"
"""Topic that each navigator publishes, those of Nav2 as well."""
_RANDOM = 1_000_000
"""Part of a stamp [ns] that is random, so that those of a navigator that is started again differ,
also where the clock stands still."""
_LAST = 0.5
"""Wall time at the end in which the result of a goal is sent and received [s]."""


@dataclass
class _Accepted:
    """Goal of an action that has not ended, with the messages that are sent for it."""

    server: GoalServer
    handle: ServerGoalHandle
    stages: list[Goals]
    stamp: int
    """Time of acceptance [ns; clock of the node]."""
    goals: Goals
    """The one that is in force, or to be."""

    @property
    def first(self) -> int:
        """Index of the stage that it begins with."""
        return getattr(self.handle.request, "goal_index", 0)

    def stage(self, number: int) -> int:
        """Return the index of the one that is sent after `number` others."""
        return (self.first + number) % len(self.stages)


class NavigatorNode(RunnableNode):
    """Node that passes goals of actions to the controller, and its statuses to a `Navigation`."""

    def __init__(self, parameter_overrides: list[Parameter] | None = None) -> None:
        types = action_types()
        super().__init__("navigator", parameter_overrides)
        settings = self.parameters.declare(NavigatorSettings()).settings
        self._frame = self.parameters.declare(FrameSettings()).settings.world_frame
        self.parameters.warn_of_unknown()
        self._waypoint_pause = settings.waypoint_pause
        self._navigation = Navigation(settings)
        self._graph = GraphMonitor(self, self._fault_log)
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
        # What clients of Nav2 wait for before they send a goal.
        self._located = self.create_publisher(PoseWithCovarianceStamped, "amcl_pose", LATCHED)
        self._offer_state("amcl", lambda: self._pose is not None)
        self._offer_state(
            "bt_navigator", lambda: self._navigation.hears_controller(time.monotonic())
        )
        self.create_wall_timer(_PERIOD, self._tick)
        self.create_wall_timer(_LOOK_EVERY, self._look)

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
        # Each would take the goal, and see that of the other take over.
        if len(names := self._navigators()) > 1:
            raise InvalidInputError("navigators", names_of(names), "one")
        stages_of(request, self._frame)

    def _begin(self, server: GoalServer, handle: ServerGoalHandle) -> None:
        stages, key = stages_of(handle.request, self._frame), bytes(handle.goal_id.uuid)
        accepted = _Accepted(
            server, handle, stages, self.get_clock().now().nanoseconds, stages[0]
        )
        self._goals[key] = accepted
        self._event_log.report("goal", f"{sum(len(stage.goals) for stage in stages)} poses")
        is_route = hasattr(handle.request, "number_of_loops")
        self._carry_out(self._navigation.begin(
            key, self._stamps(accepted), time.monotonic(),
            self._waypoint_pause if is_route else 0.0,
        ))

    def _stamps(self, accepted: _Accepted) -> Iterator[str]:
        """Prepare the stages of a goal one after the other; return the stamp of each."""
        loops = 1 + getattr(accepted.handle.request, "number_of_loops", 0)
        for number in range(loops * len(accepted.stages) - accepted.first):
            stamp = self._new_stamp()
            accepted.goals = accepted.stages[accepted.stage(number)]
            accepted.goals.header.stamp = stamp_to_ros(stamp)
            yield stamp_text(stamp)

    def _cancel(self, handle: ServerGoalHandle) -> bool:
        return self._navigation.cancel(bytes(handle.goal_id.uuid), time.monotonic())

    def _receive_pose(self, message: bytes) -> None:
        self._pose = message

    def _receive_status(self, message: DiagnosticStatus) -> None:
        report = GoalReport.of({pair.key: pair.value for pair in message.values})
        self._carry_out(self._navigation.receive(report, time.monotonic()))

    def _tick(self) -> None:
        self._carry_out(self._navigation.update(time.monotonic()))
        self._event_log.flush()
        self._fault_log.flush()
        goal, report = self._navigation.goal, self._navigation.report
        is_awaited = self._located.get_subscription_count() > 0
        if self._pose is None or not (is_awaited or report):
            return
        pose = message_object(self._pose, PoseStamped)
        if is_awaited:
            located = PoseWithCovarianceStamped(header=pose.header)
            located.pose.pose = pose.pose
            self._located.publish(located)
        if goal is None or report is None:
            return
        accepted = self._goals[goal]
        accepted.handle.publish_feedback(feedback_of(
            accepted.server.action_type, report,
            (self.get_clock().now().nanoseconds - accepted.stamp) / NANOSECONDS,
            len(accepted.goals.goals), accepted.stage(self._navigation.stage), pose,
        ))

    def _navigators(self) -> list[str]:
        """Return the names of the navigators in this namespace, this one among them."""
        return self._graph.publishers(self.resolve_topic_name(_OFFERED), GoalStatusArray)

    def _look(self) -> None:
        effect = "goals are rejected meanwhile"
        self._graph.update(several_publishers(
            self.resolve_topic_name(_OFFERED), self._navigators(), effect
        ))

    def _offer_state(self, name: str, is_active: Callable[[], bool]) -> None:
        """Offer the state of a node of Nav2 whose part this one has."""

        def answer(_: GetState.Request, response: GetState.Response) -> GetState.Response:
            active, inactive = State.PRIMARY_STATE_ACTIVE, State.PRIMARY_STATE_INACTIVE
            response.current_state = (
                State(id=active, label="active") if is_active()
                else State(id=inactive, label="inactive")
            )
            return response

        self.create_service(GetState, f"{name}/get_state", answer)

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
        if ending.outcome is Outcome.ABORTED and len(names := self._navigators()) > 1:
            reason = f"{ending.reason}; there are several navigators: {names_of(names)}"
            ending = replace(ending, reason=reason)
        result = result_of(
            accepted.server.action_type, ending, accepted.stages, accepted.first
        )
        accepted.server.finish(accepted.handle, ending.outcome, result)
        if len(accepted.stages) > 1:
            for missed in ending.missed:
                number = accepted.stage(missed.stage) + 1
                self._fault_log.report("waypoint missed", f"{number}: {missed.reason}")
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

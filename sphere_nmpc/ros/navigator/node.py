# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Navigator node: the actions of Nav2 for the goals of the controller, if nav2_msgs is installed.

actions     navigate_to_pose, navigate_through_poses, follow_waypoints, follow_path
services    bt_navigator/get_state, amcl/get_state
subscribes  pose, controller/status, controller/floor
publishes   goals, path, amcl_pose
requests    controller/cancel
What else clients of Nav2 ask for is in `sphere_nmpc.ros.navigator.substitutes`.
"""

import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from action_msgs.msg import GoalStatusArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from nav_msgs.msg import Goals, Path
from rclpy.action.server import ServerGoalHandle
from rclpy.parameter import Parameter

from sphere_nmpc.control.goal_client import Ending, NavigatorSettings, Outcome
from sphere_nmpc.errors import Description, InvalidInputError, SphereNmpcError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import NANOSECONDS, counted
from sphere_nmpc.ros.goal_link import GoalLink
from sphere_nmpc.ros.graph_monitor import GraphMonitor, names_of, several_publishers
from sphere_nmpc.ros.guarded_node import LATCHED, NEWEST, GuardedNode
from sphere_nmpc.ros.lifetime import run
from sphere_nmpc.ros.messages import message_object
from sphere_nmpc.ros.navigator.action_server import GoalServer
from sphere_nmpc.ros.navigator.requests import (
    action_types,
    feedback_of,
    result_of,
    stages_of,
    ways_of,
)
from sphere_nmpc.ros.navigator.substitutes import Substitutes
from sphere_nmpc.ros.settings import FrameSettings

_PERIOD = 0.1
"""Wall time between two messages of feedback [s]."""
_LOOK_EVERY = 1.0
"""Wall time between two looks for another navigator, or other servers of Nav2 [s]."""
_OFFERED = "navigate_to_pose/_action/status"
"""Topic that each navigator publishes, those of Nav2 as well."""
_LAST = 0.5
"""Wall time at the end in which the result of a goal is sent and received [s]."""


@dataclass
class _Accepted:
    """Goal of an action that has not ended, with the messages that are sent for it."""

    server: GoalServer
    handle: ServerGoalHandle
    stages: list[Goals] | list[Path]
    stamp: int
    """Time of acceptance [ns; clock of the node]."""

    @property
    def first(self) -> int:
        """Index of the stage that it begins with."""
        return getattr(self.handle.request, "goal_index", 0)

    def stage(self, number: int) -> int:
        """Return the index of the one that is sent after `number` others."""
        return (self.first + number) % len(self.stages)

    @cached_property
    def ways(self) -> Vector | None:
        """Lengths up to the poses of its path [m], shape (P,); None without one."""
        first = self.stages[0]
        return ways_of(first) if isinstance(first, Path) else None

    def messages(self) -> Iterator[Goals | Path]:
        """Yield the stages in the order in which they are sent, in each of the loops."""
        loops = 1 + getattr(self.handle.request, "number_of_loops", 0)
        for number in range(loops * len(self.stages) - self.first):
            yield self.stages[self.stage(number)]


class NavigatorNode(GuardedNode):
    """Node that passes goals of actions to the controller, by a `GoalLink`."""

    def __init__(self, parameter_overrides: list[Parameter] | None = None) -> None:
        types = action_types()
        super().__init__("navigator", parameter_overrides)
        settings = self.parameters.declare(NavigatorSettings()).settings
        self._frame = self.parameters.declare(FrameSettings()).settings.world_frame
        self.parameters.warn_of_unknown()
        self._waypoint_pause = settings.waypoint_pause
        self._graph = GraphMonitor(self, self._fault_log)
        self._goals: dict[Hashable, _Accepted] = {}
        """Goals that have not ended, by their ids."""
        self._pose: bytes | None = None
        self._ends = False
        self._link = GoalLink(self, [Goals, Path], settings, self._end)
        self._client = self._link.client
        self.create_subscription(PoseStamped, "pose", self._receive_pose, NEWEST, raw=True)
        for name, kind in types.items():
            server = GoalServer(self, kind, name, self._check, self._begin, self._cancel)
            self.resources.callback(server.destroy)
        self._substitutes = Substitutes(self)
        self.resources.callback(self._substitutes.destroy)
        # What clients of Nav2 wait for before they send a goal.
        self._located = self.create_publisher(PoseWithCovarianceStamped, "amcl_pose", LATCHED)
        self._offer_state("amcl", lambda: self._pose is not None)
        self._offer_state("bt_navigator", lambda: self._client.hears_controller)
        self.create_wall_timer(_PERIOD, self._tick)
        self.create_wall_timer(_LOOK_EVERY, self._look)

    def finish(self) -> None:
        """Abort the goal, and have the controller stop the sphere on its path."""
        self._ends = True
        end = time.monotonic() + (0.0 if self._client.goal is None else _LAST)
        self._client.abandon("the navigator has ended")
        self._link.update()
        while self.executor is not None and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=_PERIOD)

    def _check(self, request: Any) -> None:
        if self._ends:
            raise SphereNmpcError("the navigator ends")
        # Each would take the goal, and see that of the other take over.
        if len(names := self._navigators()) > 1:
            raise InvalidInputError("navigators", Description(names_of(names)), "one")
        stages_of(request, self._frame)

    def _begin(self, server: GoalServer, handle: ServerGoalHandle) -> None:
        stages, key = stages_of(handle.request, self._frame), bytes(handle.goal_id.uuid)
        accepted = _Accepted(server, handle, stages, self.get_clock().now().nanoseconds)
        self._goals[key] = accepted
        self._event_log.report("goal", counted(
            sum(len(one.poses if isinstance(one, Path) else one.goals) for one in stages), "pose"
        ))
        is_route = hasattr(handle.request, "number_of_loops")
        self._link.begin(key, accepted.messages(), self._waypoint_pause if is_route else 0.0)

    def _cancel(self, handle: ServerGoalHandle) -> bool:
        return self._client.cancel(bytes(handle.goal_id.uuid))

    def _receive_pose(self, message: bytes) -> None:
        self._pose = message

    def _tick(self) -> None:
        self._link.update()
        self._event_log.flush()
        self._fault_log.flush()
        pursuit, report = self._client.pursuit, self._client.report
        is_awaited = self._located.get_subscription_count() > 0
        if self._pose is None or not (is_awaited or report):
            return
        pose = message_object(self._pose, PoseStamped)
        if is_awaited:
            located = PoseWithCovarianceStamped(header=pose.header)
            located.pose.pose = pose.pose
            self._located.publish(located)
        if pursuit is None or report is None:
            return
        accepted = self._goals[pursuit.goal]
        accepted.handle.publish_feedback(feedback_of(
            accepted.server.action_type, report,
            (self.get_clock().now().nanoseconds - accepted.stamp) / NANOSECONDS,
            accepted.stage(pursuit.stage), pose, pursuit.message, accepted.ways,
        ))

    def _navigators(self) -> list[str]:
        """Return the names of the navigators in this namespace, this one among them."""
        return self._graph.publishers(self.resolve_topic_name(_OFFERED), GoalStatusArray)

    def _look(self) -> None:
        effect, navigators = "goals are rejected meanwhile", self._navigators()
        self._graph.update(several_publishers(
            self.resolve_topic_name(_OFFERED), navigators, effect
        ))
        if len(navigators) == 1:  # two would give way to each other
            self._substitutes.update()

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


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see `sphere_nmpc.ros.lifetime.run`."""
    return run(NavigatorNode, args, __doc__ or "")

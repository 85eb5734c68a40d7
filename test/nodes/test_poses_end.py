# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A controller at its goal whose poses end, as those of an odometry that has lost the position."""

from collections.abc import Callable

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from ros_graph import Graph, values_of
from std_msgs.msg import Bool

from sphere_nmpc.model.state import upright_state
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.ros.cdr_messages import clock_message
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_to_ros

pytestmark = pytest.mark.slow

GOAL = upright_state(1.0, -0.5, 0.4)


class AtGoal:
    """A controller at its goal, and what it publishes; time goes on by 10 ms with each look."""

    def __init__(self, graph: Graph, lockstep: bool) -> None:
        self.graph, self.now = graph, 0
        self.node = graph.start(ControllerNode, use_sim_time=True, lockstep=lockstep)
        self._arrivals = graph.collect(Bool, "controller/at_goal", LATCHED)
        self.statuses = graph.collect(DiagnosticStatus, "controller/status")
        self._poses = graph.publisher(PoseStamped, "pose")
        graph.send_goal(GOAL)
        self.until(True, has_poses=True)

    def until(self, at_goal: bool, has_poses: bool) -> None:
        """Wait until it publishes whether it is at its goal."""
        self._arrivals.clear()
        self.pass_time(
            lambda: self._arrivals and self._arrivals[-1].data is at_goal, has_poses
        )

    def pass_time(self, until: Callable[[], object], has_poses: bool) -> None:
        def is_over() -> object:
            self.graph.spin_for(2e-3)  # so that time runs at five times its pace at the most
            self.now += NANOSECONDS // 100
            if has_poses:
                self._poses.publish(pose_to_ros(GOAL, self.now, 0.3))
            self.node._control_clock.hear(clock_message(self.now))
            return until()

        self.graph.until(is_over)


@pytest.mark.parametrize("lockstep", [False, True])
def test_goal_is_left_when_poses_end_and_reached_again_when_they_return(graph, lockstep) -> None:
    one = AtGoal(graph, lockstep)
    one.until(False, has_poses=False)
    one.statuses.clear()
    one.pass_time(lambda: one.statuses, has_poses=False)
    assert values_of(one.statuses[-1])["mode"] == Kind.NO_FRESH_POSE.value
    assert one.statuses[-1].level == DiagnosticStatus.ERROR
    one.until(True, has_poses=True)


@pytest.mark.parametrize("lockstep", [False, True])
def test_goal_is_left_when_the_clock_goes_back(graph, lockstep) -> None:
    one = AtGoal(graph, lockstep)
    one.now = 0
    one.until(False, has_poses=False)
    one.until(True, has_poses=True)


def test_status_of_the_one_source_of_poses_is_told_also_beside_itself_when_it_was_killed(
    graph
) -> None:
    source = graph.start(ControllerNode)._monitor._pose_source
    status = graph.probe.create_publisher(DiagnosticStatus, "probe/status", LATCHED)
    status.publish(DiagnosticStatus(level=DiagnosticStatus.STALE, message="wai\nting"))
    for senders in (["/probe"], ["/probe", "/probe"]):
        graph.until(lambda senders=senders: (
            source.reported_by(senders) == "/probe reports wai\\nting"
        ))
    assert source.reported_by(["/probe", "/other"]) == source.reported_by(["/probe"]) == ""
    status.publish(DiagnosticStatus(level=DiagnosticStatus.WARN, message="slipped"))
    graph.until(lambda: source._subscription is not None)
    graph.spin_for(0.2)
    assert source.reported_by(["/probe"]) == "", "it may have poses"
    assert source.reported_by([]) == "" and source._subscription is None

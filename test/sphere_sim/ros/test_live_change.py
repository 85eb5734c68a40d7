# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A parameter that is changed over ROS on the way to the goal leaves the plan as it is."""

import pytest
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import started
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.model.state import state_error
from sphere_nmpc.ros.messages import (
    hold_from_trajectory,
    pose_from_ros,
    pose_to_ros,
    stamp_from_ros,
)
from sphere_nmpc.settings import STRATEGIES
from sphere_sim.scenario.scenarios import PAPER_CASES

CASE = PAPER_CASES[1]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SAMPLE = round(STRATEGIES["time_optimal"].sample_period * 1e9)
"""Spacing of the sampling instants [ns]."""
CHANGED_AT = 8 * SAMPLE
COMPARED_UNTIL = 20 * SAMPLE
"""Before the arrival, at which a run ends [ns]."""
SIMULATOR = (
    "-p", "lockstep:=true", "-p", f"lockstep_timeout:={PATIENCE}", "-p", "start_paused:=true",
    "-p", "real_time_factor:=0.0",
)
CONTROLLER = ("-p", "lockstep:=true", "-p", "use_sim_time:=true")


def run_to_goal(graph, **change: object) -> dict[int, list]:
    """Run case 1 in lockstep, changing parameters of the controller on the way.

    Return the velocities of each trajectory by stamp [ns]. The goal has been reached.
    """
    with started("simulator", *SIMULATOR), started("controller", *CONTROLLER):
        poses = graph.collect(PoseStamped, "pose")
        trajectories = graph.collect(JointTrajectory, "rotor_trajectory")
        arrivals = graph.collect(Bool, "controller/at_goal", LATCHED)
        goals = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
        sender = graph.publisher(PoseStamped, "goal_pose")
        graph.until(lambda: poses)
        sender.publish(pose_to_ros(CASE.goal, 0, 0.3))
        graph.until(lambda: goals)
        while stamp_from_ros(poses[-1].header.stamp) < CHANGED_AT:
            before = stamp_from_ros(poses[-1].header.stamp)
            assert graph.call(Trigger, "simulator/step", Trigger.Request()).success
            until = before + SAMPLE
            graph.until(lambda until=until: stamp_from_ros(poses[-1].header.stamp) == until)
        # The command of the instant at which the simulator is paused has to be there as well.
        graph.until(lambda: stamp_from_ros(trajectories[-1].header.stamp) == CHANGED_AT)
        assert hold_from_trajectory(trajectories[-1], 0).speeds.any(), "on the way"
        if change:
            request = SetParameters.Request(
                parameters=[Parameter(k, value=v).to_parameter_msg() for k, v in change.items()]
            )
            answer = graph.call(SetParameters, "controller/set_parameters", request)
            assert all(result.successful for result in answer.results)
        graph.call(SetBool, "simulator/pause", SetBool.Request(data=False))
        graph.until(lambda: arrivals and arrivals[-1].data)
        # At full speed poses and trajectories may be received later than the arrival.
        graph.until(lambda: state_error(pose_from_ros(poses[-1]), CASE.goal) < 1e-2)
        graph.until(lambda: stamp_from_ros(trajectories[-1].header.stamp) >= COMPARED_UNTIL)
    return {
        stamp_from_ros(message.header.stamp): [list(point.velocities) for point in message.points]
        for message in trajectories
    }


@pytest.mark.slow
def test_changed_parameter_leaves_plan_and_arrival_as_they_are(graph) -> None:
    undisturbed = run_to_goal(graph)
    changed = run_to_goal(graph, pose_timeout=0.7, goal_tolerance=9e-3)
    # Later ones may be the ramp to rest of a controller that ends.
    shared = {s for s in undisturbed.keys() & changed.keys() if s < COMPARED_UNTIL}
    assert max(shared) > CHANGED_AT + 5 * SAMPLE
    assert all(undisturbed[stamp] == changed[stamp] for stamp in shared), "no new search"

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator and controller as processes: runs in lockstep are those without ROS."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from patience import LOCKSTEP
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_graph import started
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.floor.route import in_sight
from sphere_nmpc.floor.settings import FloorSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import state_error
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros, stamp_from_ros
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

CASE = PAPER_CASES[1]
MAP = Path(__file__).parents[2] / "config" / "maps" / "two_rooms.yaml"
NOISY = {"process_noise": 1e-3, "seed": 5}
COMPARED_FOR = 2.5
"""Time over which runs are compared, before any arrival [s]."""


@contextmanager
def nodes(strategy: str, map_file: str = "''", **simulator: object) -> Iterator[None]:
    """Run simulator and controller, paused at the start; they must end cleanly."""
    follow = {"use_sim_time": True, "lockstep": simulator.get("lockstep", False)}
    with ExitStack() as processes:
        for name, given in (
            ("simulator", {"start_paused": True, **simulator}),
            ("controller", {**follow, "strategy": strategy}),
        ):
            options = [f"{key}:={str(value).lower()}" for key, value in given.items()]
            options.append(f"map_file:={map_file}")
            arguments = (part for item in options for part in ("-p", item))
            processes.enter_context(started(name, *arguments))
        yield


@pytest.mark.slow
@pytest.mark.parametrize(("strategy", "pace"), [("paper", 0.0), ("time_optimal", 3.0)])
def test_lockstep_gives_the_run_without_ros_at_any_pace(graph, strategy, pace) -> None:
    robot, assumed = RobotParameters(), ControllerSettings(strategy=strategy)
    alone = run_closed_loop(
        Simulator(SimulatorSettings(**NOISY), robot), Controller(assumed, robot), CASE.goal,
        COMPARED_FOR, assumed.control_period, output_period=assumed.control_period,
    )
    poses = graph.collect(PoseStamped, "pose")
    goals = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
    with nodes(strategy, **LOCKSTEP, **NOISY, real_time_factor=pace):
        sender = graph.publisher(PoseStamped, "goal_pose")
        graph.until(lambda: poses)
        sender.publish(pose_to_ros(CASE.goal, 0, 0.3))
        graph.until(lambda: goals)
        given = [Parameter("pose_timeout", value=0.7).to_parameter_msg()]  # which changes no plan
        request = SetParameters.Request(parameters=given)
        graph.call(SetParameters, "controller/set_parameters", request)
        graph.call(SetBool, "simulator/pause", SetBool.Request(data=False))
        graph.until(lambda: stamp_from_ros(poses[-1].header.stamp) > COMPARED_FOR * 1e9)
    seen = {stamp_from_ros(pose.header.stamp): pose_from_ros(pose) for pose in poses}
    for time, state in zip(alone.times, alone.states, strict=True):
        np.testing.assert_allclose(seen[round(time * 1e9)], state, atol=1e-6)


@pytest.mark.slow
def test_around_a_wall_with_searches_in_the_worker_process(graph) -> None:
    """The floor reaches the worker as files, and the ways to the goal are found there."""
    arrived = graph.collect(Bool, "controller/at_goal", LATCHED)
    poses = graph.collect(PoseStamped, "pose")
    with nodes("time_optimal", str(MAP)):
        sender = graph.publisher(PoseStamped, "goal_pose")
        graph.until(lambda: poses)
        start = pose_from_ros(poses[0])
        graph.call(SetBool, "simulator/pause", SetBool.Request(data=False))
        sender.publish(pose_to_ros(CASE.goal, 0, 0.3))
        graph.until(lambda: arrived and arrived[-1].data)
        there = pose_from_ros(poses[-1])
    way = np.array([pose_from_ros(pose)[:2] for pose in poses])
    floor = FloorSettings(map_file=str(MAP)).whole(0.3)
    # Of either sign of the quaternion.
    assert state_error(there, CASE.goal) < 0.05
    assert not in_sight(floor, start[:2], CASE.goal[None, :2], floor.needed)[0]
    assert floor.distances(way).min() > 0.3

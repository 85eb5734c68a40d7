# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator and controller as processes: runs in lockstep are those without ROS."""

from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from patience import LOCKSTEP
from ros_graph import started_pair
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.floor.route import in_sight
from sphere_nmpc.floor.settings import FloorSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import state_error
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_from_ros, stamp_from_ros
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

CASE = PAPER_CASES[1]
MAP = Path(__file__).parents[2] / "config" / "maps" / "two_rooms.yaml"
PAUSED = {"start_paused": True}
NOISY = {"process_noise": 1e-3, "seed": 5}
COMPARED_FOR = 2.5
"""Time over which runs are compared, before any arrival [s]."""


@pytest.mark.slow
@pytest.mark.parametrize(("strategy", "pace"), [("paper", 0.0), ("time_optimal", 3.0)])
def test_lockstep_gives_the_run_without_ros_at_any_pace(graph, strategy, pace) -> None:
    robot, assumed = RobotParameters(), ControllerSettings(strategy=strategy)
    alone = run_closed_loop(
        Simulator(SimulatorSettings(**NOISY), robot), Controller(assumed, robot), CASE.goal,
        COMPARED_FOR, output_period=assumed.control_period,
    )
    poses = graph.collect(PoseStamped, "pose")
    goals = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
    with started_pair(
        simulator={**PAUSED, **LOCKSTEP, **NOISY, "real_time_factor": pace},
        controller={"strategy": strategy},
    ):
        graph.until(lambda: poses)
        graph.send_goal(CASE.goal)
        graph.until(lambda: goals)
        graph.set_parameters("controller", pose_timeout=0.7)  # which changes no plan
        graph.call(SetBool, "simulator/pause", data=False)
        graph.until(lambda: stamp_from_ros(poses[-1].header.stamp) > COMPARED_FOR * 1e9)
    seen = {stamp_from_ros(pose.header.stamp): pose_from_ros(pose) for pose in poses}
    for time, state in zip(alone.times, alone.states, strict=True):
        np.testing.assert_allclose(seen[round(time * 1e9)], state, atol=1e-6)


@pytest.mark.slow
def test_around_a_wall_with_searches_in_the_worker_process(graph) -> None:
    """The floor reaches the worker as files, and the ways to the goal are found there."""
    arrived = graph.collect(Bool, "controller/at_goal", LATCHED)
    poses = graph.collect(PoseStamped, "pose")
    floor = {"map_file": MAP}
    with started_pair(simulator=PAUSED | floor, controller=floor):
        graph.until(lambda: poses)
        start = pose_from_ros(poses[0])
        graph.call(SetBool, "simulator/pause", data=False)
        graph.send_goal(CASE.goal)
        graph.until(lambda: arrived and arrived[-1].data)
        there = pose_from_ros(poses[-1])
    way = np.array([pose_from_ros(pose)[:2] for pose in poses])
    floor = FloorSettings(map_file=str(MAP)).whole(0.3)
    # Of either sign of the quaternion.
    assert state_error(there, CASE.goal) < 0.05
    assert not in_sight(floor, start[:2], CASE.goal[None, :2], floor.needed)[0]
    assert floor.distances(way).min() > 0.3

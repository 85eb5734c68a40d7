# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator and controller as processes: goals are reached, and lockstep runs are repeatable."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from patience import LOCKSTEP
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import started
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import state_error
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros, stamp_from_ros
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

CASE = PAPER_CASES[1]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@contextmanager
def processes(**parameters: dict[str, object]) -> Iterator[None]:
    """Run both nodes; they must end cleanly."""
    with ExitStack() as nodes:
        for name, given in parameters.items():
            options = [f"{key}:={str(value).lower()}" for key, value in given.items()]
            arguments = (part for item in options for part in ("-p", item))
            nodes.enter_context(started(name, *arguments))
        yield


def run(
    graph, until: float, strategy: str, **simulator: object
) -> tuple[dict[int, list], dict[int, list]]:
    """Run case 1 and return poses by stamp [ns], and velocities of each trajectory by stamp."""
    lockstep = simulator.get("lockstep", False)
    sample = round(STRATEGIES[strategy].sample_period * 1e9)
    settings = {"start_paused": True, **simulator}
    controller = {"use_sim_time": True, "lockstep": lockstep, "strategy": strategy}
    with processes(simulator=settings, controller=controller):
        poses = graph.collect(PoseStamped, "pose")
        trajectories = graph.collect(JointTrajectory, "rotor_trajectory")
        goals = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
        sender = graph.publisher(PoseStamped, "goal_pose")
        graph.until(lambda: poses)
        sender.publish(pose_to_ros(CASE.goal, 0, 0.3))
        graph.until(lambda: goals)
        graph.call(SetBool, "simulator/pause", SetBool.Request(data=False))
        graph.until(lambda: stamp_from_ros(poses[-1].header.stamp) >= until * 1e9)
        end = stamp_from_ros(poses[-1].header.stamp) // sample * sample
    seen = {stamp_from_ros(p.header.stamp): pose_from_ros(p).tolist() for p in poses}
    sent = {
        stamp_from_ros(message.header.stamp): [list(point.velocities) for point in message.points]
        for message in trajectories
    }
    return (
        {stamp: state for stamp, state in seen.items() if stamp <= end and stamp % sample == 0},
        {stamp: hold for stamp, hold in sent.items() if stamp < end},
    )


@pytest.mark.slow
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_lockstep_repeats_itself_at_any_pace_and_the_run_without_ros(graph, strategy) -> None:
    noisy = {"process_noise": 1e-3, "seed": 5}
    sample = round(STRATEGIES[strategy].sample_period * 1e9)
    settings = {**LOCKSTEP, "pose_rate": 20.0, **noisy}
    # As fast as possible, and at three times real time.
    first, again = (
        run(graph, 6.0, strategy, real_time_factor=pace, **settings) for pace in (0.0, 3.0)
    )
    shared = first[0].keys() & again[0].keys()
    assert set(range(sample, 6_000_000_001, sample)) <= shared
    assert all(first[0][stamp] == again[0][stamp] for stamp in shared), "bit for bit"
    shared = first[1].keys() & again[1].keys()
    assert len(shared) >= 6_000_000_000 // sample
    assert all(first[1][stamp] == again[1][stamp] for stamp in shared), "bit for bit"

    robot, assumed = RobotParameters(), ControllerSettings(strategy=strategy)
    alone = run_closed_loop(
        Simulator(SimulatorSettings(**noisy), robot), Controller(assumed, robot),
        CASE.goal, 6.0, assumed.control_period, output_period=assumed.control_period,
    )
    for time, state in zip(alone.times, alone.states, strict=True):
        np.testing.assert_allclose(first[0][round(time * 1e9)], state, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("strategy", "duration"), [("time_optimal", 20.0), ("paper", 25.0)])
def test_goal_is_reached_without_lockstep(graph, strategy, duration) -> None:
    # In real time: on a busy machine some commands are late, and the motion is another one; at a
    # faster pace too many would be.
    poses, _ = run(graph, duration, strategy, real_time_factor=1.0)
    last = [np.array(state) for stamp, state in poses.items() if stamp > (duration - 1.0) * 1e9]
    assert last
    assert max(state_error(state, CASE.goal) for state in last) < 1e-2

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator and controller as processes: they reach the goal, and lockstep repeats itself."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import started
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import state_error
from sphere_nmpc.ros.conversions import pose_from_ros, pose_to_ros, stamp_from_ros
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
            nodes.enter_context(started(name, *arguments, patience=10.0))
        yield


def run(
    graph, until: float, strategy: str, **simulator: object
) -> tuple[dict[int, list], dict[int, list]]:
    """Run case 1 and return poses by stamp [ns], and velocities of each trajectory by stamp."""
    lockstep = simulator.get("lockstep", False)
    sample = round(STRATEGIES[strategy].sample_period * 1e9)
    settings = {"start_paused": True, "sample_period": sample / 1e9, **simulator}
    controller = {"use_sim_time": True, "lockstep": lockstep, "strategy": strategy}
    with processes(simulator=settings, controller=controller):
        poses = graph.hear(PoseStamped, "pose")
        trajectories = graph.hear(JointTrajectory, "rotor_trajectory")
        goals = graph.hear(PoseStamped, "controller/active_goal", LATCHED)
        sender = graph.speaker(PoseStamped, "goal_pose")
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
def test_lockstep_repeats_itself_and_the_run_without_ros(graph, strategy) -> None:
    noisy = {"process_noise": 1e-3, "seed": 5}
    sample = round(STRATEGIES[strategy].sample_period * 1e9)
    settings = {"lockstep": True, "real_time_factor": 0.0, "pose_rate": 20.0, **noisy}
    first, again = (run(graph, 6.0, strategy, **settings) for _ in range(2))
    shared = first[0].keys() & again[0].keys()
    assert set(range(sample, 6_000_000_001, sample)) <= shared
    assert all(first[0][stamp] == again[0][stamp] for stamp in shared), "bit for bit"
    shared = first[1].keys() & again[1].keys()
    assert len(shared) >= 6_000_000_000 // sample
    assert all(first[1][stamp] == again[1][stamp] for stamp in shared), "bit for bit"

    robot, believed = RobotParameters(), ControllerSettings(strategy=strategy)
    alone = run_closed_loop(
        Simulator(SimulatorSettings(**noisy), robot), Controller(believed, robot),
        CASE.goal, 6.0, believed.control_period, output_period=believed.control_period,
    )
    for time, state in zip(alone.times, alone.states, strict=True):
        np.testing.assert_allclose(first[0][round(time * 1e9)], state, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    # A plan of `time_optimal` is looked for as long as the sample lasts: at five times real time
    # in a fifth of the time, so that it may arrive later.
    "strategy, duration, later", [("time_optimal", 16.0, 0.25), ("paper", 20.0, 0.0)]
)
def test_pace_of_time_does_not_matter(graph, strategy, duration, later) -> None:
    sample, settled, punctual = STRATEGIES[strategy].sample_period, [], []
    for pace in (1.0, 5.0):
        poses, sent = run(graph, duration, strategy, real_time_factor=pace)
        outside = [
            stamp for stamp, state in poses.items()
            if state_error(np.array(state), CASE.goal) > 1e-2
        ]
        settled.append(max(outside) / 1e9)
        gaps = np.diff([stamp / 1e9 for stamp in sorted(sent) if stamp < max(outside)])
        punctual.append(gaps.max() < 1.2 * sample)
    assert settled[0] < duration - sample, "in real time it arrives whatever else the machine does"
    # A machine without time for the controller makes commands late, and those are another motion.
    if all(punctual):
        assert settled[1] == pytest.approx(settled[0], abs=1.01 * sample, rel=later)

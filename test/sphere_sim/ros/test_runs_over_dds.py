# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator and controller as processes: goals are reached, and lockstep runs are repeatable."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from patience import LOCKSTEP
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import started
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros, stamp_from_ros
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

CASE = PAPER_CASES[1]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NOISY = {"process_noise": 1e-3, "seed": 5}
COMPARED_FOR = 2.5
"""Time over which runs are compared, before any arrival [s]."""


@contextmanager
def nodes(strategy: str, **simulator: object) -> Iterator[None]:
    """Run simulator and controller, paused at the start; they must end cleanly."""
    follow = {"use_sim_time": True, "lockstep": simulator.get("lockstep", False)}
    with ExitStack() as processes:
        for name, given in (
            ("simulator", {"start_paused": True, **simulator}),
            ("controller", {**follow, "strategy": strategy}),
        ):
            options = [f"{key}:={str(value).lower()}" for key, value in given.items()]
            arguments = (part for item in options for part in ("-p", item))
            processes.enter_context(started(name, *arguments))
        yield


class Run:
    """Poses and trajectories of running nodes, which are given a goal."""

    def __init__(self, graph, strategy: str) -> None:
        self.graph = graph
        self.sample = round(STRATEGIES[strategy].sample_period * 1e9)
        self.poses = graph.collect(PoseStamped, "pose")
        self.trajectories = graph.collect(JointTrajectory, "rotor_trajectory")
        goals = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
        sender = graph.publisher(PoseStamped, "goal_pose")
        graph.until(lambda: self.poses)
        sender.publish(pose_to_ros(CASE.goal, 0, 0.3))
        graph.until(lambda: goals)

    @property
    def now(self) -> int:
        """Stamp of the newest pose [ns]."""
        return stamp_from_ros(self.poses[-1].header.stamp)

    def step(self) -> None:
        """Go on to the next sampling instant and its command."""
        until = (self.now // self.sample + 1) * self.sample
        assert self.graph.call(Trigger, "simulator/step", Trigger.Request()).success
        self.graph.until(lambda: self.now == until and max(self.sent(), default=0) == until)

    def resume(self) -> None:
        """Let time run on for `COMPARED_FOR`."""
        self.graph.call(SetBool, "simulator/pause", SetBool.Request(data=False))
        # At full speed they are received later than they are sent.
        end = COMPARED_FOR * 1e9
        self.graph.until(lambda: self.now >= end and max(self.sent(), default=0) >= end)

    def seen(self) -> dict[int, list]:
        """Return the poses at sampling instants by stamp [ns]."""
        found = {stamp_from_ros(p.header.stamp): pose_from_ros(p).tolist() for p in self.poses}
        return {stamp: state for stamp, state in found.items() if stamp % self.sample == 0}

    def sent(self) -> dict[int, list]:
        """Return the velocities of each trajectory by stamp [ns]."""
        return {
            stamp_from_ros(it.header.stamp): [list(point.velocities) for point in it.points]
            for it in self.trajectories
        }


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["paper", "time_optimal"])
def test_lockstep_gives_the_run_without_ros(graph, strategy) -> None:
    with nodes(strategy, **LOCKSTEP, **NOISY, real_time_factor=0.0):
        run = Run(graph, strategy)
        run.resume()
    robot, assumed = RobotParameters(), ControllerSettings(strategy=strategy)
    alone = run_closed_loop(
        Simulator(SimulatorSettings(**NOISY), robot), Controller(assumed, robot), CASE.goal,
        COMPARED_FOR, assumed.control_period, output_period=assumed.control_period,
    )
    seen = run.seen()
    for time, state in zip(alone.times, alone.states, strict=True):
        np.testing.assert_allclose(seen[round(time * 1e9)], state, atol=1e-6)


@pytest.mark.slow
def test_lockstep_repeats_itself_at_any_pace_whatever_parameter_is_set_on_the_way(graph) -> None:
    def made(pace: float, **change: object) -> tuple[dict[int, list], dict[int, list]]:
        settings = {**LOCKSTEP, "pose_rate": 20.0, "real_time_factor": pace}
        with nodes("time_optimal", **settings):
            run = Run(graph, "time_optimal")
            for _ in range(4):
                run.step()
            assert np.any(run.sent()[run.now]), "on the way"
            given = [Parameter(k, value=v).to_parameter_msg() for k, v in change.items()]
            request = SetParameters.Request(parameters=given)
            answer = graph.call(SetParameters, "controller/set_parameters", request)
            assert all(result.successful for result in answer.results)
            run.resume()
        return run.seen(), run.sent()

    # As fast as possible, and at three times real time.
    one, other = made(0.0), made(3.0, pose_timeout=0.7, goal_tolerance=9e-3)
    for first, again in zip(one, other, strict=True):
        # Later trajectories may be the ramp to rest of a controller that ends.
        shared = {it for it in first.keys() & again.keys() if it < COMPARED_FOR * 1e9}
        assert len(shared) >= COMPARED_FOR / STRATEGIES["time_optimal"].sample_period
        assert all(first[stamp] == again[stamp] for stamp in shared), "bit for bit"

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A controller node with poses and clock that the test publishes."""

import time
from itertools import pairwise
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from ros_graph import Graph, forget_faults, values_of
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.cdr import hold_and_stamp
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_to_ros, stamp_to_ros
from sphere_sim.scenario.scenarios import PAPER_CASES

CASE = PAPER_CASES[1]
TICK = 20_000_000
"""Spacing of poses and clock messages [ns]."""
FACTOR = 5.0
"""Largest pace of simulated time: statuses, and plans of the worker, come by wall time."""
STATUS_PERIOD = 0.05
"""Between two statuses of the controller [s]."""
STANDS_STILL = "the clock stands still"
ON_THE_WAY = "on the way to the goal"


class NoPlanningTime:
    """Clocks of the controller node with which plans take no time: commands are dated exactly."""

    monotonic = staticmethod(time.monotonic)

    @staticmethod
    def perf_counter() -> float:
        return 0.0


class Robot:
    """Publisher of a pose and the clock; `pass_time` lets simulated time run."""

    def __init__(self, graph: Graph, **settings: object) -> None:
        self.graph = graph
        self.node = self._started(settings)
        self.trajectories = graph.collect(JointTrajectory, "rotor_trajectory")
        self.commands = graph.collect(Float64MultiArray, "rotor_commands")
        self.statuses = graph.collect(DiagnosticStatus, "controller/status")
        self.goals = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
        self.pose_sender = graph.publisher(PoseStamped, "pose")
        self.clock = graph.publisher(Clock, "/clock")
        self.now = 0
        self.pose = pose_to_ros(CASE.start, 0, 0.3)
        self.pose_sender.publish(self.pose)
        graph.until(lambda: len(self.statuses) >= 2)
        self.at_first = [values_of(status)["mode"] for status in self.statuses]
        """Modes of the statuses before the first message of the clock."""

    def _started(self, settings: dict[str, object]) -> ControllerNode:
        # The poses of the test stand, whatever is sent; what is learnt of that depends on when
        # results arrive.
        settings = {"use_sim_time": True, "strategy": "paper", "learning": False,
                    "momentum": False, **settings}
        return self.graph.start(ControllerNode, **settings)

    def start_again(self, **settings: object) -> None:
        """End the controller in good order and start another one."""
        self.node.finish()
        self.graph.remove(self.node)
        self.node = self._started(settings)
        self.graph.until(lambda: self.clock.get_subscription_count() > 0)
        self.pass_time(0.3)
        self.graph.until(lambda: self.node._stored_goal.is_settled)

    def rest(self) -> None:
        """Come to rest without a goal, and forget what was received."""
        self.pose = pose_to_ros(CASE.start, 0, 0.3)
        self.call(SetBool, "enable", data=True)
        self.call(Trigger, "cancel")

        def is_at_rest() -> bool:
            self.statuses.clear()
            self.pass_time(0.2)
            return bool(self.reported) and (
                (self.status()["mode"], self.status()["at_rest"]) == ("no goal", "true")
            )

        self.graph.until(is_at_rest)
        for received in (self.trajectories, self.commands, self.statuses, self.goals):
            received.clear()
        forget_faults(self.node)

    def call(self, kind: Any, name: str, **fields: object) -> Any:
        return self.graph.call(kind, f"controller/{name}", **fields)

    def pass_time(self, duration: float) -> None:
        """Let simulated time pass [s]."""
        end = self.now + round(duration * 1e9)
        while self.now < end:
            self.now += TICK
            self.pose.header.stamp = stamp_to_ros(self.now)
            self.pose_sender.publish(self.pose)
            self.graph.spin_for(1e-9 * TICK / FACTOR)
            self.clock.publish(Clock(clock=stamp_to_ros(self.now)))
            self.graph.until(lambda: self.node._control_clock.stamp() == self.now)
        self.graph.spin_for(STATUS_PERIOD)

    def until_on_the_way(self) -> None:
        """Let time pass until the clock counts as steady and the controller tracks its goal."""
        self.pass_time(0.1)  # those under way are about the time before
        self.statuses.clear()

        def is_on_the_way() -> bool:
            self.pass_time(0.1)
            return bool(self.reported) and self.status()["mode"] == ON_THE_WAY

        self.graph.until(is_on_the_way)

    def send_goal(self, goal: Vector = CASE.goal) -> None:
        received = len(self.goals)
        self.graph.send_goal(goal)
        self.graph.until(lambda: len(self.goals) > received)

    def shown(self, stamp: str) -> list[dict[str, str]]:
        """Return the statuses that show the goal with a stamp."""
        values = map(values_of, self.statuses)
        return [one for one in values if one["goal_stamp"] == stamp]

    def holds(self) -> list[FirstOrderHold]:
        """Holds sent, each once: on a busy machine poses are late and commands are repeated."""
        sent = (hold_and_stamp(it, 0)[0] for it in map(serialize_message, self.trajectories))
        return list({hold.start: hold for hold in sent}.values())

    @property
    def reported(self) -> list[DiagnosticStatus]:
        """Statuses while the clock runs: a busy machine may hold it up at any time."""
        return [one for one in self.statuses if values_of(one)["mode"] != STANDS_STILL]

    def status(self) -> dict[str, str]:
        return values_of(self.reported[-1])

    def moved(self) -> bool:
        sent = [hold.speeds for hold in self.holds()] + [np.array(c.data) for c in self.commands]
        return any(np.any(speeds) for speeds in sent)


def assert_joined(holds: list[FirstOrderHold]) -> None:
    """Check that each plan leaves from the speeds that the one before has then."""
    for before, after in pairwise(holds):
        np.testing.assert_allclose(after.speeds[0], before.at(after.start), atol=1e-6)


def assert_within_acceleration(hold: FirstOrderHold) -> None:
    """Check the largest acceleration, times being whole nanoseconds."""
    steps = np.abs(np.diff(hold.speeds, axis=0))
    assert np.all(steps <= 400.0 * (np.diff(hold.times)[:, None] * (1.0 + 1e-6) + 2e-9))

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of what a controller depends on: clock, poses and the topic of its commands."""

import math
import time

from rclpy.node import Node

from sphere_nmpc.control.link import PoseLink
from sphere_nmpc.control.timing import MissedSamples
from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.ros.graph_faults import (
    NO_POSE,
    OTHER_CLOCK_AGE,
    GraphFault,
    GraphState,
    clock_jumped,
    find_faults,
    missed_samples,
    several_publishers,
)
from sphere_nmpc.ros.graph_monitor import GraphMonitor

_COMPARE_EVERY = 1.0
"""Wall time between two comparisons of all profiles [s]; each takes longer than a tick."""


class ControllerMonitor:
    """Monitor of the silence of clock and poses, which logs the faults around a controller.

    Parameters
    ----------
    node : Node
        The controller node.
    fault_log : FaultLog
        Where faults are logged and counted.
    """

    def __init__(self, node: Node, fault_log: FaultLog) -> None:
        self._fault_log = fault_log
        self._graph = GraphMonitor(node, fault_log)
        self._pose_topic = node.resolve_topic_name("pose")
        self._clock_topic = node.resolve_topic_name("/clock")
        self._command_topic = node.resolve_topic_name("rotor_trajectory")
        self.time = math.nan
        """Control time at the last check [s]; nan before the first message on /clock."""
        self.stands_still = False
        """Whether control time was the same at the check before."""
        self.is_steady = True
        """Whether the clock had not jumped shortly before the last check."""
        self.pose_link = PoseLink()
        """Delay and loss of the poses."""
        self._samples = MissedSamples()
        self._counted = (0, 0, 1.0)
        self._time_changed_at = self._pose_seen_at = time.monotonic()
        self._pose_age = math.nan
        self._incompatible: list[GraphFault] = []
        self._compared_at = -math.inf
        self._pose_received = False

    @property
    def faults(self) -> list[GraphFault]:
        """The present faults, the most severe first."""
        return self._graph.faults

    def pose_received(self, time: float, age: float) -> None:
        """Record a pose of control time `time` [s], `age` behind the clock; nan if unknown."""
        self._pose_received, self._pose_age = True, age
        self.pose_link.received(time, age)

    def sampled(self, used: int, missed: int, period: float) -> None:
        """Record the numbers of sampling instants with and without a plan so far.

        `period` is the time between them [s].
        """
        self._counted = (used, missed, period)

    def pose_refused(self, ahead: float, pose_timeout: float) -> None:
        """Log a pose that is refused as its stamp is `ahead` [s] of the node's clock.

        A stamp of another kind of clock is logged as such by `check`.
        """
        if ahead < OTHER_CLOCK_AGE:
            self._fault_log.report(
                "pose refused",
                f"given a stamp {ahead:.6g} s ahead of this node's clock, expected at "
                f"most {pose_timeout:g} s; are the clocks synchronised?",
            )

    def check(
        self, now: float | None, follows_clock: bool, jump: float, pose_timeout: float
    ) -> None:
        """Update the faults at control time `now` [s], None before the first message on /clock.

        Parameters
        ----------
        now : float or None
            Control time [s].
        follows_clock : bool
            Whether the node runs with ``use_sim_time``.
        jump : float
            Step of the clock [s] that was no more than 0.2 s ago; 0 without any.
        pose_timeout : float
            Largest accepted age of a pose [s].
        """
        wall, graph = time.monotonic(), self._graph
        self.is_steady = jump == 0.0
        before, self.time = self.time, math.nan if now is None else now
        self.stands_still = self.time == before
        if now is not None and not self.stands_still:
            self._time_changed_at = wall
        # Measured at the same checks, clock and poses of a simulator that ends are silent for the
        # same time.
        if self._pose_received:
            self._pose_received, self._pose_seen_at = False, wall
        # All topics are searched only where the clock that is followed has no publisher.
        clocks = graph.publishers(self._clock_topic)
        others = graph.clock_topics() if follows_clock and not clocks else []
        found = find_faults(
            GraphState(
                follows_clock, self.time, wall - self._time_changed_at, wall - self._pose_seen_at,
                self._pose_age, pose_timeout, clocks,
                graph.publishers(self._pose_topic), self._clock_topic, self._pose_topic, others,
            )
        )
        used, missed, period = self._counted
        self._samples.read(wall, used, missed)
        found += missed_samples(self._samples.share, self._samples.span, period)
        senders = graph.publishers(self._command_topic)
        found += several_publishers(
            self._command_topic, senders, "the rotors then do not follow one plan"
        )
        if jump:
            found.append(clock_jumped(jump))
        if wall >= self._compared_at + _COMPARE_EVERY:
            self._compared_at, self._incompatible = wall, graph.incompatible()
        if any(fault.kind.endswith(f" {self._pose_topic}") for fault in self._incompatible):
            found = [fault for fault in found if fault.kind != NO_POSE]
        graph.update(self._incompatible + found)

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of what a controller depends on: clock, poses and the topic of its commands."""

import time
from collections.abc import Sequence

from geometry_msgs.msg import PoseStamped
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.control.timing import MissedSamples
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.reporting.fault_log import FaultLog
from sphere_nmpc.reporting.stamps import OTHER_CLOCK_AGE, StampWatch
from sphere_nmpc.ros.controller.pose_source import PoseSource
from sphere_nmpc.ros.graph_monitor import several_publishers
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.input_monitor import CHECK_EVERY, POSES, SILENCE_LIMIT, InputMonitor

_MISSING = SILENCE_LIMIT - 3.0 * CHECK_EVERY
"""Silence of the poses after which the status of their source is read [s, wall], so that it is
known when they count as missing."""


class ControllerMonitor(InputMonitor):
    """Monitor of clock, poses, samples and commands, which logs the faults around a controller."""

    def __init__(self, node: GuardedNode, fault_log: FaultLog) -> None:
        self.poses = StampWatch()
        """Messages of the poses, and their stamps."""
        super().__init__(node, fault_log, {POSES: self.poses})
        self.topic = self.topics[POSES]
        """Full name of their topic."""
        self._pose_source = PoseSource(node)
        self._command_topic = node.resolve_topic_name("rotor_trajectory")
        self.is_steady = True
        """Whether the clock had not jumped shortly before the last check."""
        self._samples = MissedSamples()

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
        self, now: float | None, follows_clock: bool, jump: float, pose_timeout: float,
        further: Sequence[Condition], instants: tuple[int, int, float],
    ) -> None:
        """Update the faults at control time `now` [s], None before the first message on /clock.

        `jump` is the step of the clock [s] if there was one no more than 0.2 s ago, or 0,
        `pose_timeout` the largest accepted age of a pose [s], `further` what is found elsewhere,
        `instants` the numbers of sampling instants with and without a plan, and their period [s].
        """
        self.is_steady = jump == 0.0
        used, missed, period = instants
        self._samples.read(time.monotonic(), used, missed)
        found = [*self.inexact_stamps, *self._samples.faults(period)]
        is_missing = time.monotonic() > self.poses.seen_at + _MISSING
        sources = self.graph.publishers(self.topic, PoseStamped) if is_missing else ()
        self.poses.reported = self._pose_source.reported_by(sources)
        senders = self.graph.publishers(self._command_topic, JointTrajectory)
        found += several_publishers(
            self._command_topic, senders, "the rotors then do not follow one plan"
        )
        if jump:
            found.append(Condition(
                Kind.CLOCK_JUMPED,
                f"given a step of {jump:+.6g} s, expected a clock that runs on; "
                "nothing is sent until it does",
            ))
        self.update(now, follows_clock, pose_timeout, [*found, *further])

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the controller sees of its surroundings: how long clock and pose have been silent."""

import math
import time

from rclpy.node import Node

from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.ros.surroundings import (
    NO_POSE,
    OTHER_CLOCK,
    Complaint,
    Surroundings,
    complaints,
    several,
)
from sphere_nmpc.ros.watch import Watch


class ControllerWatch:
    """Watch clock, pose and command topics of a controller.

    Parameters
    ----------
    node : Node
        The controller node.
    faults : FaultLog
        Who writes and counts.
    """

    def __init__(self, node: Node, faults: FaultLog) -> None:
        self._faults = faults
        self._watch = Watch(node, faults)
        self._pose_topic = node.resolve_topic_name("pose")
        self._clock_topic = node.resolve_topic_name("/clock")
        self._command_topic = node.resolve_topic_name("rotor_trajectory")
        self.time = math.nan
        """Control time at the last look [s]; nan before the first message on /clock."""
        self.stands_still = False
        """Whether it had not gone on since the look before."""
        self._time_moved = self._pose_came = time.monotonic()
        self._pose_age = math.nan
        self._heard = False

    @property
    def complaints(self) -> list[Complaint]:
        """What is wrong now, the gravest first."""
        return self._watch.complaints

    def heard(self, age: float) -> None:
        """Take note of a pose whose stamp is `age` [s] behind the node's clock, nan if unknown."""
        self._heard, self._pose_age = True, age

    def pose_refused(self, ahead: float, pose_timeout: float) -> None:
        """Report a pose refused because its stamp is `ahead` [s] of the node's clock.

        If it is of another kind of clock, that is reported instead.
        """
        if ahead < OTHER_CLOCK:
            self._faults.report(
                "pose refused",
                f"given a stamp {ahead:.6g} s ahead of this node's clock, expected at "
                f"most {pose_timeout:g} s; are the clocks synchronised?",
            )

    def look(self, now: float | None, follows_clock: bool, pose_timeout: float) -> None:
        """Look around at control time `now` [s], None before the first message on /clock."""
        wall, watch = time.monotonic(), self._watch
        before, self.time = self.time, math.nan if now is None else now
        self.stands_still = self.time == before
        if now is not None and not self.stands_still:
            self._time_moved = wall
        # Seen at the same looks, clock and pose of a simulator that ends fall silent together.
        if self._heard:
            self._heard, self._pose_came = False, wall
        # The whole graph is searched only where the clock that is followed has no publisher.
        clocks = watch.publishers(self._clock_topic)
        others = watch.clock_topics() if follows_clock and not clocks else []
        found = complaints(
            Surroundings(
                follows_clock, self.time, wall - self._time_moved, wall - self._pose_came,
                self._pose_age, pose_timeout, clocks,
                watch.publishers(self._pose_topic), self._clock_topic, self._pose_topic, others,
            )
        )
        harm = "what the rotors do is then not what is planned with"
        senders = watch.publishers(self._command_topic)
        found += several(self._command_topic, senders, harm)
        unfit = watch.incompatible()
        if any(complaint.kind.endswith(f" {self._pose_topic}") for complaint in unfit):
            found = [complaint for complaint in found if complaint.kind != NO_POSE]
        watch.update(unfit + found)

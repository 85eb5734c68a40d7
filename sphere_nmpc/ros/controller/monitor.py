# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of what a controller depends on: clock, poses and the topic of its commands."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.conditions import Condition, Kind
from sphere_nmpc.control.pose_stream import StampWatch
from sphere_nmpc.control.timing import MissedSamples
from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.ros.graph_monitor import (
    GraphMonitor,
    further_publishers,
    several_publishers,
)

SILENCE_LIMIT = 1.25
"""Silence after which a topic counts as missing [s, wall]. Nodes that start together have
discovered each other by then, and with checks every half second faults are logged within two."""
_OTHER_CLOCK_AGE = 1e6
"""Age of a pose beyond which its stamp is of another kind of clock, not merely late [s]."""


class ControllerMonitor:
    """Monitor of the silence of clock and poses, which logs the faults around a controller."""

    def __init__(self, node: Node, fault_log: FaultLog) -> None:
        self._fault_log = fault_log
        self._graph = GraphMonitor(node, fault_log)
        self.pose_topic = node.resolve_topic_name("pose")
        """Full name of the topic of the poses."""
        self._clock_topic = node.resolve_topic_name("/clock")
        self._command_topic = node.resolve_topic_name("rotor_trajectory")
        self.time = math.nan
        """Control time at the last check [s]; nan before the first message on /clock."""
        self.stands_still = False
        """Whether control time was the same at the check before."""
        self.is_steady = True
        """Whether the clock had not jumped shortly before the last check."""
        self.stamps = StampWatch()
        """Stamps of the poses."""
        self._has_stamp = True
        self._samples = MissedSamples()
        self._time_changed_at = self._pose_seen_at = time.monotonic()
        self._pose_age = math.nan
        self._incompatible: list[Condition] = []
        self._compared_at = self._pose_seen_at
        self._pose_received = False

    @property
    def faults(self) -> tuple[Condition, ...]:
        """The present faults, the worst first."""
        return self._graph.faults

    def pose_received(self, age: float, stamp: int) -> None:
        """Record a pose with a stamp [ns], `age` behind the clock [s]; nan if unknown."""
        self._pose_received, self._pose_age, self._has_stamp = True, age, stamp != 0

    def pose_refused(self, ahead: float, pose_timeout: float) -> None:
        """Log a pose that is refused as its stamp is `ahead` [s] of the node's clock.

        A stamp of another kind of clock is logged as such by `check`.
        """
        if ahead < _OTHER_CLOCK_AGE:
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
        clocks = graph.publishers(self._clock_topic, Clock)
        others = graph.clock_topics() if follows_clock and not clocks else []
        found = find_faults(
            GraphState(
                follows_clock, self.time, wall - self._time_changed_at, wall - self._pose_seen_at,
                self._pose_age, pose_timeout, clocks,
                graph.publishers(self.pose_topic, PoseStamped), self._clock_topic,
                self.pose_topic, others, self._has_stamp,
            )
        )
        inexact = self.stamps.fault()
        if inexact is not None:
            found.append(inexact)
        found += self._missed_samples(wall, *instants)
        senders = graph.publishers(self._command_topic, JointTrajectory)
        found += several_publishers(
            self._command_topic, senders, "the rotors then do not follow one plan"
        )
        if jump:
            found.append(Condition(
                Kind.CLOCK_JUMPED,
                f"given a step of {jump:+.6g} s, expected a clock that runs on; "
                "nothing is sent until it does",
            ))
        # A comparison of all profiles takes longer than a tick, and before the first one a
        # publisher of another type may be the only one that has been discovered.
        if wall >= self._compared_at + SILENCE_LIMIT:
            self._compared_at, self._incompatible = wall, graph.incompatible()
        if any(fault.subject == self.pose_topic for fault in self._incompatible):
            found = [fault for fault in found if fault.kind is not Kind.POSE_MISSING]
        graph.update([*self._incompatible, *found, *further])

    def _missed_samples(
        self, wall: float, used: int, missed: int, period: float
    ) -> list[Condition]:
        self._samples.read(wall, used, missed)
        if not self._samples.share:
            return []
        return [
            Condition(
                Kind.MISSED_SAMPLES,
                f"given {100.0 * self._samples.share:.3g} % of the sampling "
                f"instants of the last {self._samples.span:.0f} s without a plan, at "
                f"{1.0 / period:.4g} Hz, expected none; a lower control_rate, thread_priority: 1 "
                "or a free processor core helps",
            )
        ]


@dataclass(frozen=True)
class GraphState:
    """Observations of the ROS graph by a controller at one moment.

    Control `time` [s] is nan before the first message on /clock; the silences [s] are of wall
    time, since control time last changed and since the last pose; `pose_age` [s] is that of the
    newest pose on the node's clock when it was received, nan before it; `clocks` and `poses` name
    the nodes that publish them, `other_clocks` the other topics on which a clock is published.
    """

    follows_clock: bool
    time: float
    clock_silence: float
    pose_silence: float
    pose_age: float
    pose_timeout: float
    clocks: Sequence[str]
    poses: Sequence[str]
    clock_topic: str = "/clock"
    pose_topic: str = "/pose"
    other_clocks: Sequence[str] = ()
    has_stamp: bool = True
    """Whether the newest pose has a stamp other than 0."""


def find_faults(seen: GraphState) -> list[Condition]:
    """Return the faults of clock and poses around a controller."""
    found = _no_time(seen) or _no_pose(seen) or _wrong_clock(seen)
    clocks = seen.clocks if seen.follows_clock else ()
    further = further_publishers(seen.pose_topic, seen.poses, seen.clock_topic, clocks)
    return [found, *further] if found else further


def _no_time(seen: GraphState) -> Condition | None:
    """Return the fault of a clock that is not published or has stopped."""
    if not seen.follows_clock or seen.clock_silence < SILENCE_LIMIT:
        return None
    topic, stopped = seen.clock_topic, f"since t = {seen.time:.3f} s, expected"
    if math.isnan(seen.time):
        if seen.clocks:
            return Condition(
                Kind.CLOCK_MISSING,
                f"given a publisher of {topic} ({seen.clocks[0]}) that has sent nothing for "
                f"{SILENCE_LIMIT:g} s, expected its messages; restart it",
            )
        remedy = "start a simulator, or on a real robot -p use_sim_time:=false"
        if seen.other_clocks:
            other = f"-r /clock:={seen.other_clocks[0]} follows the clock that is there"
            remedy = f"{other}, or {remedy}"
        return Condition(
            Kind.CLOCK_MISSING,
            f"given use_sim_time: true and no publisher of {topic}, expected one; {remedy}",
        )
    if seen.pose_silence < SILENCE_LIMIT:
        # A simulator that is paused, or waits in lockstep, repeats its last pose.
        return Condition(
            Kind.CLOCK_ENDED,
            f"given poses but no message on {topic} {stopped} both from one simulator; find out "
            f"what blocks {topic}",
        ) if seen.pose_age < -seen.pose_timeout else None
    cause = "its publisher hangs or was killed" if seen.clocks else "its publisher is gone"
    return Condition(
        Kind.CLOCK_ENDED,
        f"given nothing on {topic} and {seen.pose_topic} {stopped} a running simulator; {cause}: "
        "restart it",
    )


def _no_pose(seen: GraphState) -> Condition | None:
    """Return the fault of poses that are not published or not received."""
    if seen.pose_silence < SILENCE_LIMIT:
        return None
    given = f"no publisher of {seen.pose_topic}"
    remedy = "start the simulator or the robot's estimator, or remap, -r pose:=/its/topic"
    if seen.poses:
        given = f"a publisher of {seen.pose_topic} ({seen.poses[0]}) but none of its messages"
        remedy = f"'ros2 topic info -v {seen.pose_topic}' shows its quality of service"
    return Condition(
        Kind.POSE_MISSING,
        f"given {given} for {SILENCE_LIMIT:g} s, expected 20 Hz or more; {remedy}",
    )


def _wrong_clock(seen: GraphState) -> Condition | None:
    """Return the fault of poses that are stamped on another clock than the node's."""
    age = seen.pose_age
    # A single pose ahead of the clock is refused and logged by itself; nan is before the first.
    if not (age > seen.pose_timeout or age < -_OTHER_CLOCK_AGE):
        return None
    if seen.follows_clock and seen.clock_silence >= SILENCE_LIMIT:
        return None  # paused
    if not seen.has_stamp:
        return Condition(
            Kind.NO_STAMP,
            f"given poses on {seen.pose_topic} with the stamp 0, expected the time of "
            "measurement on this node's clock; the program that publishes them has to set "
            "header.stamp",
        )
    kind = Kind.WRONG_CLOCK
    remedy = "synchronise the clocks of the machines (chrony), or raise pose_timeout"
    if not seen.follows_clock and age > _OTHER_CLOCK_AGE:
        remedy = "they are in simulated time: start this node with -p use_sim_time:=true"
        if not seen.clocks:  # with it, this node would wait for a clock for ever
            kind = Kind.UNKNOWN_CLOCK
            remedy = (
                f"nothing publishes {seen.clock_topic}, so that it is no simulated time: the "
                "program that publishes them has to set header.stamp by the system clock"
            )
    elif seen.follows_clock and age < -_OTHER_CLOCK_AGE:
        remedy = "they are on the system clock: start this node with -p use_sim_time:=false"
    return Condition(
        kind,
        f"given poses with stamps {abs(age):.3g} s {'behind' if age > 0.0 else 'ahead of'} this "
        f"node's clock, expected at most {seen.pose_timeout:g} s; {remedy}",
    )

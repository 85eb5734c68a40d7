# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of the clock and of the stamped messages that a node depends on: silence and stamps."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.reporting.fault_log import FaultLog
from sphere_nmpc.reporting.stamps import OTHER_CLOCK_AGE, StampWatch
from sphere_nmpc.ros.graph_monitor import (
    CLOCK_EFFECT,
    POSE_EFFECT,
    GraphMonitor,
    several_publishers,
)

CHECK_EVERY = 0.25
"""Wall time between two checks of clock, messages and topics [s]."""
SILENCE_LIMIT = 1.25
"""Silence after which a topic counts as missing [s, wall]. Nodes that start together have
discovered each other by then, and with such checks faults are logged within two."""


@dataclass(frozen=True)
class Source:
    """Stamped messages that a node depends on: type, and words for what they are."""

    message: type
    missing: Kind
    plural: str
    rate: str
    remedy: str
    """What is to be started where nobody publishes them."""
    topic: str
    """Relative name of the topic."""
    effect: str
    """What several publishers of it cause; empty where there may be several."""
    patience: str = ""
    """What else helps where they are late."""


POSES = Source(
    PoseStamped, Kind.POSE_MISSING, "poses", "20 Hz or more",
    "start the simulator or the robot's estimator", "pose", POSE_EFFECT,
    ", or raise pose_timeout",
)


class InputMonitor:
    """Monitor of clock and sources, which logs the faults around a node.

    The silence of the first source is a fault; of all their stamps, which the node has watched,
    have to be of its clock.
    """

    def __init__(
        self, node: Node, fault_log: FaultLog, sources: Mapping[Source, StampWatch]
    ) -> None:
        self._fault_log = fault_log
        self.graph = GraphMonitor(node, fault_log)
        """Monitor of the graph, which has the present faults."""
        self.watches = sources
        """Monitors of the messages, by their source."""
        self.topics = {source: node.resolve_topic_name(source.topic) for source in sources}
        """Full names of the topics; the first one is that of the messages needed most."""
        self._clock_topic = node.resolve_topic_name("/clock")
        self.time = math.nan
        """Control time at the last check [s]; nan before the first message on /clock."""
        self.stands_still = False
        """Whether control time was the same at the check before."""
        self._time_changed_at = self._compared_at = time.monotonic()
        self._incompatible: list[Condition] = []

    @property
    def inexact_stamps(self) -> list[Condition]:
        """What is wrong with the stamps of the first source of which something is; else empty."""
        return [fault for watch in self.watches.values() if (fault := watch.fault())][:1]

    def update(
        self, now: float | None, follows_clock: bool, timeout: float, further: Sequence[Condition]
    ) -> None:
        """Update the faults at control time `now` [s], None before the first message on /clock.

        `timeout` is the largest age of a message [s], `further` what is found elsewhere.
        """
        wall, graph = time.monotonic(), self.graph
        before, self.time = self.time, math.nan if now is None else now
        self.stands_still = self.time == before
        if now is not None and not self.stands_still:
            self._time_changed_at = wall
        # All topics are searched only where the clock that is followed has no publisher.
        clocks = graph.publishers(self._clock_topic, Clock)
        others = graph.clock_topics() if follows_clock and not clocks else []
        found: list[Condition] = []
        first = next(iter(self.watches))
        for source, watch in self.watches.items():
            # Measured at the same checks, clock and messages of a simulator that ends are silent
            # for the same time.
            watch.checked(wall)
            if source is not first and wall - watch.seen_at >= SILENCE_LIMIT:
                continue
            topic = self.topics[source]
            faults = find_faults(GraphState(
                follows_clock, self.time, wall - self._time_changed_at, wall - watch.seen_at,
                watch.age, timeout, clocks, graph.publishers(topic, source.message),
                self._clock_topic, topic, others, watch.has_stamp, source, watch.reported,
            ))
            names = {fault.name for fault in found}
            found += [fault for fault in faults if fault.name not in names]
        # A comparison of all profiles takes longer than a tick, and before the first one a
        # publisher of another type may be the only one that has been discovered.
        if wall >= self._compared_at + SILENCE_LIMIT:
            self._compared_at, self._incompatible = wall, graph.incompatible()
        if any(fault.subject == self.topics[first] for fault in self._incompatible):
            found = [fault for fault in found if fault.kind is not first.missing]
        names = {fault.name for fault in found}
        further = [fault for fault in further if fault.name not in names]
        graph.update([*self._incompatible, *found, *further])


@dataclass(frozen=True)
class GraphState:
    """Observations of the ROS graph by a node at one moment.

    Control `time` [s] is nan before the first message on /clock; the silences [s] are of wall
    time, since control time last changed and since the last message of the source; `age` [s] is
    that of the newest one on the node's clock when it was received, nan before it; `clocks` and
    `senders` name the nodes that publish them, `other_clocks` the other topics on which a clock is
    published.
    """

    follows_clock: bool
    time: float
    clock_silence: float
    silence: float
    age: float
    timeout: float
    clocks: Sequence[str]
    senders: Sequence[str]
    clock_topic: str = "/clock"
    topic: str = "/pose"
    other_clocks: Sequence[str] = ()
    has_stamp: bool = True
    """Whether the newest message has a stamp other than 0."""
    source: Source = POSES
    reported: str = ""
    """What the node that publishes the messages reports as wrong."""


def find_faults(seen: GraphState) -> list[Condition]:
    """Return the faults of clock and source around a node."""
    found = _no_time(seen) or _no_message(seen) or _wrong_clock(seen)
    clocks = seen.clocks if seen.follows_clock else ()
    senders = seen.senders if seen.source.effect else ()
    return [
        *([found] if found else []),
        *several_publishers(seen.clock_topic, clocks, CLOCK_EFFECT),
        *several_publishers(seen.topic, senders, seen.source.effect),
    ]


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
    if seen.silence < SILENCE_LIMIT:
        # A simulator that is paused, or waits in lockstep, repeats its last pose.
        return Condition(
            Kind.CLOCK_ENDED,
            f"given {seen.source.plural} but no message on {topic} {stopped} both from one "
            f"simulator; find out what blocks {topic}",
        ) if seen.age < -seen.timeout else None
    cause = "its publisher hangs or was killed" if seen.clocks else "its publisher is gone"
    return Condition(
        Kind.CLOCK_ENDED,
        f"given nothing on {topic} and {seen.topic} {stopped} a running simulator; {cause}: "
        "restart it",
    )


def _no_message(seen: GraphState) -> Condition | None:
    """Return the fault of a source that is not published or not received."""
    if seen.silence < SILENCE_LIMIT:
        return None
    source, given = seen.source, f"no publisher of {seen.topic}"
    remedy = f"{source.remedy}, or remap, -r {source.topic}:=/its/topic"
    if seen.senders:
        given = f"a publisher of {seen.topic} ({seen.senders[0]}) but none of its messages"
        quality = f"'ros2 topic info -v {seen.topic}' shows its quality of service"
        remedy = seen.reported or quality
    return Condition(
        source.missing,
        f"given {given} for {SILENCE_LIMIT:g} s, expected {source.rate}; {remedy}",
    )


def _wrong_clock(seen: GraphState) -> Condition | None:
    """Return the fault of a source that is stamped on another clock than the node's."""
    age, plural = seen.age, seen.source.plural
    if not abs(age) > seen.timeout:  # nan is before the first
        return None
    if seen.follows_clock and seen.clock_silence >= SILENCE_LIMIT:
        return None  # paused
    if not seen.has_stamp:
        return Condition(
            Kind.NO_STAMP,
            f"given {plural} on {seen.topic} with the stamp 0, expected the time of "
            "measurement on this node's clock; the program that publishes them has to set "
            "header.stamp",
        )
    kind = Kind.WRONG_CLOCK
    remedy = f"synchronise the clocks of the machines (chrony){seen.source.patience}"
    if not seen.follows_clock and age > OTHER_CLOCK_AGE:
        remedy = "they are in simulated time: start this node with -p use_sim_time:=true"
        if not seen.clocks:  # with it, this node would wait for a clock for ever
            kind = Kind.UNKNOWN_CLOCK
            remedy = (
                f"nothing publishes {seen.clock_topic}, so that it is no simulated time: the "
                "program that publishes them has to set header.stamp by the system clock"
            )
    elif seen.follows_clock and age < -OTHER_CLOCK_AGE:
        remedy = "they are on the system clock: start this node with -p use_sim_time:=false"
    side = "behind" if age > 0.0 else "ahead of"
    return Condition(
        kind,
        f"given {plural} on {seen.topic} with stamps {abs(age):.3g} s {side} this node's clock, "
        f"expected at most {seen.timeout:g} s; {remedy}",
    )

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Relay between simulator and controller that disturbs what it passes on, and shows it to a judge.

The simulator publishes below ``true/`` and the controller below ``sent/``, where nobody else
publishes anything; the relay passes their messages on to the usual topics, on which everybody may
publish. So a forged clock or pose never deceives the judge. All messages are read in their
serialised form: one that is malformed would end the executor of the campaign itself.
"""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from judge import Judge
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros.guarded_node import LATCHED

REMAPPED = {
    "simulator": {name: f"true/{name.strip('/')}" for name in ("pose", "joint_states", "/clock")},
    "controller": {name: f"sent/{name}" for name in ("rotor_trajectory", "rotor_commands")},
}
"""Topics of the nodes under test that the relay passes on."""
_AT_ONCE = 50
"""Messages of a topic that are passed on before anything else is done."""
_STAMP = struct.Struct("<iI")
_NEWEST = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
"""As in the controller: on a busy machine retransmissions in a reliable stream take seconds, and a
clock that lags behind the poses would be an unintended fault."""

Arrival = tuple[int, bytes]
"""Time at which a pose arrives [ns], and the serialised pose."""
Disturbance = Callable[[Arrival, np.random.Generator], list[Arrival]]


class Relay:
    """`node` owns the publishers; `reader` the subscriptions, and no executor may serve it."""

    def __init__(
        self, node: Node, reader: Node, judge: Judge, rng: np.random.Generator
    ) -> None:
        self.poses = PoseStream(rng)
        """Disturbances of the poses."""
        self.shift = 0
        """Offset of the robot's clock, as the controller sees it, to the simulator's [ns]."""
        self.forged = {"/clock": 0, "pose": 0}
        """Further offset of one topic, which is wrong [ns]."""
        self.lost: set[str] = set()
        """Topics that are not passed on at present."""
        self.newest = b""
        """The newest pose, undisturbed."""
        self._judge = judge
        table: tuple[tuple[str, str, type, Callable[[bytes, int, int], None]], ...] = (
            ("true/pose", "pose", PoseStamped, judge.pose),
            ("true/joint_states", "joint_states", JointState, judge.joints),
            ("true/clock", "/clock", Clock, judge.clock),
            ("sent/rotor_trajectory", "rotor_trajectory", JointTrajectory, judge.trajectory),
            ("sent/rotor_commands", "rotor_commands", Float64MultiArray, judge.command),
        )

        def read(kind: type, topic: str, qos: QoSProfile | int) -> Any:
            return reader.create_subscription(kind, topic, lambda _: None, qos, raw=True)

        self._routes = [
            (topic, read(kind, source, _NEWEST if source.startswith("true") else 1000),
             node.create_publisher(kind, topic, 10), look)
            for source, topic, kind, look in table
        ]
        self._looks = (
            (read(PoseStamped, "controller/active_goal", LATCHED), judge.confirmed),
            (read(OccupancyGrid, "controller/floor", LATCHED), judge.floor),
        )

    def forward(self) -> None:
        """Pass on what has arrived."""
        for topic, subscription, publisher, look in self._routes:
            for raw, about in taken(subscription):
                look(raw, about["source_timestamp"], self.shift)
                for passed in self._passed(topic, raw):
                    publisher.publish(passed)
        for subscription, take in self._looks:
            for raw, _ in taken(subscription):
                take(raw)

    def _passed(self, topic: str, raw: bytes) -> list[bytes]:
        """Return what is passed on when a message has arrived."""
        is_lost = topic in self.lost
        if topic == "pose":
            self.newest, now = raw, stamp_of(raw)
            shift = self.shift + self.forged["pose"]
            return [restamped(pose, shift) for pose in self.poses.pass_on(now, raw, is_lost)]
        if is_lost:
            return []
        if topic == "rotor_commands":
            return [raw]
        if topic != "rotor_trajectory":
            return [restamped(raw, self.shift + self.forged.get(topic, 0))]
        if stamp_of(raw):  # otherwise it begins when it arrives
            raw = restamped(raw, -self.shift)
        self._judge.delivered(raw)
        return [raw]


class PoseStream:
    """Delay line of poses with any number of disturbances."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.disturbances: list[Disturbance] = []
        """Disturbances of the poses that enter from now on, applied in this order."""
        self._pending: list[Arrival] = []
        self._now = 0

    def pass_on(self, now: int, pose: bytes, is_lost: bool = False) -> list[bytes]:
        """Take a pose at time `now` [ns]; return those that have arrived, in their order."""
        if now < self._now:  # time has restarted
            self._pending.clear()
        self._now = now
        arrivals = [] if is_lost else [(now, pose)]
        for disturb in self.disturbances:
            arrivals = [out for arrival in arrivals for out in disturb(arrival, self.rng)]
        self._pending = sorted(self._pending + arrivals, key=lambda arrival: arrival[0])
        ready = [pose for time, pose in self._pending if time <= now]
        self._pending = self._pending[len(ready) :]
        return ready


def dropped(share: float) -> Disturbance:
    """Drop a share of the poses."""
    return lambda arrival, rng: [] if rng.random() < share else [arrival]


def delayed(by: float) -> Disturbance:
    """Delay all poses by `by` [s]."""
    late = round(by * NANOSECONDS)
    return lambda arrival, rng: [(arrival[0] + late, arrival[1])]


def shuffled(within: float) -> Disturbance:
    """Delay each pose by a random time up to `within` [s], so that they overtake each other."""
    return lambda arrival, rng: [
        (arrival[0] + round(rng.uniform(0.0, within) * NANOSECONDS), arrival[1])
    ]


def duplicated(times: int) -> Disturbance:
    """Deliver each pose several times."""
    return lambda arrival, rng: [arrival] * times


def ahead(by: float) -> Disturbance:
    """Move the stamps into the future by `by` [s]."""
    return lambda arrival, rng: [(arrival[0], restamped(arrival[1], round(by * NANOSECONDS)))]


def not_finite(share: float = 1.0) -> Disturbance:
    """Replace one number by NaN or infinity in a share of the poses."""

    def corrupt(message: Any, rng: np.random.Generator) -> None:
        if rng.random() < share:
            owner, name = (
                *((message.pose.position, name) for name in "xy"),
                *((message.pose.orientation, name) for name in "wxyz"),
            )[rng.integers(6)]
            setattr(owner, name, float(rng.choice([np.nan, np.inf, -np.inf])))

    return _changed(corrupt)


def sign_flipped() -> Disturbance:
    """Flip the sign of every other quaternion, at random: the same rotation."""
    flip = scaled(-1.0)
    return lambda arrival, rng: flip(arrival, rng) if rng.random() < 0.5 else [arrival]


def scaled(by: float) -> Disturbance:
    """Scale the quaternion by a factor."""

    def scale(message: Any, rng: np.random.Generator) -> None:
        turn = message.pose.orientation
        turn.w, turn.x, turn.y, turn.z = (by * v for v in (turn.w, turn.x, turn.y, turn.z))

    return _changed(scale)


def framed(frame: str) -> Disturbance:
    """Set another frame."""
    return _changed(lambda message, rng: setattr(message.header, "frame_id", frame))


def _changed(change: Callable[[Any, np.random.Generator], None]) -> Disturbance:
    def disturb(arrival: Arrival, rng: np.random.Generator) -> list[Arrival]:
        message = deserialize_message(arrival[1], PoseStamped)
        change(message, rng)
        return [(arrival[0], bytes(serialize_message(message)))]

    return disturb


def taken(subscription: Any) -> list[tuple[bytes, dict[str, int]]]:
    """Return the serialised messages that have arrived, each with what the middleware knows.

    At most `_AT_ONCE`: a simulator without a limit of its pace publishes faster than this reads.
    """
    handle = subscription.handle
    found: list[tuple[bytes, dict[str, int]]] = []
    with handle:
        while len(found) < _AT_ONCE and (
            message := handle.take_message(subscription.msg_type, True)
        ) is not None:
            found.append((bytes(message[0]), message[1]))
    return found


def stamp_of(raw: bytes) -> int:
    """Return the stamp [ns] with which a serialised message begins."""
    seconds, nanoseconds = _STAMP.unpack_from(raw, 4)
    return int(seconds * NANOSECONDS + nanoseconds)


def restamped(raw: bytes, shift: int) -> bytes:
    """Return a serialised message that begins with a stamp, later by `shift` [ns]."""
    return stamped(raw, stamp_of(raw) + shift)


def stamped(raw: bytes, stamp: int) -> bytes:
    """Return a serialised message that begins with a stamp, with another one [ns]."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    return raw[:4] + _STAMP.pack(min(max(seconds, -(2**31)), 2**31 - 1), nanoseconds) + raw[12:]


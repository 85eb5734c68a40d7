# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Relay between simulator and controller that can shift the clock, and a judge of what passes.

The simulator publishes below ``true/`` and the controller below ``sent/``, where nobody else
publishes anything; the relay passes their messages on to the usual topics, on which everybody may
publish. So a forged clock or pose never deceives the judge. All messages are read in their
serialised form: one that is malformed would end the executor of the judge itself.
"""

import math
import struct
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.ros.messages import (
    clock_stamp,
    header_stamp,
    hold_and_stamp,
    pose_of_message,
    rotor_speeds_and_stamp,
    speeds_of_message,
)
from sphere_sim.faults.limits import LimitCheck

MOST_AHEAD = 0.5
"""Largest time from the true clock to the start of a command [s]."""
LONGEST = 10.0
"""Longest duration of a command [s]: for so long the rotors turn after a controller was killed."""
AT_REST = 1e-2
"""Speed below which a rotor rests [rad/s]."""
REMAPPED = {
    "simulator": {name: f"true/{name.strip('/')}" for name in ("pose", "joint_states", "/clock")},
    "controller": {name: f"sent/{name}" for name in ("rotor_trajectory", "rotor_commands")},
}
"""Topics of the nodes under test that the relay passes on."""
_GRACE = 1.0
"""Wall time that a controller has to notice that the true clock went back [s]."""
_FOLLOWED = 5.0
"""Largest difference of commanded and measured speeds that counts as following [rad/s]."""
_MOVING = 1.0
"""Speed above which a command counts as motion [rad/s]."""
_AT_ONCE = 50
"""Messages of a topic that are passed on before anything else is done."""
_STAMP = struct.Struct("<iI")
_NEWEST = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Judge:
    """Judge of commands and rotors, by the simulator's own time.

    Parameters
    ----------
    fail : callable
        Takes what is wrong, in words that do not change, and the detail.
    """

    def __init__(self, fail: Callable[..., None]) -> None:
        self._fail = fail
        robot = RobotParameters()
        self._limits = LimitCheck(robot.max_rotor_speed, robot.max_rotor_acceleration)
        self.now = 0
        """True time: the newest of the simulator [ns]."""
        self.state: Vector | None = None
        """Newest measured state, shape (6,); None if it is none that can be."""
        self.pose_stamp = 0
        """Stamp of that state [ns]."""
        self.speeds: Vector = np.zeros(2)
        """Measured rotor speeds [rad/s]."""
        self.goal: Vector | None = None
        """Goal that the controller confirmed last, shape (6,)."""
        self.status_count = 0
        self.worst = {"speed_rad_s": 0.0, "slew_rad_s2": 0.0, "ahead_s": 0.0, "duration_s": 0.0}
        self.count = 0
        """Number of commands that were judged."""
        self.reset_until = 0.0
        """Wall time until which the rotors may be set to rest at once, as by a reset [s]."""
        self.on_system_clock_until = 0.0
        """Wall time until which the controller may follow the system clock [s]."""
        self._hold: tuple[float, int, FirstOrderHold] | None = None
        self._true_times: deque[tuple[int, int]] = deque(maxlen=500)
        self._back_until = 0
        self._joint_stamp = 0

    def restarted(self) -> None:
        """Expect the time of a new simulator."""
        self.pose_stamp = 0

    def clock(self, raw: bytes, wall: int, shift: int) -> None:
        """Take the time of the simulator, published at `wall` [ns] and passed on with `shift`."""
        self.now = clock_stamp(raw)
        shifted = self.now + shift
        if self._true_times and shifted < self._true_times[-1][1]:
            self._back_until = wall + round(_GRACE * NANOSECONDS)
        self._true_times.append((wall, shifted))

    def pose(self, raw: bytes, wall: int, shift: int) -> None:
        """Take a pose of the simulator, unless it comes late, from a slow sensor."""
        stamp = header_stamp(raw)
        if stamp < self.pose_stamp:
            return
        self.pose_stamp, self.state = stamp, None
        with suppress(InvalidStateError):  # pushed away too far
            self.state = pose_of_message(raw)

    def joints(self, raw: bytes, wall: int, shift: int) -> None:
        """Take joint states of the simulator."""
        speeds, self._joint_stamp = rotor_speeds_and_stamp(raw)
        if speeds is None:
            self._fail("commands out of limits", "joint_states without finite speeds")
            return
        self.speeds = speeds
        if time.monotonic() < self.reset_until:
            self._limits.restart()
        self._limits.joints(self._joint_stamp, speeds)
        self._collect()

    def command(self, raw: bytes, wall: int, shift: int) -> None:
        """Take rotor speeds of the controller."""
        self.count += 1
        self._limits.command(speeds_of_message(raw))
        self._collect()

    def trajectory(self, raw: bytes, wall: int, shift: int) -> None:
        """Take a trajectory of the controller, of times on its shifted clock."""
        self.count += 1
        try:
            stamp = header_stamp(raw)
            hold, _ = hold_and_stamp(raw, 0, stamp)  # relative to its stamp, hence exact
        except (InvalidStateError, InvalidInputError) as error:
            self._fail("commands out of limits", f"rotor_trajectory is wrong: {error}")
            return
        self._hold = (time.monotonic(), stamp - shift, hold)
        self._limits.sent(hold)
        self._collect()
        if np.any(hold.speeds[-1] != 0.0):
            self._fail("commands that do not end at rest", f"{hold.speeds[-1].tolist()} rad/s")
        self.worst["duration_s"] = max(self.worst["duration_s"], hold.end)
        if hold.end > LONGEST:
            self._fail("commands that are too long", f"{hold.end:.3f} s")
        self._judge_start(stamp, wall)

    def _judge_start(self, stamp: int, wall: int) -> None:
        """Judge how far ahead a command of a stamp [ns] is that was published at `wall` [ns]."""
        true = next((then for at, then in reversed(self._true_times) if at <= wall), None)
        if true is None or wall < self._back_until:
            return
        ahead = (stamp - true) / NANOSECONDS
        if time.monotonic() < self.on_system_clock_until:
            ahead = min(ahead, (stamp - wall) / NANOSECONDS)
        self.worst["ahead_s"] = max(self.worst["ahead_s"], ahead)
        if ahead > MOST_AHEAD:
            self._fail("commands more than 0.5 s ahead", f"{ahead:.3f} s ahead of the true clock")

    def confirmed(self, raw: bytes) -> None:
        """Take the goal in force, as far as it can be read."""
        with suppress(InvalidStateError):
            self.goal = pose_of_message(raw)

    def follows(self, since: float) -> bool:
        """Return whether the rotors follow a command of the controller.

        It is in motion and was received after `since` [s; steady clock].
        """
        if self._hold is None or self._hold[0] < since:
            return False
        _, start, hold = self._hold
        wanted = hold.at((self._joint_stamp - start) / NANOSECONDS)
        difference = float(np.max(np.abs(wanted - self.speeds)))
        return bool(np.max(np.abs(wanted)) > _MOVING) and difference < _FOLLOWED

    @property
    def turning(self) -> float:
        """Speed of the faster rotor [rad/s]."""
        return float(np.max(np.abs(self.speeds)))

    def _collect(self) -> None:
        limits = self._limits
        self.worst["speed_rad_s"] = max(self.worst["speed_rad_s"], limits.worst_speed)
        self.worst["slew_rad_s2"] = max(self.worst["slew_rad_s2"], limits.worst_slew)
        for text in limits.broken:
            self._fail("commands out of limits", text)
        limits.begin()


class Relay:
    """Relay of all messages between simulator and controller.

    Parameters
    ----------
    node : Node
        Owner of the publishers.
    reader : Node
        Owner of the subscriptions; it must not be served by an executor.
    judge : Judge
        Is shown what is relayed.
    """

    def __init__(self, node: Node, reader: Node, judge: Judge) -> None:
        self.shift = 0
        """Offset of the robot's clock, as the controller sees it, to the simulator's [ns]."""
        self.forged = {"/clock": 0, "pose": 0}
        """Further offset of one topic, which is wrong [ns]."""
        self.lost: set[str] = set()
        """Topics that are not passed on at present."""
        self._judge = judge
        table: tuple[tuple[str, str, type, Callable[[bytes, int, int], None]], ...] = (
            ("true/pose", "pose", PoseStamped, judge.pose),
            ("true/joint_states", "joint_states", JointState, judge.joints),
            ("true/clock", "/clock", Clock, judge.clock),
            ("sent/rotor_trajectory", "rotor_trajectory", JointTrajectory, judge.trajectory),
            ("sent/rotor_commands", "rotor_commands", Float64MultiArray, judge.command),
        )
        self._routes: list[tuple[str, Any, Any, Any]] = []
        for source, topic, kind, look in table:
            qos = _NEWEST if source.startswith("true") else 1000
            taken = reader.create_subscription(kind, source, _ignore, qos, raw=True)
            self._routes.append((topic, taken, node.create_publisher(kind, topic, 10), look))
        confirmed, status = "controller/active_goal", "controller/status"
        self._goals = reader.create_subscription(
            PoseStamped, confirmed, _ignore, _LATCHED, raw=True
        )
        self._statuses = reader.create_subscription(
            DiagnosticStatus, status, _ignore, 10, raw=True
        )

    def forward(self) -> None:
        """Pass on what has arrived."""
        for topic, subscription, publisher, look in self._routes:
            for raw, about in taken(subscription):
                look(raw, about["source_timestamp"], self.shift)
                if topic not in self.lost:
                    publisher.publish(self._shifted(topic, raw))
        for raw, _ in taken(self._goals):
            self._judge.confirmed(raw)
        self._judge.status_count += len(taken(self._statuses))

    def _shifted(self, topic: str, raw: bytes) -> bytes:
        if topic == "rotor_commands":
            return raw
        back = topic == "rotor_trajectory"
        return restamped(raw, -self.shift if back else self.shift + self.forged.get(topic, 0))


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


def restamped(raw: bytes, shift: int) -> bytes:
    """Return a serialised message that begins with a stamp, later by `shift` [ns]."""
    seconds, nanoseconds = _STAMP.unpack_from(raw, 4)
    return stamped(raw, seconds * NANOSECONDS + nanoseconds + shift)


def stamped(raw: bytes, stamp: int) -> bytes:
    """Return a serialised message that begins with a stamp, with another one [ns]."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    return raw[:4] + _STAMP.pack(min(max(seconds, -(2**31)), 2**31 - 1), nanoseconds) + raw[12:]


def _ignore(_: bytes) -> None:
    """Stand for the callback of a subscription that is read without an executor."""


def rounded(values: dict[str, float]) -> dict[str, float | None]:
    """Return numbers as JSON can hold them."""
    return {k: round(v, 4) if math.isfinite(v) else None for k, v in values.items()}

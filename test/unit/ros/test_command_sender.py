# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands as ros2_controllers' joint trajectory controller interpolates them."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.ros import cdr
from sphere_nmpc.ros.controller.command_sender import CommandSender

SPEEDS = st.tuples(*[st.floats(-100.0, 100.0)] * 2)


@st.composite
def holds(draw, start: float = 0.0) -> FirstOrderHold:
    gaps = draw(st.lists(st.integers(1_000_000, 1_000_000_000), min_size=1, max_size=40))
    speeds = draw(st.lists(SPEEDS, min_size=len(gaps) + 1, max_size=len(gaps) + 1))
    return FirstOrderHold(start + np.cumsum([0, *gaps]) / 1e9, np.array(speeds))


class Interpolation:
    """Cubics through positions and velocities of a message, as in `Trajectory::sample`.

    Derived from trajectory.cpp of ros2_controllers 4.42.1.
    """

    def __init__(self, raw: bytes) -> None:
        message = deserialize_message(raw, JointTrajectory)
        assert message.joint_names == list(cdr.JOINT_NAMES)
        times = [p.time_from_start.sec + p.time_from_start.nanosec / 1e9 for p in message.points]
        self.start = message.header.stamp.sec + message.header.stamp.nanosec / 1e9
        self._times = self.start + np.array(times)
        self._positions = np.array([p.positions for p in message.points])
        self._velocities = np.array([p.velocities for p in message.points])

    def sample(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return positions [rad] and velocities [rad/s], shape (2,), from the first point on."""
        i = int(np.searchsorted(self._times, time, side="right")) - 1
        if i == self._times.size - 1:
            return self._positions[i], self._velocities[i]
        p, q = self._positions[i : i + 2]
        v, w = self._velocities[i : i + 2]
        length, t = self._times[i + 1] - self._times[i], time - self._times[i]
        square = (3.0 * (q - p) - (2.0 * v + w) * length) / length**2
        cube = (2.0 * (p - q) + (v + w) * length) / length**3
        angle = p + v * t + square * t**2 + cube * t**3
        return angle, v + 2.0 * square * t + 3.0 * cube * t**2


@given(hold=holds(), first=SPEEDS, shares=st.lists(st.floats(0.0, 1.2), min_size=1, max_size=20))
def test_cubics_through_a_trajectory_are_the_first_order_hold(hold, first, shares) -> None:
    followed = Interpolation(cdr.trajectory_message(hold, np.array(first)))
    for share in shares:
        time = share * hold.end
        # The angles are below 4000 rad, in which doubles resolve 5e-13; it is divided by 1e-3 s.
        np.testing.assert_allclose(followed.sample(time)[1], hold.at(time), rtol=0.0, atol=1e-8)


class Node:
    """Node whose publishers keep what is published."""

    def __init__(self) -> None:
        self.published: dict[str, list[bytes]] = {}

    def create_publisher(self, _type: type, topic: str, _depth: int) -> SimpleNamespace:
        return SimpleNamespace(publish=self.published.setdefault(topic, []).append)

    def create_timer(self, _period: float, _callback: object) -> None:
        pass


@given(first=holds(), start=st.floats(0.0, 1.5), second=holds())
def test_angles_go_on_from_those_of_the_command_that_is_replaced(first, start, second) -> None:
    node = Node()
    sender = CommandSender(node, 100.0, lambda: 0.0)
    at = round(start * first.end, 9)
    for hold in (first, second.delayed(at), first.delayed(100.0)):
        sender.send(hold, 0)
    messages = [Interpolation(raw) for raw in node.published["rotor_trajectory"]]
    for replaced, new in pairwise(messages):
        expected, _ = replaced.sample(new.start)
        # As above, and a start that is rounded to nanoseconds.
        np.testing.assert_allclose(new.sample(new.start)[0], expected, rtol=0.0, atol=1e-6)

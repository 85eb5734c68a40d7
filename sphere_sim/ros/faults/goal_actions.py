# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of goals: too frequent, too far away or malformed."""

import math
import time

import numpy as np
from geometry_msgs.msg import PoseStamped

from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import Vector, upright_state
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_sim.ros.faults.action import Action
from sphere_sim.ros.faults.fault_session import RADIUS, FaultSession

_BURST = 0.01
"""Wall time between two goals of a burst [s]."""
_PERIOD = 0.2
"""Wall time between two goals of other kinds [s]."""


def random_goal(rng: np.random.Generator, reach: float = 2.0) -> Vector:
    """Return a goal, shape (6,), with |x|, |y| <= `reach` [m] and any orientation."""
    quaternion = random_quaternion(rng)
    return np.concatenate((rng.uniform(-reach, reach, 2), quaternion))


def upright_goal(rng: np.random.Generator, reach: float = 2.0) -> Vector:
    """Return a goal, shape (6,), likewise, of an upright orientation with any heading."""
    yaw = rng.uniform(-math.pi, math.pi)
    x, y = rng.uniform(-reach, reach, 2)
    return upright_state(x, y, yaw)


class BadGoals(Action):
    """A second publisher of goals.

    Parameters
    ----------
    kind : str
        burst (valid goals at 100 Hz), unreachable or malformed.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._sent = -math.inf
        self._count = 0

    def begin(self, session: FaultSession) -> None:
        """Create the publisher and wait for a subscriber."""
        self._publisher = session.node.create_publisher(PoseStamped, "goal_pose", 1)
        subscribers = self._publisher.get_subscription_count
        session.wait(lambda: subscribers() > 0, 10.0, "a subscriber of goal_pose")

    def keep_on(self, session: FaultSession) -> None:
        """Send the next goal when it is due."""
        period = _BURST if self._kind == "burst" else _PERIOD
        if time.monotonic() >= self._sent + period:
            self._sent = time.monotonic()
            self._publisher.publish(self._next(session.rng))
            self._count += 1

    def end(self, session: FaultSession) -> None:
        """Destroy the publisher."""
        session.node.destroy_publisher(self._publisher)

    def _next(self, rng: np.random.Generator) -> PoseStamped:
        goal = random_goal(rng)
        if self._kind == "unreachable":
            goal[:2] = rng.choice([1e5, 1e9, 1e150, 1e300, -1e308], size=2)
        message = pose_to_ros(goal, 0, RADIUS)
        if self._kind == "malformed":
            broken = self._count % 4
            if broken == 0:
                message.pose.position.x = math.nan
            elif broken == 1:
                message.header.frame_id = "map"
            elif broken == 2:
                message.pose.orientation.w = math.inf
            else:
                message = PoseStamped()
                message.pose.orientation.w = 0.0
        return message

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A second publisher of poses, which disagrees with the first."""

import copy
import time

from geometry_msgs.msg import PoseStamped

from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.ros.messages import pose_to_ros, stamp_from_ros
from sphere_sim.ros.faults.action import Action
from sphere_sim.ros.faults.fault_session import RADIUS, FaultSession
from sphere_sim.ros.faults.goal_actions import random_goal


class SecondPoses(Action):
    """Poses of another place or another sphere, at a random time after each of the sphere.

    Parameters
    ----------
    offset : float, optional
        Distance along x of the poses from those of the sphere [m]; 0 for another sphere, within
        2 m and in any orientation.
    """

    def __init__(self, offset: float = 0.0) -> None:
        self._offset = offset

    def begin(self, session: FaultSession) -> None:
        """Create the publisher."""
        self._other = pose_to_ros(random_goal(session.rng), 0, RADIUS)
        self._seen: PoseStamped | None = None
        self._due: float | None = None
        self._after = 0.0
        self._publisher = session.node.create_publisher(PoseStamped, "pose", 10)

    def keep_on(self, session: FaultSession) -> None:
        """Publish a pose when it is due: between the newest one of the sphere and the next."""
        newest, settings = session.proxy.newest, session.settings
        if newest is not self._seen:
            # Sometimes just before a sampling instant, at which the newest pose counts.
            self._after = session.rng.uniform() / settings.rate
            self._seen, self._due = newest, time.monotonic() + self._after / settings.pace
        if newest is None or self._due is None or time.monotonic() < self._due:
            return
        self._due = None
        second = copy.deepcopy(newest if self._offset else self._other)
        second.header.frame_id = newest.header.frame_id
        stamp = stamp_from_ros(newest.header.stamp) + round(NANOSECONDS * self._after)
        second.header.stamp = session.proxy.shifted(stamp)
        second.pose.position.x += self._offset
        self._publisher.publish(second)

    def end(self, session: FaultSession) -> None:
        """Destroy the publisher."""
        session.node.destroy_publisher(self._publisher)

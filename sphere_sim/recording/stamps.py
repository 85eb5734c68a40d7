# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stamp and state of messages as a bag decodes them."""

from typing import Any

NANOSECONDS = 1_000_000_000


def stamp_of(message: Any) -> int:
    """Return the stamp [ns] of a message with a header."""
    return int(message.header.stamp.sec) * NANOSECONDS + int(message.header.stamp.nanosec)


def state_of(message: Any) -> list[float]:
    """Return x, y [m; world frame] and the quaternion wxyz of a stamped pose, as it is told."""
    place, turn = message.pose.position, message.pose.orientation
    return [float(it) for it in (place.x, place.y, turn.w, turn.x, turn.y, turn.z)]

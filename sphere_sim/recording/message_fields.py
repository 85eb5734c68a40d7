# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Fields of messages as ``rosbags`` decodes them."""

from typing import Any

from sphere_nmpc.quantity import NANOSECONDS

LARGEST = 1e30
"""Largest magnitude of a number that is believed [SI units]: its square is one, too."""


def stamp_of(message: Any) -> int:
    """Return the stamp [ns] of a message with a header."""
    return int(message.header.stamp.sec) * NANOSECONDS + int(message.header.stamp.nanosec)


def known(number: float) -> float:
    """Return a number of a message; nan, as for an unknown one, where it is beyond `LARGEST`."""
    return float(number) if abs(number) <= LARGEST else float("nan")


def state_of(message: Any) -> list[float]:
    """Return x, y [m; world frame] and the quaternion wxyz of a stamped pose, unchecked."""
    position, orientation = message.pose.position, message.pose.orientation
    return [
        float(value) for value in (
            position.x, position.y, orientation.w, orientation.x, orientation.y, orientation.z
        )
    ]

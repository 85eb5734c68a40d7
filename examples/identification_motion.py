#!/usr/bin/env python3
# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Node that drives the rotors without a controller, so that the motion shows what a robot is.

python examples/identification_motion.py            # a minute, within 2 m for the robot of Table 1
python examples/identification_motion.py 1.15       # commands up to 1.15 of max_rotor_speed

It rests for three seconds, in which noise and biases show, then rolls out and back again and
again, each time to another side, and rests again. Speeds come in steps, so that the drives show
what acceleration they attain; only commands beyond what they attain show their largest speed. A
controller would have to be disabled. The floor has to be level, as nothing holds the sphere.
"""

import sys
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

SEED, LENGTH = 1, 60.0
MAX_ROTOR_SPEED, MAX_ROTOR_ACCELERATION = 100.0, 400.0
"""Limits of the robot as they are given [rad/s, rad/s^2]."""
PACE = 1.0
"""Time in which the robot turns as far as that of Table 1 in a second, 57 / (100 c1 u_max) [s]."""
RATE = 50.0
"""Rate of the commands [Hz]."""


def motion(beyond: float = 1.0) -> tuple[Vector, Vector]:
    """Return times [s], shape (K,), and rotor speeds from then on [rad/s], shape (K, 2).

    The way out, with the opposite speeds in the opposite order, leads back, for any robot: what
    moves a sphere without momentum is how far its rotors turn, and in which order.
    """
    rng = np.random.default_rng(SEED)
    times, speeds, now, first = [0.0], [np.zeros(2)], 3.0 * PACE, True
    while now < (LENGTH - 6.0) * PACE:
        out = rng.uniform(0.4, 0.9, (2, 2)) * rng.choice((-1.0, 1.0), (2, 2)) * MAX_ROTOR_SPEED
        if first and beyond > 1.0:  # each rotor by itself, up to what it attains
            out = np.array(((beyond, 0.0), (0.0, beyond))) * MAX_ROTOR_SPEED
        first = False
        path = [np.zeros(2), *out, np.zeros(2), *-out[::-1], np.zeros(2)]
        for before, speed in pairwise(path):
            times.append(now)
            speeds.append(speed)
            # A step counts from its middle, so that the way back is as long as the way out.
            ramp = float(np.max(np.abs(speed - before))) / MAX_ROTOR_ACCELERATION
            now += (0.6 if speed.any() else 0.1) * PACE + ramp
    return np.array([*times, LENGTH * PACE]), np.array([*speeds, np.zeros(2)])


def main() -> None:
    """Publish the motion in the time of the node."""
    import rclpy
    from rclpy.utilities import remove_ros_args
    from std_msgs.msg import Float64MultiArray

    rclpy.init()
    node = rclpy.create_node("identification_motion")
    publisher = node.create_publisher(Float64MultiArray, "rotor_commands", 10)
    times, speeds = motion(*map(float, remove_ros_args(sys.argv)[1:]))
    began: list[int] = []

    def publish() -> None:
        now = node.get_clock().now().nanoseconds
        if not publisher.get_subscription_count() or not now:
            return
        began.append(now)
        passed = (now - began[0]) / 1e9
        place = int(np.searchsorted(times, passed, side="right")) - 1
        publisher.publish(Float64MultiArray(data=speeds[place].tolist()))
        if passed > times[-1]:
            raise SystemExit

    node.create_timer(1.0 / RATE, publish)
    try:
        rclpy.spin(node)
    except (SystemExit, KeyboardInterrupt):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()

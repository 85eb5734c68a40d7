# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Detection of a step between two poses that no rolling explains: the sphere has been carried.

So it is after a reset of the simulator, and where an estimator corrects its pose. Taken for
rolling, the step would be explained by a push.
"""

import math

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, angle_error, position_error
from sphere_nmpc.settings import ControllerSettings

_FASTEST = 10.0
"""Rate of the shell that a push may cause, over the largest that the rotors cause [-]."""
_SMALLEST = 0.1
"""Turn of the shell [rad], and displacement in radii, that noise may be without being told."""
_NOISE_FACTOR = 8.0
"""Standard deviations of a measured pose [-] within which a step may be noise."""


def impossible_step(
    before: Vector, after: Vector, elapsed: float, robot: RobotParameters,
    settings: ControllerSettings,
) -> str:
    """Return what is wrong with the step between two poses, in words; empty if nothing is.

    Parameters
    ----------
    before, after : ndarray, shape (6,)
        Measured states.
    elapsed : float
        Time between them [s].
    robot : RobotParameters
        Robot as built: its radius, and the speed that its rotors can give it.
    settings : ControllerSettings
        Noise of the poses.
    """
    rate = math.sqrt(2.0) * robot.lumped.input_gain * robot.max_rotor_speed
    turn = _FASTEST * rate * elapsed + _SMALLEST
    way = robot.shell_radius * turn + _NOISE_FACTOR * settings.pose_position_noise
    turn += _NOISE_FACTOR * settings.pose_orientation_noise
    moved, turned = position_error(before, after), angle_error(before, after)
    if moved <= way and turned <= turn:
        return ""
    return (
        f"given a step of {moved:.3g} m and {math.degrees(turned):.3g} deg within {elapsed:.3g} "
        f"s, expected at most {way:.2g} m and {math.degrees(turn):.2g} deg; poses and plans "
        "before it are dropped"
    )

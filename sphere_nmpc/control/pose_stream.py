# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Gate for measured poses: outliers, and jumps of the pose."""

import math

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, angle_error
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import ControllerSettings

_MAX_RATE_RATIO = 10.0
"""Rate of the shell that a push may cause, over the largest that the rotors cause [-]."""
_MIN_STEP = 0.1
"""Turn of the shell [rad], and displacement in radii, that noise may be without being reported."""
SAME_POSE_DEVIATIONS = 5.0
"""Standard deviations of a measured pose [-] within which two poses do not differ."""
_MAX_STAMP_ERROR = 0.1
"""Time by which stamps may be wrong [s]: poses that a bridge sends in bunches."""


class PoseGate:
    """Gate for poses to which the sphere cannot have rolled from the newest one.

    Such a pose is held back until the next one shows what it was: an outlier if that follows from
    the pose before, or the place to which the sphere has been carried if it follows from the pose
    held back.

    Parameters
    ----------
    robot : RobotParameters
        Robot as built: its radius and largest rate.
    """

    def __init__(self, robot: RobotParameters) -> None:
        self._radius = robot.shell_radius
        self._rate = math.sqrt(2.0) * robot.lumped.input_gain * robot.max_rotor_speed
        self._held: tuple[float, Vector] | None = None
        self.outliers = self.jumps = 0
        """Poses left out, and jumps of the pose, since the start."""
        self.last_outlier = self.last_jump = ""
        """Descriptions of the newest of these."""

    def check(
        self, time: float, pose: Vector, newest: tuple[float, Vector] | None,
        settings: ControllerSettings,
    ) -> Kind | None:
        """Return what is wrong with a pose, shape (6,), measured at `time` [s]; None if nothing.

        It is `Kind.POSE_LEFT_OUT`, until the next one, or `Kind.POSE_JUMPED`.
        `newest` are time and pose of the newest one before; None without any.
        """
        held, self._held = self._held, None
        step = "" if newest is None else self.impossible_step(newest, time, pose, settings)
        if step and (held is None or self.impossible_step(held, time, pose, settings)):
            self._held = time, pose
        elif step:
            self.jumps += 1
            self.last_jump = f"{step}; poses and plans before it are dropped"
            return Kind.POSE_JUMPED
        if held is not None and newest is not None:
            self.outliers += 1
            step = self.impossible_step(newest, *held, settings)
            self.last_outlier = (
                f"{step}, and the next pose is elsewhere; it is left out: does the source of the "
                "poses lose sight of the sphere, or see another one?"
            )
        return Kind.POSE_LEFT_OUT if self._held else None

    def impossible_step(
        self, before: tuple[float, Vector], time: float, pose: Vector,
        settings: ControllerSettings,
    ) -> str:
        """Return what is wrong with a step to a pose that no rolling explains; else "".

        Taken for rolling, the step would be explained by a push. `before` are time [s] and pose
        from which it leads.
        """
        elapsed = time - before[0]
        turn = self._rate * (_MAX_RATE_RATIO * elapsed + _MAX_STAMP_ERROR) + _MIN_STEP
        way = self._radius * turn + SAME_POSE_DEVIATIONS * settings.pose_position_noise
        turn += SAME_POSE_DEVIATIONS * settings.pose_orientation_noise
        (x, y), (then_x, then_y) = pose[POSITION].tolist(), before[1][POSITION].tolist()
        moved = math.hypot(x - then_x, y - then_y)
        half_cosine = abs(float(before[1][QUATERNION] @ pose[QUATERNION]))
        if moved <= way and half_cosine >= math.cos(0.5 * min(turn, math.pi)):
            return ""
        turned = angle_error(before[1], pose)
        return (
            f"given a step of {moved:.3g} m and {math.degrees(turned):.3g} deg within "
            f"{elapsed:.3g} s, expected at most {way:.2g} m and {math.degrees(turn):.2g} deg"
        )

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings that act in nodes: frame, scheduling, and those of the controller node."""

from dataclasses import dataclass

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.estimation.odometry_settings import OdometrySettings
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.state import DEFAULT_START
from sphere_nmpc.quantities import quantity, validate
from sphere_nmpc.ros.cdr import WORLD_FRAME
from sphere_nmpc.settings import ControllerSettings


@dataclass(frozen=True)
class FrameSettings:
    """Frame that poses and goals are given in."""

    world_frame: str = quantity(
        WORLD_FRAME, "-",
        "Frame of poses, goals and plans; those in another frame are refused, those without one "
        "are taken to be in it",
    )

    def __post_init__(self) -> None:
        validate(self)
        if not self.world_frame or self.world_frame.startswith("/"):  # tf2 refuses both
            raise InvalidParameterError(
                "world_frame", self.world_frame, "a name that begins without /"
            )


@dataclass(frozen=True)
class SchedulingSettings:
    """Scheduling of the threads of a node."""

    thread_priority: int = quantity(
        0, "-",
        "Real-time priority (SCHED_FIFO) while time runs with the wall clock; 0 is ordinary "
        "scheduling",
        minimum=0, maximum=99, live=True,
    )

    def __post_init__(self) -> None:
        validate(self)


@dataclass(frozen=True)
class ControllerNodeSettings(ControllerSettings):
    """Settings of the controller, and of its node: commands, lockstep and the stored goal."""

    goal_memory: float = quantity(
        0.0, "s",
        "Time after the end of a controller within which a new one resumes its goal; 0 is never",
        minimum=0.0, maximum=3600.0,
    )
    goal_orientation: str = quantity(
        "full", "-",
        "What goals on goal_pose and goals demand of the orientation: all, all but a turn about "
        "the vertical, or nothing, as goals on goal_point always do",
        choices=[kind.value for kind in Orientation], live=True,
    )
    path_end_orientation: str = quantity(
        "any", "-",
        "What a path demands of the orientation at its end: nothing, or of that of its last pose "
        "all but a turn about the vertical, or all; the sphere turns after the path",
        choices=[kind.value for kind in Orientation], live=True,
    )
    command_rate: float = quantity(
        100.0, "Hz", "Rate of rotor_commands", minimum=1.0, maximum=1000.0
    )
    lockstep: bool = quantity(
        False, "-", "Solve when the pose of the sampling instant arrives, not when a timer fires"
    )


@dataclass(frozen=True)
class OdometryNodeSettings(OdometrySettings):
    """Settings of the odometry, and of its node: the stored pose, and frames."""

    initial_state: tuple[float, ...] = quantity(
        DEFAULT_START, "m, -",
        "Pose at the start: x, y, then the quaternion w, x, y, z, by default that of the "
        "simulator; a tilt that gravity contradicts is replaced by the measured one",
        minimum=-1e6, maximum=1e6,
    )
    pose_memory: float = quantity(
        30.0, "s",
        "Time after the end of an odometry within which a new one begins with its last pose, if "
        "the sphere rested, rather than at initial_state; 0 is never",
        minimum=0.0, maximum=3600.0,
    )

    frame_prefix: str = quantity(
        "", "-", "Prefix of base_link in frame names; if empty, the node's namespace"
    )
    robot_description: str = quantity(
        "", "-",
        "Robot as URDF, as robot_state_publisher has it: the IMU is mounted where the frame of "
        "its messages is; if empty, as imu.position and imu.orientation say",
    )

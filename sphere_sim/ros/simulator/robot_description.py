# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Model of the robot that the simulator would have with the same ROS arguments, as URDF.

`main` is the program of a child process: rcl itself finds out which parameters of a file are those
of this node.
"""

import sys
from collections.abc import Sequence

import rclpy

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros.parameters import Parameters
from sphere_nmpc.ros.startup import start_ros
from sphere_sim.world.robot_description import make_urdf


def main(args: Sequence[str]) -> int:
    """Print the model for ``--ros-args ...``; return 0, or 2 after one line on what is wrong."""
    try:
        start_ros(list(args))
        node = rclpy.create_node(
            "simulator", automatically_declare_parameters_from_overrides=True,
            enable_rosout=False, start_parameter_services=False,
        )
        robot = Parameters(node).declare(RobotParameters(), "robot").settings
    except (SphereNmpcError, ValueError, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    print(make_urdf(robot), end="")
    return 0

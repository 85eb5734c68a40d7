# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Model of the robot that the simulator would have with the same ROS arguments, as URDF and MJCF.

`main` is the program of a child process: rcl itself finds out which parameters of a file are those
of this node.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import rclpy

from sphere_nmpc.errors import InvalidParameterError, SphereNmpcError
from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros.parameters import Parameters
from sphere_nmpc.ros.startup import start_ros
from sphere_sim.output.files import write_atomically
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rigid_body.mjcf import make_mjcf
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.robot_description import MOCK, Hardware, make_urdf, mujoco_hardware


def main(args: Sequence[str]) -> int:
    """Print the URDF for ``[OPTION ...] --ros-args ...``, and write the MJCF if it is wanted.

    Return 0, or 2 after one line on what is wrong.
    """
    words = list(args)
    at = words.index("--ros-args") if "--ros-args" in words else len(words)
    given = _parse(words[:at])
    try:
        start_ros(words[at:])
        node = rclpy.create_node(
            "simulator", automatically_declare_parameters_from_overrides=True,
            enable_rosout=False, start_parameter_services=False,
        )
        declare = Parameters(node).declare
        robot = declare(RobotParameters(), "robot").settings
        imu = declare(ImuSettings(), "imu").settings
        if given.mjcf is not None:
            body = declare(RigidBodySettings(), "rigid_body").settings
            if body.floor_roughness:
                raise InvalidParameterError(
                    "rigid_body.floor_roughness", body.floor_roughness,
                    "0: the model in a file has a level floor",
                )
            disturbances = declare(DisturbanceSettings()).settings
            model = make_mjcf(
                robot, body.for_robot(robot), disturbances, for_ros2_control=True, imu=imu
            )
            write_atomically(given.mjcf, model)
    except (SphereNmpcError, ValueError, RuntimeError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    print(make_urdf(robot, _hardware(given), imu), end="")
    return 0


def _hardware(given: argparse.Namespace) -> Hardware:
    if given.mjcf is not None:
        return mujoco_hardware(given.mjcf)
    return Hardware(given.hardware, dict(given.parameter)) if given.hardware else MOCK


def _parameter(text: str) -> tuple[str, str]:
    name, assigns, value = text.partition("=")
    if not (name and assigns):
        raise argparse.ArgumentTypeError(f"given {text!r}, expected NAME=VALUE")
    return name, value


def _parse(words: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="robot_description",
        description="Print the URDF of the simulator's robot, whose parameters follow --ros-args. "
        "By default ros2_control has a stand-in for the robot's hardware.",
    )
    choice = parser.add_mutually_exclusive_group()
    choice.add_argument("--hardware", metavar="PLUGIN",
                        help="the robot's own plugin, such as my_robot/Drives")
    choice.add_argument("--mjcf", type=Path, metavar="FILE",
                        help="write the model for MuJoCo, by which mujoco_ros2_control simulates")
    parser.add_argument("--parameter", type=_parameter, action="append", default=[],
                        metavar="NAME=VALUE", help="parameter of the plugin, may be repeated")
    given = parser.parse_args(words)
    if given.parameter and not given.hardware:
        parser.error("argument --parameter: expected --hardware as well")
    return given


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

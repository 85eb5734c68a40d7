# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Model of the robot as URDF, for RViz, ros2_control and other tools."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.output.colours import ROTORS
from sphere_sim.world.plant.rigid_body.bodies import Body, add_element, build_mechanism
from sphere_sim.world.plant.rigid_body.mjcf import IMU, POSE
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings

_NOTICE = """
  Copyright 2026 sphere_nmpc contributors
  SPDX-License-Identifier: Apache-2.0
  Generated from the parameters of the robot; do not edit.
"""

_COLOURS = {
    "shell": "0.7 0.8 0.9 0.25",
    **{
        f"rotor_{i}": " ".join(f"{part / 255.0:.2g}" for part in (*colour, 255))
        for i, colour in enumerate(ROTORS, start=1)
    },
    "counterweight_1": "0.35 0.35 0.35 1",
    "counterweight_2": "0.35 0.35 0.35 1",
}
_MIN_THICKNESS = 1.0 / 15.0
"""Thickness with which rotors are shown, which are flat discs by their inertias, over the radius
of the shell."""


_TURN = tuple(f"orientation.{axis}" for axis in "xyzw")
_SENSORS = {
    IMU: (
        *_TURN, *(f"angular_velocity.{axis}" for axis in "xyz"),
        *(f"linear_acceleration.{axis}" for axis in "xyz"),
    ),
    POSE: (*(f"position.{axis}" for axis in "xyz"), *_TURN),
}
"""State interfaces of sensors: those that the imu_sensor_broadcaster and the pose_broadcaster of
ros2_controllers read."""


@dataclass(frozen=True)
class Hardware:
    """What ros2_control drives the rotors and reads the sensors with."""

    plugin: str = "mock_components/GenericSystem"
    """Class of a system, by default the one that takes each command for the state."""
    parameters: Mapping[str, str] = field(default_factory=dict)
    sensors: tuple[str, ...] = (IMU,)
    """Which of an IMU and a measured pose it has."""
    sensor_types: bool = False
    """Whether the sensors have the parameters by which mujoco_ros2_control knows them."""


MOCK = Hardware(parameters={"calculate_dynamics": "true"})
"""Stand-in that needs no robot: angles are the integral of the commanded speeds."""


def mujoco_hardware(model: Path) -> Hardware:
    """Return the simulation by mujoco_ros2_control of a file of MJCF made for it."""
    parameters = {"mujoco_model": str(model.absolute())}
    return Hardware(
        "mujoco_ros2_control/MujocoSystemInterface", parameters, (IMU, POSE), sensor_types=True
    )


def make_urdf(
    robot: RobotParameters, hardware: Hardware = MOCK, imu: ImuSettings | None = None
) -> str:
    """Return the model of the robot as URDF.

    `base_link` is the body frame at the centre of the shell and has no mass of its own, as
    some tools accept no inertia at the root; the shell and the counterweights are fixed
    to it, `rotor_1_joint` and `rotor_2_joint` turn about its x and y axes. The IMU is
    mounted as in `imu`, by default in its origin.
    """
    limits = RigidBodySettings().for_robot(robot)
    mechanism = build_mechanism(robot, limits.balanced)
    root = ElementTree.Element("robot", name="sphere")
    root.append(ElementTree.Comment(_NOTICE))
    for name, colour in _COLOURS.items():
        add_element(add_element(root, "material", name=name), "color", rgba=colour)
    add_element(root, "link", name="base_link")
    shell = _add_link(root, mechanism.shell)
    _add_shape(shell, "visual", "shell", (0.0, 0.0), "sphere", radius=robot.shell_radius)
    _add_shape(shell, "collision", "", (0.0, 0.0), "sphere", radius=robot.shell_radius)
    _add_joint(root, "shell", np.zeros(3), "fixed")
    for i, rotor in enumerate(mechanism.rotors):
        link = _add_link(root, rotor)
        _add_rotor_shapes(link, rotor, i, _MIN_THICKNESS * robot.shell_radius)
        joint = _add_joint(root, rotor.name, rotor.position, "continuous")
        add_element(joint, "axis", xyz=_text(*np.eye(3)[i]))
        speed = robot.max_rotor_speed
        add_element(joint, "limit", effort=_text(limits.torque_limit), velocity=_text(speed))
    for weight in mechanism.counterweights:
        link = _add_link(root, weight)
        # A ball of steel of that mass.
        radius = (weight.mass / 7850.0 / (4.0 / 3.0 * math.pi)) ** (1.0 / 3.0)
        _add_shape(link, "visual", weight.name, (0.0, 0.0), "sphere", radius=radius)
        _add_joint(root, weight.name, weight.position, "fixed")
    add_element(root, "link", name=IMU)
    mounting = ImuSettings() if imu is None else imu
    _add_joint(root, IMU, np.array(mounting.position), "fixed", _fixed_angles(mounting.turn))
    _add_control(root, hardware, robot.max_rotor_speed)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0"?>\n{text}\n'


def _add_control(root: ElementTree.Element, hardware: Hardware, max_speed: float) -> None:
    """Add the joints and sensors of ros2_control."""
    system = add_element(root, "ros2_control", name="sphere", type="system")
    device = add_element(system, "hardware")
    add_element(device, "plugin").text = hardware.plugin
    _add_parameters(device, hardware.parameters)
    for i in (1, 2):
        joint = add_element(system, "joint", name=f"rotor_{i}_joint")
        command = add_element(joint, "command_interface", name="velocity")
        _add_parameters(command, {"min": _text(-max_speed), "max": _text(max_speed)})
        for name in ("position", "velocity", "effort"):
            state = add_element(joint, "state_interface", name=name)
            _add_parameters(state, {"initial_value": "0.0"})
    for sensor in hardware.sensors:
        element = add_element(system, "sensor", name=sensor)
        if hardware.sensor_types:
            _add_parameters(element, {"mujoco_type": sensor, "mujoco_sensor_name": sensor})
        for name in _SENSORS[sensor]:
            add_element(element, "state_interface", name=name)


def _add_parameters(element: ElementTree.Element, parameters: Mapping[str, str]) -> None:
    for name, value in parameters.items():
        add_element(element, "param", name=name).text = value


def _add_link(root: ElementTree.Element, body: Body) -> ElementTree.Element:
    link = add_element(root, "link", name=body.name)
    inertial = add_element(link, "inertial")
    # The origin of the shell is the centre of the sphere, that of the others the centre of mass.
    centre = body.position if body.name == "shell" else np.zeros(3)
    add_element(inertial, "origin", xyz=_text(*centre), rpy=_text(0.0, 0.0, 0.0))
    add_element(inertial, "mass", value=_text(body.mass))
    full = body.inertia
    add_element(
        inertial, "inertia", ixx=_text(full[0, 0]), ixy=_text(full[0, 1]), ixz=_text(full[0, 2]),
        iyy=_text(full[1, 1]), iyz=_text(full[1, 2]), izz=_text(full[2, 2]),
    )
    return link


def _add_rotor_shapes(
    link: ElementTree.Element, rotor: Body, index: int, min_thickness: float
) -> None:
    """Add the disc that has these inertias, and a bar across it that shows its rotation."""
    axial, transverse = rotor.inertia[index, index], rotor.inertia[2, 2]
    radius = math.sqrt(2.0 * axial / rotor.mass)
    square = 12.0 * transverse / rotor.mass - 3.0 * radius**2
    thickness = max(min_thickness, math.sqrt(max(0.0, square)))
    # The axis of a URDF cylinder is z: turn it onto that of the rotor.
    tilt = (0.0, 0.5 * math.pi) if index == 0 else (0.5 * math.pi, 0.0)
    _add_shape(link, "visual", rotor.name, tilt, "cylinder", radius=radius, length=thickness)
    size = [0.1 * radius, 0.1 * radius, 1.9 * radius]
    size[index] = 1.2 * thickness
    _add_shape(link, "visual", "counterweight_1", (0.0, 0.0), "box", size=size)


def _add_shape(
    link: ElementTree.Element, kind: str, material: str, tilt: tuple[float, float], shape: str,
    **dimensions: float | list[float],
) -> None:
    element = add_element(link, kind)
    add_element(element, "origin", xyz=_text(0.0, 0.0, 0.0), rpy=_text(*tilt, 0.0))
    texts = {
        name: _text(*value) if isinstance(value, list) else _text(value)
        for name, value in dimensions.items()
    }
    add_element(add_element(element, "geometry"), shape, **texts)
    if material:
        add_element(element, "material", name=material)


def _add_joint(
    root: ElementTree.Element, child: str, position: Vector, kind: str,
    angles: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> ElementTree.Element:
    joint = add_element(root, "joint", name=f"{child}_joint", type=kind)
    add_element(joint, "parent", link="base_link")
    add_element(joint, "child", link=child)
    add_element(joint, "origin", xyz=_text(*position), rpy=_text(*angles))
    return joint


def _fixed_angles(turn: Vector) -> tuple[float, ...]:
    """Return the angles about the fixed axes x, y and z [rad] of a matrix, shape (3, 3)."""
    pitch = math.atan2(-turn[2, 0], math.hypot(turn[0, 0], turn[1, 0]))
    roll = math.atan2(turn[2, 1], turn[2, 2])
    # From roll on, which leaves this defined where the pitch is a right angle.
    sine, cosine = math.sin(roll), math.cos(roll)
    yaw = math.atan2(
        sine * turn[0, 2] - cosine * turn[0, 1], cosine * turn[1, 1] - sine * turn[1, 2]
    )
    return roll, pitch, yaw


def _text(*numbers: float) -> str:
    # Adding zero turns -0.0 into 0.0.
    return " ".join(f"{float(number) + 0.0:.9g}" for number in numbers)

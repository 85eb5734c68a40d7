# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""MJCF, the model of robot and floor for MuJoCo, and the heights of a rough floor.

The floor is a random height field, the same for the same seed. SciPy is imported where it is used:
loading takes a third of a second and a plane does not need it.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rigid_body.bodies import Body, add_element, build_mechanism
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.walls import Walls

IMU, POSE = "imu", "pose"
"""Sensors: an IMU fixed in the shell, and the pose of the body."""
_OF_IMU = {"objtype": "site", "objname": IMU}
_OF_BODY = {"objtype": "xbody", "objname": "base_link"}
SENSORS = {
    f"{IMU}_quat": ("framequat", _OF_IMU), f"{IMU}_gyro": ("gyro", {"site": IMU}),
    f"{IMU}_accel": ("accelerometer", {"site": IMU}),
    f"{POSE}_pos": ("framepos", _OF_BODY), f"{POSE}_quat": ("framequat", _OF_BODY),
}
"""MuJoCo's sensors that they consist of, by the names that mujoco_ros2_control looks for."""

_IMPEDANCE_RATIO = 10
"""Ratio of the impedances of friction and normal force [-]."""

_WALL_HEIGHT = 3.0
"""Half the height of a wall [Rs]."""

_FLOOR_BASE = 0.5
"""Thickness of a rough floor under its lowest point [m]."""


_CELLS_PER_WAVELENGTH = 10
_MAX_CELLS = 1000
"""Largest number of cells along one side, so that no settings need gigabytes of memory."""


@dataclass(frozen=True, eq=False)
class RoughFloor:
    """Height field on a square grid about the origin."""

    heights: Vector  # above the lowest point [m], shape (n, n); rows along y, columns along x
    extent: float  # half the side of the square [m]

    @property
    def span(self) -> float:
        """Height of the highest point [m]."""
        return float(self.heights.max())

    def resting_height(self, x: float, y: float, radius: float) -> float:
        """Return the height of the centre of a sphere at x, y that touches the floor [m]."""
        from scipy.ndimage import map_coordinates

        # The field is low, so that the contact is near the lowest point of the sphere.
        reach = min(radius, 2.0 * math.sqrt(2.0 * radius * self.span) + 1e-3)
        offsets = np.linspace(-reach, reach, 121)
        dx, dy = np.meshgrid(offsets, offsets)
        inside = dx**2 + dy**2 < reach**2
        dx, dy = dx[inside], dy[inside]
        cells = self.heights.shape[0] - 1
        scale = cells / (2.0 * self.extent)
        at = np.vstack((y + dy + self.extent, x + dx + self.extent)) * scale
        floor = map_coordinates(self.heights, at, order=1, mode="constant", cval=0.0)
        return float(np.max(floor + np.sqrt(radius**2 - dx**2 - dy**2)))


def make_floor(settings: RigidBodySettings) -> RoughFloor | None:
    """Return a random rough floor, or None for a plane."""
    if settings.floor_roughness == 0.0:
        return None
    from scipy.ndimage import gaussian_filter

    cell = settings.floor_wavelength / _CELLS_PER_WAVELENGTH
    cells = min(_MAX_CELLS, math.ceil(2.0 * settings.floor_extent / cell))
    noise = np.random.default_rng(settings.floor_seed).normal(size=(cells + 1, cells + 1))
    # A Gaussian filter of this width makes bumps at distances of about a wavelength.
    width = settings.floor_wavelength / 4.0 * cells / (2.0 * settings.floor_extent)
    smooth = gaussian_filter(noise, width, mode="wrap")
    heights = smooth * (settings.floor_roughness / smooth.std())
    return RoughFloor(heights - heights.min(), settings.floor_extent)


def make_mjcf(
    robot: RobotParameters, settings: RigidBodySettings, disturbances: DisturbanceSettings,
    floor: RoughFloor | None = None, walls: Walls | None = None, for_ros2_control: bool = False,
    imu: ImuSettings | None = None,
) -> str:
    """Return the model of the robot on its floor.

    The settings are those derived by `for_robot`. The caller puts the heights of a rough floor
    into the compiled model. Walls are boxes, with the same contact as the floor. Actuators and
    joints are in the order rotor 1, rotor 2. The world frame is that of the floor: a slope tilts
    gravity, so that x and y are coordinates in it.

    Of an actuator the control is the slope of the speed reference [rad/s^2], or, for ros2_control,
    the reference itself [rad/s]. The sensors are those of `SENSORS`, the IMU mounted as in `imu`.
    """
    root = ElementTree.Element("mujoco", model="sphere")
    add_element(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true")
    option = add_element(
        root,
        "option",
        timestep=_text(settings.time_step),
        gravity=_text(*disturbances.gravity),
        # Runge-Kutta: with the gyroscopic forces of fast rotors first-order methods drift.
        integrator="RK4",
        cone="elliptic",
        impratio=_text(_IMPEDANCE_RATIO),
    )
    # A diverged state has to be reported, not reset.
    add_element(option, "flag", autoreset="disable")
    if floor is not None:
        add_element(
            add_element(root, "asset"), "hfield", name="floor", nrow=str(floor.heights.shape[0]),
            ncol=str(floor.heights.shape[1]),
            size=_text(floor.extent, floor.extent, floor.span, _FLOOR_BASE),
        )
    world = add_element(root, "worldbody")
    add_element(world, "geom", name="plane", type="plane", size="0 0 1")
    if floor is not None:
        add_element(world, "geom", name="floor", type="hfield", hfield="floor")
    if walls is not None:
        _add_walls(world, walls, robot.shell_radius)
    _add_robot(world, robot, settings, disturbances, ImuSettings() if imu is None else imu)
    actuators = add_element(root, "actuator")
    gain = servo_gain(robot, settings)
    # With an integrator the activation is the speed reference, so that ramps are exact.
    dynamics = "none" if for_ros2_control else "integrator"
    for i in (1, 2):
        add_element(
            actuators, "general", name=f"rotor_{i}_drive", joint=f"rotor_{i}_joint",
            dyntype=dynamics, gainprm=_text(gain), biastype="affine",
            biasprm=_text(0.0, 0.0, -gain),
            forcerange=_text(-settings.torque_limit, settings.torque_limit),
        )
    sensors = add_element(root, "sensor")
    for name, (kind, frame) in SENSORS.items():
        add_element(sensors, kind, name=name, **frame)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def servo_gain(robot: RobotParameters, settings: RigidBodySettings) -> float:
    """Return the torque of a drive over its speed error [N m s].

    The bandwidth is limited to that at which explicit integration of the servo oscillates.
    """
    bandwidth = min(settings.drive_bandwidth, 1.0 / settings.time_step)
    return robot.rotor_axial_inertia * bandwidth


def _add_walls(world: ElementTree.Element, walls: Walls, radius: float) -> None:
    grid = walls.grid
    half_heading = 0.5 * grid.origin[2]
    turn = _text(math.cos(half_heading), 0.0, 0.0, math.sin(half_heading))
    bounds = walls.rectangles.astype(float)
    centres = grid.world(0.5 * (bounds[:, :2] + bounds[:, 2:]))
    halves = 0.5 * grid.resolution * (bounds[:, 2:] - bounds[:, :2])
    for centre, half in zip(centres, halves, strict=True):
        # From well below the floor to well above the sphere.
        add_element(
            world, "geom", type="box", pos=_text(*centre, radius), quat=turn,
            size=_text(*half, _WALL_HEIGHT * radius),
        )


def _add_robot(
    world: ElementTree.Element, robot: RobotParameters, settings: RigidBodySettings,
    disturbances: DisturbanceSettings, imu: ImuSettings,
) -> None:
    mechanism = build_mechanism(robot, settings.balanced, disturbances.mass_offset)
    base = add_element(world, "body", name="base_link", pos=_text(0.0, 0.0, robot.shell_radius))
    add_element(base, "freejoint", name="base_joint")
    _add_inertial(base, mechanism.shell, mechanism.shell.position)
    # Without torsional friction, as in the rolling model, the contact transmits forces alone.
    spinning, rolling = disturbances.torsional_friction, disturbances.rolling_friction
    condim = 6 if rolling > 0.0 else 4 if spinning > 0.0 else 3
    add_element(
        base, "geom", name="shell", type="sphere", size=_text(robot.shell_radius), priority="1",
        condim=str(condim), friction=_text(settings.friction, spinning, rolling),
        solref=_text(settings.contact_time_constant, 1.0),
        solimp=_text(settings.contact_impedance, settings.contact_impedance, 0.001),
    )
    add_element(base, "site", name=IMU, pos=_text(*imu.position), quat=_text(*imu.orientation))
    for i, rotor in enumerate(mechanism.rotors):
        body = add_element(base, "body", name=rotor.name, pos=_text(*rotor.position))
        axis = _text(*np.eye(3)[i])
        add_element(body, "joint", name=f"{rotor.name}_joint", type="hinge", axis=axis)
        _add_inertial(body, rotor, np.zeros(3))
    for weight in mechanism.counterweights:
        body = add_element(base, "body", name=weight.name, pos=_text(*weight.position))
        _add_inertial(body, weight, np.zeros(3))


def _add_inertial(parent: ElementTree.Element, body: Body, position: Iterable[float]) -> None:
    full = body.inertia
    if np.count_nonzero(full - np.diag(np.diag(full))) == 0:
        # MuJoCo accepts a point mass in this form only.
        inertia = {"diaginertia": _text(*np.diag(full))}
    else:
        inertia = {
            "fullinertia": _text(*np.diag(full), full[0, 1], full[0, 2], full[1, 2]),
        }
    add_element(parent, "inertial", pos=_text(*position), mass=_text(body.mass), **inertia)


def _text(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)

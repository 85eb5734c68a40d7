# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""MJCF, the model of robot and floor for MuJoCo."""

from collections.abc import Iterable
from xml.etree import ElementTree

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rigid_body.bodies import Body, build_mechanism
from sphere_sim.world.plant.rigid_body.floor import RoughFloor
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings

_IMPEDANCE_RATIO = 10
"""Ratio of the impedances of friction and normal force [-]."""

_FLOOR_BASE = 0.5
"""Thickness of a rough floor under its lowest point [m]."""


def make_mjcf(
    robot: RobotParameters,
    settings: RigidBodySettings,
    disturbances: DisturbanceSettings,
    floor: RoughFloor | None = None,
) -> str:
    """Return the model of the robot on its floor.

    Parameters
    ----------
    robot : RobotParameters
        True parameters of the robot.
    settings : RigidBodySettings
        Drives, floor, contact and integration, all derived by `for_robot`.
    disturbances : DisturbanceSettings
        Slope, offset of the centre of mass and friction.
    floor : RoughFloor, optional
        Rough floor, whose heights the caller puts into the compiled model; a plane by default.

    Returns
    -------
    str
        MJCF with actuators and joints in the order rotor 1, rotor 2. The world frame is that of
        the floor: a slope tilts gravity, so that x and y are coordinates in the floor.
    """
    root = ElementTree.Element("mujoco", model="sphere")
    _add(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true")
    option = _add(
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
    _add(option, "flag", autoreset="disable")
    if floor is not None:
        _add(
            _add(root, "asset"),
            "hfield",
            name="floor",
            nrow=str(floor.heights.shape[0]),
            ncol=str(floor.heights.shape[1]),
            size=_text(floor.extent, floor.extent, floor.span, _FLOOR_BASE),
        )
    world = _add(root, "worldbody")
    _add(world, "geom", name="plane", type="plane", size="0 0 1")
    if floor is not None:
        _add(world, "geom", name="floor", type="hfield", hfield="floor")
    _add_robot(world, robot, settings, disturbances)
    actuators = _add(root, "actuator")
    gain = servo_gain(robot, settings)
    for i in (1, 2):
        # The activation is the speed reference, the control its slope, so that ramps are exact.
        _add(
            actuators,
            "general",
            name=f"rotor_{i}_drive",
            joint=f"rotor_{i}_joint",
            dyntype="integrator",
            gainprm=_text(gain),
            biastype="affine",
            biasprm=_text(0.0, 0.0, -gain),
            forcerange=_text(-settings.torque_limit, settings.torque_limit),
        )
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def servo_gain(robot: RobotParameters, settings: RigidBodySettings) -> float:
    """Return the torque of a drive over its speed error [N m s].

    The bandwidth is limited to that at which explicit integration of the servo oscillates.
    """
    bandwidth = min(settings.drive_bandwidth, 1.0 / settings.time_step)
    return robot.rotor_axial_inertia * bandwidth


def _add_robot(
    world: ElementTree.Element,
    robot: RobotParameters,
    settings: RigidBodySettings,
    disturbances: DisturbanceSettings,
) -> None:
    mechanism = build_mechanism(robot, settings.balanced, disturbances.mass_offset)
    base = _add(world, "body", name="base_link", pos=_text(0.0, 0.0, robot.shell_radius))
    _add(base, "freejoint", name="base_joint")
    _add_inertial(base, mechanism.shell, mechanism.shell.position)
    # Without torsional friction, as in the rolling model, the contact transmits forces alone.
    spinning, rolling = disturbances.torsional_friction, disturbances.rolling_friction
    condim = 6 if rolling > 0.0 else 4 if spinning > 0.0 else 3
    _add(
        base,
        "geom",
        name="shell",
        type="sphere",
        size=_text(robot.shell_radius),
        priority="1",
        condim=str(condim),
        friction=_text(settings.friction, spinning, rolling),
        solref=_text(settings.contact_time_constant, 1.0),
        solimp=_text(settings.contact_impedance, settings.contact_impedance, 0.001),
    )
    for i, rotor in enumerate(mechanism.rotors):
        body = _add(base, "body", name=rotor.name, pos=_text(*rotor.position))
        axis = _text(*np.eye(3)[i])
        _add(body, "joint", name=f"{rotor.name}_joint", type="hinge", axis=axis)
        _add_inertial(body, rotor, np.zeros(3))
    for weight in mechanism.counterweights:
        body = _add(base, "body", name=weight.name, pos=_text(*weight.position))
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
    _add(parent, "inertial", pos=_text(*position), mass=_text(body.mass), **inertia)


def _add(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _text(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rigid bodies of the robot, from which both MJCF and URDF are written."""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector


@dataclass(frozen=True, eq=False)
class Body:
    """Rigid body; vectors and matrices are in the body frame of the sphere."""

    name: str
    mass: float  # [kg]
    position: Vector  # of the centre of mass [m], shape (3,)
    inertia: Vector  # about the centre of mass [kg m^2], shape (3, 3)


@dataclass(frozen=True, eq=False)
class Mechanism:
    """Shell, rotors and counterweights; rotor i turns about axis i of the body frame.

    Rotors and counterweights are at +d and -d on the body's x and y axes; a counterweight without
    mass is left out.
    """

    shell: Body
    rotors: tuple[Body, ...]
    counterweights: tuple[Body, ...]


def build_mechanism(
    robot: RobotParameters, balanced: bool = True, mass_offset: Sequence[float] = (0.0, 0.0, 0.0),
) -> Mechanism:
    """Return the bodies of Fig. 1.

    Two corrections allow independent errors of the parameters. A rotor whose axial inertia exceeds
    twice the transverse one, which no body has, gets the inertias of a disc, and the difference is
    subtracted from the shell's inertia. As the rotor is rigidly connected to the shell about its
    transverse axes, the motion stays the same. With `balanced` the shell's centre of mass is moved
    so that the common centre of mass is the centre of the sphere; the shell's inertia about the
    centre stays as given. `mass_offset` is how far the common centre of mass is moved beyond that
    [m; body frame], also by the shell's. `InvalidParameterError` is raised if no shell of the
    given mass and inertia allows these corrections.
    """
    rotor = robot.rotor_axial_inertia, robot.rotor_transverse_inertia
    weight = robot.counterweight_axial_inertia, robot.counterweight_transverse_inertia
    discs = [
        _disc(f"{name}_{i + 1}", mass, place * np.eye(3)[i], inertias, np.eye(3)[i])
        for name, mass, place, inertias in (
            ("rotor", robot.rotor_mass, robot.rotor_offset, rotor),
            ("counterweight", robot.counterweight_mass, -robot.rotor_offset, weight),
        )
        for i in range(2)
    ]
    carried = [body for body, _ in discs]
    left = np.sum([excess for _, excess in discs], axis=0)
    trim: Vector = np.zeros(3)
    if balanced:
        moments = [body.mass * body.position for body in carried]
        trim = -np.sum(moments, axis=0) / robot.shell_mass
    if any(mass_offset):
        trim = trim + robot.total_mass / robot.shell_mass * np.asarray(mass_offset)
    # The shell's inertia about the centre stays, where its mass is beside it.
    beside = robot.shell_mass * (trim @ trim * np.eye(3) - np.outer(trim, trim))
    shell_inertia = robot.shell_inertia * np.eye(3) - left - beside
    principal = np.linalg.eigvalsh(shell_inertia)
    if principal[0] <= 0.0 or principal[0] + principal[1] < principal[2]:
        raise InvalidParameterError(
            "shell_inertia", robot.shell_inertia,
            "enough for the bodies inside to be thinner than discs or out of balance "
            f"(left: {principal.tolist()} kg m^2)",
        )
    shell = Body("shell", robot.shell_mass, trim, shell_inertia)
    present = tuple(body for body in carried[2:] if body.mass > 0.0)
    return Mechanism(shell, tuple(carried[:2]), present)


def add_element(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    """Add an element to a model in XML."""
    return ElementTree.SubElement(parent, tag, attributes)


def _disc(
    name: str, mass: float, position: Vector, inertias: tuple[float, float], axis: Vector
) -> tuple[Body, Vector]:
    """Return a body of (axial, transverse) inertias, and by how much they had to be raised."""
    along = np.outer(axis, axis)
    across = np.eye(3) - along
    axial, transverse = inertias
    given = axial * along + transverse * across
    if mass == 0.0:
        # Its inertia, if any, stays with the shell.
        return Body(name, mass, position, np.zeros((3, 3))), -given
    possible = axial * along + max(transverse, 0.5 * axial) * across
    return Body(name, mass, position, possible), possible - given

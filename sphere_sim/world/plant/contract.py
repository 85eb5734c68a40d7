# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Contract between a plant and the simulator: its methods, its quantities, its own settings."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from sphere_nmpc.errors import EndingError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import validate
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.walls import Contact, Walls

T = TypeVar("T", bound="PlantSettings")


class PlantError(EndingError):
    """A plant failed, or has given a quantity that cannot be used."""


class Plant(ABC):
    """Rolling sphere whose rotors follow a speed reference that ramps over each step.

    Base class of plants, which it gives their contact with walls and the disturbances. A class is
    called with ``(robot, state, disturbances=..., walls=...)``, and with ``settings=...`` if it
    has an attribute `Settings`; see `make_plant` of `sphere_sim.world.plant.factory`. It has to
    put the sphere at rest at `state`, and refuses what it does not model by raising an error.
    Poses are position [m] and unit quaternion wxyz, body to world; the world frame is that of the
    floor, also on a slope. Quantities are those at the present instant.

    Parameters
    ----------
    robot : RobotParameters
        The true parameters.
    disturbances : DisturbanceSettings, optional
        Slope, centre of mass and friction; by default none.
    walls : Walls, optional
        The walls; None where there are none.

    Attributes
    ----------
    contact : Contact
        Contact with the walls, which has the motion of the plant (`Contact.is_into_wall`).
    disturbances : DisturbanceSettings
        The present ones.
    """

    def __init__(
        self, robot: RobotParameters, disturbances: DisturbanceSettings | None = None,
        walls: Walls | None = None,
    ) -> None:
        self.disturbances = disturbances or DisturbanceSettings()
        self.contact = Contact(walls, robot.shell_radius)

    @abstractmethod
    def advance(self, speeds_end: Vector, duration: float) -> None:
        """Simulate a step of `duration` [s], more than 0 and at most 0.01.

        The reference of the rotor speeds ramps from that at the end of the step before to
        `speeds_end`, shape (2,) [rad/s], within the limits of the drives.
        """

    @abstractmethod
    def reset(self, state: Vector) -> None:
        """Put the sphere at rest at `state`, shape (6,), with reference and rotor angles 0."""

    @abstractmethod
    def displace(self, state: Vector) -> None:
        """Put the sphere at `state`, shape (6,), keeping its rotors and its momentum."""

    @abstractmethod
    def push(self, impulse: ArrayLike) -> None:
        """Apply a horizontal impulse [N s; world frame], shape (2,), at the centre."""

    def surround(self, walls: Walls | None) -> None:
        """Replace the walls; None where there are none."""
        self.contact.surround(walls)

    def tilt(self, slope: float, direction: float) -> None:
        """Change the inclination of the floor and its downhill direction [rad]."""
        self.disturbances = replace(self.disturbances, slope=slope, slope_direction=direction)

    @property
    def gravity(self) -> Vector:
        """Acceleration of free fall [m/s^2; world frame], shape (3,)."""
        return np.array(self.disturbances.gravity)

    @property
    @abstractmethod
    def state(self) -> Vector:
        """Pose, shape (6,)."""

    @property
    @abstractmethod
    def velocity(self) -> Vector:
        """Velocity of the centre [m/s; world frame], shape (3,)."""

    @property
    @abstractmethod
    def body_rate(self) -> Vector:
        """Angular velocity of the shell [rad/s; body frame], shape (3,)."""

    @property
    @abstractmethod
    def momentum(self) -> Vector:
        """Angular momentum about the contact point [N m s; world frame], shape (3,)."""

    @property
    @abstractmethod
    def rotor_angles(self) -> Vector:
        """Angles of the rotors [rad], shape (2,)."""

    @property
    @abstractmethod
    def rotor_speeds(self) -> Vector:
        """Speeds of the rotors relative to the shell [rad/s], shape (2,)."""

    @property
    @abstractmethod
    def rotor_torques(self) -> Vector:
        """Torques of the drives [N m], shape (2,)."""


@dataclass(frozen=True)
class PlantSettings:
    """Settings that a plant has of its own: none; classes of a plant that has some extend it.

    The quantities of the class are parameters of the simulator node, under the name of the plant,
    and settings of studies.
    """

    def __post_init__(self) -> None:
        validate(self)

    def for_robot(self: T, robot: RobotParameters) -> T:
        """Return the settings with each value that depends on the robot."""
        return self

    def contradiction(self, robot: RobotParameters) -> str | None:
        """Return in one line how the drives fall short of the robot's limits; None if not."""
        return None

    @property
    def torque_limit(self) -> float:
        """Largest torque of a rotor drive [N m]."""
        return math.inf

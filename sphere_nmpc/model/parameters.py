# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Physical parameters of the robot (Table 1 of the paper) and the constants that follow."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.quantities import quantity, validate

_INERTIAS = "axial_inertia", "transverse_inertia", "inertia"
_THIN_DISC_FACTOR = 1.5
"""Factor on the ratio of inertias of a thin disc, which the rotors of Table 1 are: both may be off
by 20 %."""


@dataclass(frozen=True)
class LumpedConstants:
    """Four constants through which all masses and inertias enter the motion.

    They are what remains, with ``m = Mt Rs^2``, when the momentum balance is divided by its
    diagonal, and therefore all that can be identified from the motion.

    Attributes
    ----------
    shell_radius : float
        Rs [m].
    input_gain : float
        c1 = I1 / (It1 + m) [-].
    transverse_ratio : float
        r1 = m / (It1 + m) [-], below 1.
    axial_ratio : float
        r3 = m / (It2 + m) [-], below 1.
    """

    shell_radius: float
    input_gain: float
    transverse_ratio: float
    axial_ratio: float

    def as_array(self) -> NDArray[np.float64]:
        """Return [Rs, c1, r1, r3], shape (4,)."""
        return np.array(
            [self.shell_radius, self.input_gain, self.transverse_ratio, self.axial_ratio]
        )


@dataclass(frozen=True)
class RobotParameters:
    """Masses, lengths, inertias and drive limits of the robot; defaults are Table 1."""

    shell_mass: float = quantity(
        1.0, "kg", "Mass of the spherical shell (M_S)", minimum=1e-3, maximum=1e3
    )
    shell_radius: float = quantity(
        0.3, "m", "Outer radius of the spherical shell (R_S)", minimum=1e-2, maximum=10.0
    )
    shell_inertia: float = quantity(
        0.06, "kg m^2", "Moment of inertia of the shell about a diameter (I_S)",
        minimum=1e-9, maximum=1e3,
    )
    rotor_offset: float = quantity(
        0.15, "m", "Distance of rotors and counterweights from the centre (d)",
        minimum=0.0, maximum=10.0,
    )
    counterweight_mass: float = quantity(
        0.7, "kg", "Mass of each counterweight (M_cw)", minimum=0.0, maximum=1e3
    )
    rotor_mass: float = quantity(
        0.7, "kg", "Mass of each rotor (M_r)", minimum=1e-6, maximum=1e3
    )
    rotor_axial_inertia: float = quantity(
        0.008, "kg m^2", "Inertia of a rotor about its axis of symmetry (I_1)",
        minimum=1e-9, maximum=1e3,
    )
    rotor_transverse_inertia: float = quantity(
        0.004, "kg m^2", "Inertia of a rotor across its axis of symmetry (I_2)",
        minimum=1e-9, maximum=1e3,
    )
    counterweight_axial_inertia: float = quantity(
        0.008, "kg m^2", "Inertia of a counterweight about its axis of symmetry (I_c1)",
        minimum=0.0, maximum=1e3,
    )
    counterweight_transverse_inertia: float = quantity(
        0.004, "kg m^2", "Inertia of a counterweight across its axis of symmetry (I_c2)",
        minimum=0.0, maximum=1e3,
    )
    max_rotor_speed: float = quantity(
        100.0, "rad/s", "Largest rotor speed relative to the shell (u_max)",
        minimum=1.0, maximum=1e4,
    )
    max_rotor_acceleration: float = quantity(
        400.0, "rad/s^2",
        "Largest rotor acceleration; 2 u_max / T of the paper's first-order hold",
        minimum=1.0, maximum=1e6,
    )
    max_rotor_torque: float = quantity(
        0.0, "N m",
        "Largest motor torque that may be planned; lowers the acceleration, 0 is no such limit",
        minimum=0.0, maximum=1e6,
    )

    def __post_init__(self) -> None:
        validate(self)
        if self.rotor_offset >= self.shell_radius:
            raise InvalidParameterError(
                "rotor_offset", self.rotor_offset,
                f"less than shell_radius = {self.shell_radius:g} m, as the rotors are inside",
            )
        for part in ("shell", "rotor", "counterweight"):
            self._check_inertias(part)

    def _check_inertias(self, part: str) -> None:
        """Refuse inertias that no part within the shell can have."""
        most = getattr(self, f"{part}_mass") * self.shell_radius**2
        names = [f"{part}_{kind}" for kind in _INERTIAS if hasattr(self, f"{part}_{kind}")]
        for name in names:
            if getattr(self, name) > most:
                raise InvalidParameterError(
                    name, getattr(self, name),
                    f"at most {most:.3g} kg m^2, {part}_mass times the square of shell_radius",
                )
        if len(names) > 1:
            axial, across = (getattr(self, name) for name in names[:2])
            if axial > 2.0 * _THIN_DISC_FACTOR * across:
                raise InvalidParameterError(
                    names[0], axial,
                    f"at most twice {names[1]} = {across:.3g} kg m^2, as of a thin disc, and half "
                    "as much again for errors of both",
                )

    @property
    def total_mass(self) -> float:
        """Mt = M_S + 2 M_r + 2 M_cw [kg] (Eq. 10)."""
        return self.shell_mass + 2.0 * self.rotor_mass + 2.0 * self.counterweight_mass

    @property
    def transverse_inertia(self) -> float:
        """It1 [kg m^2]: inertia about the body's x or y axis through the centre (Eq. 12)."""
        return self.rotor_axial_inertia + self.counterweight_axial_inertia + self._offset_inertia

    @property
    def axial_inertia(self) -> float:
        """It2 [kg m^2]: inertia about the body's z axis through the centre (Eq. 12)."""
        return 2.0 * self._offset_inertia - self.shell_inertia

    @property
    def _offset_inertia(self) -> float:
        """Shell, one rotor and one counterweight about an axis they are offset from [kg m^2]."""
        square = self.rotor_offset**2
        rotor = self.rotor_transverse_inertia + self.rotor_mass * square
        counterweight = self.counterweight_transverse_inertia + self.counterweight_mass * square
        return rotor + counterweight + self.shell_inertia

    @property
    def rolling_inertia(self) -> float:
        """Mt Rs^2 [kg m^2]: total mass times the squared distance of the contact point."""
        return self.total_mass * self.shell_radius**2

    @property
    def full_torque(self) -> float:
        """Torque that accelerates a rotor by `max_rotor_acceleration` [N m]; 3.2 for Table 1."""
        return self.rotor_axial_inertia * self.max_rotor_acceleration

    @property
    def ramp_time(self) -> float:
        """Time in which a rotor reaches its limit of speed [s]."""
        return self.max_rotor_speed / self.max_rotor_acceleration

    @property
    def lumped(self) -> LumpedConstants:
        """Constants of the driftless model."""
        rolling = self.rolling_inertia
        transverse = self.transverse_inertia + rolling
        axial = self.axial_inertia + rolling
        return LumpedConstants(
            shell_radius=self.shell_radius,
            input_gain=self.rotor_axial_inertia / transverse,
            transverse_ratio=rolling / transverse,
            axial_ratio=rolling / axial,
        )

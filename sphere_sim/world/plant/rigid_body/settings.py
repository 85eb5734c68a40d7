# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the plant ``rigid_body``: drives, floor, contact and integration."""

from dataclasses import dataclass

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.quantity import quantity, validate


@dataclass(frozen=True)
class RigidBodySettings:
    """Effects that the ideal plant does not have; docs/rigid_body.md explains the defaults.

    Raises
    ------
    InvalidParameterError
        If a value is not in its range.
    """

    drive_bandwidth: float = quantity(
        300.0,
        "rad/s",
        "Bandwidth of the rotors' speed servos, cut at 1 / time_step",
        minimum=1.0,
        maximum=1e6,
    )
    drive_feedforward: bool = quantity(
        False,
        "-",
        "Feed the slope of the reference forward, so that the servos follow ramps without lag",
    )
    torque_limit: float = quantity(
        3.2,
        "N m",
        "Largest torque of a rotor drive; the paper's controller needs no more",
        minimum=1e-3,
        maximum=1e6,
    )
    friction: float = quantity(
        0.8,
        "-",
        "Coefficient of sliding friction between shell and floor",
        minimum=1e-3,
        maximum=10.0,
    )
    floor_roughness: float = quantity(
        0.0,
        "m",
        "Standard deviation of the floor's height; 0 is a plane",
        minimum=0.0,
        maximum=0.05,
    )
    floor_wavelength: float = quantity(
        0.5, "m", "Spacing of the bumps of a rough floor", minimum=0.05, maximum=10.0
    )
    floor_extent: float = quantity(
        8.0,
        "m",
        "Half the side of the rough square, centred at the origin",
        minimum=0.5,
        maximum=50.0,
    )
    floor_seed: int = quantity(0, "-", "Seed of the rough floor", minimum=0, maximum=2**31 - 1)
    balanced: bool = quantity(
        True,
        "-",
        "Move the shell's centre of mass so that the common one is the centre of the sphere",
    )
    contact_time_constant: float = quantity(
        0.004,
        "s",
        "Time constant of the contact; shorter is stiffer, at least 2 time_step",
        minimum=1e-4,
        maximum=1.0,
    )
    contact_impedance: float = quantity(
        0.999, "-", "Impedance of the contact; 1 is rigid", minimum=0.1, maximum=0.9999
    )
    time_step: float = quantity(0.002, "s", "Longest integration step", minimum=1e-5, maximum=0.02)

    def __post_init__(self) -> None:
        validate(self)
        if self.contact_time_constant < 2.0 * self.time_step * (1.0 - 1e-9):
            # MuJoCo would soften the contact without a warning.
            raise InvalidParameterError(
                "contact_time_constant",
                self.contact_time_constant,
                f"at least twice time_step = {self.time_step:g} s",
            )

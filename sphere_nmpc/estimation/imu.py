# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Inertial measurement unit in the shell: where it is mounted, and the sizes of its errors."""

import math
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import quantity, validate

GRAVITY_REMOVED = "gravity removed"
_CONVENTIONS = (
    (0.0, 0.8, GRAVITY_REMOVED), (0.8, 1.2, "in g"), (31.5, 32.9, "in ft/s^2"),
    (950.0, 992.0, "in cm/s^2"), (992.0, 1050.0, "in mg"), (9.4e3, 1.02e4, "in mm/s^2"),
    (18.6, 20.6, "gravity added twice"),
    *((0.97 * counts, 1.03 * counts, "in raw counts") for counts in (2048, 4096, 8192, 16384)),
)
"""Norms of the specific force at rest from and to which it is given in another convention."""

@dataclass(frozen=True)
class ImuSettings:
    """Mounting and errors of an IMU; the defaults are those of a MEMS device.

    A reading is the angular velocity [rad/s] and the specific force [m/s^2], which at rest is
    opposite to gravity, both in the axes of the sensor and filtered alike. Errors differ by axis
    and are drawn with these standard deviations; the biases then walk.
    """

    position: tuple[float, ...] = quantity(
        (0.0, 0.0, 0.0), "m", "Place of the IMU in the shell: x, y, z in the body frame",
        minimum=-10.0, maximum=10.0,
    )
    orientation: tuple[float, ...] = quantity(
        (1.0, 0.0, 0.0, 0.0), "-",
        "Quaternion w, x, y, z that takes vectors in the axes of the IMU to the body frame",
        minimum=-1.0, maximum=1.0,
    )
    position_deviation: float = quantity(
        1.5e-3, "m", "Standard deviation of each coordinate of the place", minimum=0.0, maximum=1.0
    )
    orientation_deviation: float = quantity(
        0.01, "rad", "Standard deviation of the mounting about each axis", minimum=0.0,
        maximum=0.5,
    )
    delay: float = quantity(
        -1.0, "s",
        "Time by which readings are later than their stamps, as by the filter of the device; -1: "
        "unknown, half of the time between two readings",
        minimum=-1.0, maximum=1.0,
    )
    gyro_noise: float = quantity(
        1.2e-4, "rad/s/sqrt(Hz)", "Noise density of the gyro; 1.2e-4 is 0.007 deg/s/sqrt(Hz)",
        minimum=0.0, maximum=1.0,
    )
    gyro_bias: float = quantity(
        9e-3, "rad/s", "Standard deviation of the gyro's bias when it is switched on",
        minimum=0.0, maximum=1.0,
    )
    gyro_bias_walk: float = quantity(
        3.5e-5, "rad/s/sqrt(s)", "Random walk of the gyro's bias", minimum=0.0, maximum=1.0
    )
    gyro_scale: float = quantity(
        3e-3, "-", "Standard deviation of the gyro's scale around 1", minimum=0.0, maximum=0.5
    )
    g_sensitivity: float = quantity(
        6e-5, "rad/s per m/s^2",
        "Standard deviation of the gyro's sensitivity to force; 6e-5 is 0.03 deg/s/g",
        minimum=0.0, maximum=0.1,
    )
    cross_axis: float = quantity(
        4e-3, "-", "Standard deviation of what gyro and accelerometer show of another axis",
        minimum=0.0, maximum=0.5,
    )
    gyro_range: float = quantity(
        17.5, "rad/s", "Largest angular velocity about an axis; beyond it the gyro is saturated",
        minimum=0.1, maximum=1e3,
    )
    accelerometer_noise: float = quantity(
        3e-3, "m/s^2/sqrt(Hz)", "Noise density of the accelerometer; 3e-3 is 0.3 mg/sqrt(Hz)",
        minimum=0.0, maximum=10.0,
    )
    accelerometer_bias: float = quantity(
        0.15, "m/s^2", "Standard deviation of the accelerometer's bias; 0.15 is 15 mg",
        minimum=0.0, maximum=10.0,
    )
    accelerometer_bias_walk: float = quantity(
        1e-3, "m/s^2/sqrt(s)", "Random walk of the accelerometer's bias", minimum=0.0, maximum=1.0
    )
    accelerometer_scale: float = quantity(
        3e-3, "-", "Standard deviation of the accelerometer's scale around 1", minimum=0.0,
        maximum=0.5,
    )
    accelerometer_range: float = quantity(
        39.0, "m/s^2", "Largest specific force along an axis", minimum=1.0, maximum=1e4
    )

    def __post_init__(self) -> None:
        validate(self)
        norm = math.hypot(*self.orientation)
        if abs(norm - 1.0) > rotation.NORM_TOLERANCE:
            raise InvalidParameterError(
                "orientation", self.orientation, "a unit quaternion w, x, y, z"
            )

    @property
    def turn(self) -> Vector:
        """Matrix that takes vectors in the axes of the IMU to the body frame, shape (3, 3)."""
        quaternion = np.array(self.orientation)
        return rotation.matrix(quaternion / np.linalg.norm(quaternion))


def convention_of(norm: float) -> str:
    """Return in which other convention a specific force at rest is given, by its norm [m/s^2].

    It is empty where the norm shows none.
    """
    return next((name for least, most, name in _CONVENTIONS if least <= norm < most), "")

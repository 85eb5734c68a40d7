# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Poses of a simulated run from an odometry, which has IMU and encoders alone."""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry_settings import OdometrySettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import NANOSECONDS
from sphere_sim.evaluation.metrics import estimate_errors
from sphere_sim.evaluation.series import Series
from sphere_sim.world.imu_sensor import ImuReading, ImuSensor
from sphere_sim.world.simulator import Simulator


class OdometryPoses:
    """Odometry that reads the IMU of a simulator, and knows at which pose the run starts.

    It is calibrated with what the IMU measured before the run, while the sphere was at rest.
    `robot` has the parameters that the odometry has, which are not the true ones.
    """

    def __init__(
        self, simulator: Simulator, imu: ImuSensor, settings: OdometrySettings,
        robot: RobotParameters,
    ) -> None:
        start = simulator.plant.state
        settings = replace(settings, initial_state=tuple(start.tolist()))
        self._simulator = simulator
        self.odometry = Odometry(settings, imu.settings, robot)
        # The calibration ends with an interval, behind which a reading of the encoders is needed.
        self._take(imu.at_rest(settings.calibration_time + 0.2, simulator.plant))
        self._take(simulator.imu_readings())

    def _take(self, readings: Iterable[ImuReading]) -> None:
        for reading in readings:
            time = reading.stamp / NANOSECONDS
            self.odometry.observe_imu(time, reading.rate, reading.force)
            self.odometry.observe_rotors(time, reading.speeds, reading.angles)

    def __call__(self) -> list[tuple[int, Vector]]:
        """Return stamp [ns] and pose, shape (6,), of the newest reading."""
        self._take(self._simulator.imu_readings())
        found = self.odometry.estimate
        return [] if found is None else [(round(found.time * NANOSECONDS), found.pose)]

    def errors(self) -> tuple[float, float]:
        """Return how far position [m] and heading [deg] are from the true ones at present."""
        found = self()
        if not found:
            return math.nan, math.nan
        now, true = np.zeros(1), self._simulator.plant.state
        estimate = Series(now, found[-1][1][None])
        distance, heading = estimate_errors(estimate, Series(now, true[None]))[0]
        return float(distance), abs(math.degrees(heading))

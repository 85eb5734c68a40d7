# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Status of the odometry: which messages of its sensors can be used, how old they are, values."""

import math
from collections.abc import Sequence
from typing import Any

from sphere_nmpc.errors import Description, InvalidInputError
from sphere_nmpc.estimation.odometry.odometry import Odometry
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.reporting.conditions import Condition
from sphere_nmpc.reporting.recent import Recent
from sphere_nmpc.reporting.stamps import OTHER_CLOCK_AGE, StampWatch
from sphere_nmpc.settings import ControllerSettings

MOST_AHEAD = ControllerSettings().pose_timeout
"""Age of a reading at which its stamp is of another clock, and how far ahead it may be [s]."""


class SensorStream(StampWatch):
    """Stamps of the messages of a sensor [ns]; `now` is what the clock of the node shows."""

    def __init__(self, plural: str) -> None:
        super().__init__(plural)
        self._steps = Recent()
        self._newest_stamp = 0
        self._outdated = -1
        self._seen = 0

    def begin_anew(self, now: int) -> None:
        """Leave out what was measured until now, which may not have been received yet."""
        self._outdated, self._newest_stamp = now, 0

    def accepts(self, stamp: int, measured: Vector, now: int, is_simulated: bool) -> bool:
        """Record a message; return whether its stamp may be a time of measurement.

        It is 0 where a driver does not set it, and at the start of simulated time. One ahead of
        the clock, which would make all before it outdated, is refused; one of another kind of
        clock is left out.
        """
        age = (now - stamp) / NANOSECONDS
        if age < -OTHER_CLOCK_AGE or stamp <= self._outdated:
            return False
        if age < -MOST_AHEAD:
            given = Description(f"{-age:.6g} s ahead of this node's clock")
            raise InvalidInputError(
                "stamp", given, f"at most {MOST_AHEAD:g} s ahead; are the clocks synchronised?"
            )
        self.received(stamp / NANOSECONDS, measured)
        if stamp > self._newest_stamp:
            if self._newest_stamp:
                self._steps.append((stamp - self._newest_stamp) / NANOSECONDS)
            self._newest_stamp = stamp
        return bool(stamp) or (is_simulated and now < MOST_AHEAD * NANOSECONDS)

    def heard_until(self, now: int) -> int:
        """Return the stamp up to which messages have come; `now`, if none since the last call.

        Others may wait behind the newest one where the machine is busy.
        """
        before, self._seen = self._seen, self._newest_stamp
        return self._newest_stamp if self._newest_stamp > before else now

    @property
    def rate(self) -> float:
        """Mean rate of the newest messages [Hz]; nan where there are none."""
        return 1.0 / self._steps.mean

    def age_at(self, now: int) -> float:
        """Return the age of the newest message [s]; infinite without any."""
        newest = self._newest_stamp
        return (now - newest) / NANOSECONDS if newest else math.inf


def status_values(
    odometry: Odometry, imu: SensorStream, joints: SensorStream, now: int,
    conditions: Sequence[Condition],
) -> dict[str, Any]:
    """Return the values at a stamp [ns], with the names of the conditions that are reported."""
    estimate = odometry.estimate
    position = heading = math.nan
    if estimate is not None:
        position, heading, _ = estimate.deviations
    return {
        "calibrated": odometry.is_calibrated,
        "calibration": odometry.calibration,
        "gyro_bias_rad_s": odometry.gyro_bias.round(7).tolist(),
        "position_deviation_m": position,
        "heading_deviation_deg": math.degrees(heading),
        "imu_age_s": imu.age_at(now),
        "imu_rate_hz": imu.rate,
        "joint_states_rate_hz": joints.rate,
        "fixes_used": odometry.fixes_used,
        "fixes_left_out": odometry.fixes_left_out,
        "conditions": ", ".join(one.name for one in conditions),
    }

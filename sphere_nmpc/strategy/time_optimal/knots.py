# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Knots of plans: their spacing for a robot, and where there are more or fewer of them.

The speeds between knots are linear, so that a knot that is added changes nothing.
"""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector

_FINE_KNOT_RATIO = 4
"""Knots near both ends of a plan for each one elsewhere."""
_FINE_SPAN = 4.0
"""Time near both ends in which there are so many [of the spacing]."""
_MANOEUVRE_TIME = 3.0
"""Time in which a plan leads into steady rolling [1 / (c1 u_max)], apart from ramps."""
_MIN_INTERVAL = 1e-3
"""Shortest interval [of the spacing]: a knot that is nearer is left out."""


@dataclass(frozen=True)
class Grid:
    """Spacing of knots.

    Attributes
    ----------
    unit : float
        Unit of time of the robot, 1 / (c1 u_max) [s].
    spacing : float
        Spacing of the knots [s].
    """

    unit: float
    spacing: float

    @classmethod
    def of(cls, robot: RobotParameters, spacing: float) -> "Grid":
        """Return the grid of a robot; `spacing` is in its unit of time."""
        unit = 1.0 / (robot.lumped.input_gain * robot.max_rotor_speed)
        return cls(unit, max(spacing * unit, 0.5 * robot.ramp_time))

    @property
    def fine(self) -> float:
        """Spacing near both ends, and the longest integration step of a plan [s]."""
        return self.spacing / _FINE_KNOT_RATIO

    def coarse(self, duration: float) -> Vector:
        """Return times from 0 to `duration` [s], about `spacing` apart."""
        count = max(2, round(duration / self.spacing))
        return np.linspace(0.0, duration, count + 1, dtype=np.float64)

    def refined(self, hold: FirstOrderHold) -> FirstOrderHold:
        """Return a hold, from time 0 on, with fine knots near both ends, else `spacing` apart.

        Intervals of steady rolling, which are longer, are kept.
        """
        end, span = hold.end, _FINE_SPAN * self.spacing
        added = [hold.times]
        for before, after in zip(hold.times[:-1], hold.times[1:], strict=True):
            is_near = min(before, end - after) < span
            spacing = self.fine if is_near else self.spacing
            if after - before < 2.0 * span:
                count = max(1, round((after - before) / spacing))
                added.append(before + (after - before) * np.arange(1, count) / count)
        times = np.sort(np.concatenate(added))
        return hold.resampled(times)

    def split(self, hold: FirstOrderHold) -> FirstOrderHold:
        """Return a hold in which only intervals after a manoeuvre are long."""
        times, until = hold.times, hold.start + _MANOEUVRE_TIME * self.unit + 4.0 * self.spacing
        long = np.flatnonzero((hold.durations > 2.0 * self.spacing) & (times[:-1] < until))
        if not long.size:
            return hold
        added = [times]
        for i in long:
            last = min(until, times[i + 1] - self.spacing)
            added.append(np.arange(times[i] + self.spacing, last, self.spacing))
        return hold.resampled(np.sort(np.concatenate(added)))

    def thinned(self, hold: FirstOrderHold) -> FirstOrderHold:
        """Return a hold without the knots that are very near to the one before them."""
        near = hold.durations < _MIN_INTERVAL * self.spacing
        if not near.any() or near.size == 1:
            return hold
        kept = np.concatenate(([True], ~near[:-1], [True]))
        if near[-1] and near.size > 1:
            kept[-2] = False
        return FirstOrderHold(hold.times[kept], hold.speeds[kept])

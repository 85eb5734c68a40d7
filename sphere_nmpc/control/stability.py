# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitor of the decrease that Theorem 3 concludes, Eq. (42), along the closed loop.

For each transition from sample k to k + 1 under the input u(k+1) it reports whether

    V*(k+1) - V*(k) <= -l(x(k), u(k+1)),   l = |x - x_d|^2 + alpha |u|^2.         (Eq. 42)

With an exact model V*(k) - l(x(k), u(k+1)) is the cost of the knots that are left, an upper bound
of V*_(N-1)(k+1) and equal to it if these are optimal. So this is Eq. (39) at x(k+1), V*_N <=
V*_(N-1), where the loop meets it.

The premises are not tested. Theorem 3 uses Eqs. (31) and (36) at the end of a predicted horizon,
(37) to (39), where some input has to satisfy them; the input of the present step neither confirms
nor refutes that. Nor are Eqs. (40), which any solution satisfies, and (41).

As Delta is never below -|x - x_d|^2, no input satisfies Eq. (36) where
|x - x_d|^2 < 2 alpha u_max^2 / (beta - 1): that ball is taken as the neighbourhood D of Remark 5.
With the paper's numbers its radius is 1e-2.
"""

import math
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.state import Vector


@dataclass(frozen=True, eq=False)
class Sample:
    """Quantities of the monitor at a sampling instant."""

    time: float
    """Control time [s]."""
    state: Vector
    """State x(k), shape (6,)."""
    goal: Vector
    """Goal x_d with the quaternion sign that the plan tracks, shape (6,)."""
    value: float
    """Optimal cost V*(k) in the units of Eq. (24); nan where the solve failed."""
    next_input: Vector
    """Rotor speeds u(k+1) at the next sampling instant [rad/s], shape (2,)."""
    weights: tuple[float, float, float]
    """Alpha [s^2/rad^2], beta [-], above 1, and the largest rotor speed u_max [rad/s]."""

    @property
    def square_error(self) -> float:
        """|x - x_d|^2 [mixed units]."""
        return float(np.sum((self.state - self.goal) ** 2))

    @property
    def stage_cost(self) -> float:
        """l(x(k), u(k+1)) (Eq. 34)."""
        return self.square_error + self.weights[0] * float(np.sum(self.next_input**2))

    @property
    def inside(self) -> bool:
        """Whether the state is in the neighbourhood D of Remark 5."""
        return math.sqrt(self.square_error) < neighbourhood_radius(*self.weights)


@dataclass(frozen=True)
class StabilityReport:
    """Assessment of the transition that led to the newest sample."""

    value_change: float
    """Change V*(k+1) - V*(k); nan for the first sample at a goal."""
    allowed_change: float
    """Largest change that Eq. (42) allows, -l(x(k), u(k+1)); nan likewise."""
    inside: bool
    """Whether the newest state is in the neighbourhood D of Remark 5."""
    judged: int
    """Transitions assessed since the start: those that began outside D."""
    violations: int
    """Number of these that violated Eq. (42)."""
    not_nearer: int
    """Number of these with |x(k+1) - x_d| >= |x(k) - x_d|, which violates nothing."""


def neighbourhood_radius(input_weight: float, terminal_weight: float, max_speed: float) -> float:
    """Return the radius of D [mixed units]: inside, no input satisfies Eq. (36)."""
    if terminal_weight <= 1.0:
        return math.inf
    return math.sqrt(2.0 * input_weight / (terminal_weight - 1.0)) * max_speed


class StabilityMonitor:
    """Monitor of a closed loop, called once per sample period; it never raises while running.

    A new goal or new weights make another value function: that transition is not assessed.
    """

    def __init__(self) -> None:
        self._last: Sample | None = None
        self._judged = 0
        self._violations = 0
        self._not_nearer = 0

    def update(self, sample: Sample) -> StabilityReport:
        """Take the newest sample and report on the transition that led to it."""
        numbers = (sample.time, sample.value, *sample.state, *sample.goal, *sample.next_input)
        usable = all(math.isfinite(number) for number in numbers)
        last, self._last = self._last, sample if usable else None
        change = allowed = float("nan")
        comparable = last is not None and (
            sample.time > last.time
            and sample.weights == last.weights
            and np.array_equal(sample.goal, last.goal)
        )
        if last is not None and usable and comparable:
            change, allowed = sample.value - last.value, -last.stage_cost
            if not last.inside:
                self._judged += 1
                self._violations += int(change > allowed)
                self._not_nearer += int(sample.square_error >= last.square_error)
        inside = usable and sample.inside
        return StabilityReport(
            change, allowed, inside, self._judged, self._violations, self._not_nearer
        )

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Learn the four lumped constants of the plant, its lag and its noise from its own motion.

Masses and inertias enter the motion through [Rs, c1, r1, r3] alone. Rotors that follow what is
sent with a first-order lag move the sphere as if all had been sent that much later, to the
second order in the lag; a pose whose stamp is late by a constant looks the same. So the lag is
the fifth unknown. Each pair of poses with the rotor speeds sent in between is a measurement of
all five; the last ones are fitted together by Gauss-Newton least squares with a Gaussian prior
around the values the robot was built to. What the fit cannot explain is the noise.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.estimation.unknowns import SIZE, Unknowns, noticeable
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector, nearer_sign
from sphere_nmpc.solver.roll_out import roll_out

LEAST_NOISE = 1e-5
"""Floor of the noise [m, -]: the prediction's own error over a sample."""
EXCITED = 2.0
"""Rotor speed [rad/s] below which nothing is learnt about the constants."""
JUMP = 0.25
"""A pose further than this from its prediction was moved by something else."""

_WINDOW = 40
_NOISE_WINDOW = 20
_STEP = 0.05
_DIFFERENCE = 1e-5
_SHORTEST_PIECE = 1e-9
_SETTLED = 1e-5
_ROUNDS = 6
_STILL_LINEAR = 3e-3
"""Change, in standard deviations of the prior, up to which a linearisation is kept: what it leaves
out is then below `LEAST_NOISE`, and a lesson costs one transition instead of all of them."""
_FREEDOM = 5
"""Independent components of a state: the quaternion's norm is not one."""
_EXPECTED_NOISE = 1e-4
"""Noise assumed before anything was seen [m, -] ..."""
_EXPECTATION_COUNTS = 5.0
"""... and how many independent residuals that assumption is worth."""


@dataclass(frozen=True, eq=False)
class _Linear:
    """Residual (6,) and Jacobian (6, 5) of a transition where the scaled unknowns were `at`."""

    at: Vector
    residual: Vector
    jacobian: Vector


@dataclass(eq=False)
class _Transition:
    """Two measured states and what was sent in between, from `lead` [s] before the first on."""

    start: Vector
    end: Vector
    times: Vector
    inputs: Vector
    lead: float
    linear: _Linear | None = None

    def window(self, lag: float) -> tuple[Vector, Vector]:
        """Return durations (K,) and speeds (K + 1, 2) that moved the sphere at this lag [s]."""
        begin = self.lead - min(lag, self.lead)
        end = begin + self.times[-1] - self.lead
        inside = (self.times > begin + _SHORTEST_PIECE) & (self.times < end - _SHORTEST_PIECE)
        times = np.concatenate(([begin], self.times[inside], [end]))
        speeds = [np.interp(times, self.times, column) for column in self.inputs.T]
        return np.diff(times), np.column_stack(speeds)


class PlantEstimator:
    """Fit the constants to the newest transitions.

    Parameters
    ----------
    nominal : LumpedConstants
        What the robot was built to: centre of the prior and start of the fit.
    lag : float, optional
        Lag that is expected [s].
    """

    def __init__(self, nominal: LumpedConstants, lag: float = 0.0) -> None:
        self._unknowns = Unknowns(nominal, lag)
        self.jumps = 0
        """Transitions left out as something else had moved the robot."""
        self.reset()

    def reset(self) -> None:
        """Forget everything learnt."""
        self._scale: Vector = self._unknowns.centre.copy()
        self._covariance: Vector = np.diag(self._unknowns.spread**2)
        self._transitions: deque[_Transition] = deque(maxlen=_WINDOW)
        self._residuals: deque[Vector] = deque(maxlen=_NOISE_WINDOW)

    @property
    def constants(self) -> LumpedConstants:
        """The constants as believed now."""
        return self._unknowns.lumped(self._scale)

    @property
    def lag(self) -> float:
        """How far the motion lags behind what is sent [s]; 0 where it is too short to matter."""
        return noticeable(self._unknowns.lag(self._scale))

    @property
    def standard_deviation(self) -> Vector:
        """Uncertainty of [Rs, c1, r1, r3] in their own units, shape (4,)."""
        deviation = self._unknowns.constants(np.sqrt(np.diag(self._covariance)))
        return deviation

    @property
    def noise(self) -> float:
        """What the fit leaves over: standard deviation of each state a sample [m, -]."""
        return float(np.sqrt(_variance(list(self._residuals), 0)))

    def observe(
        self,
        start: Vector,
        end: Vector,
        durations: Vector,
        inputs: Vector,
        lead: float = 0.0,
    ) -> None:
        """Take a transition into account.

        Parameters
        ----------
        start, end : ndarray, shape (6,)
            Measured states before and after.
        durations : ndarray, shape (K,)
            Lengths of the straight pieces of the rotor speeds in between [s].
        inputs : ndarray, shape (K + 1, 2)
            Rotor speeds at their ends [rad/s].
        lead : float, optional
            How long before the first state the pieces begin [s]; without it no lag is learnt.
        """
        times = np.concatenate(([0.0], np.cumsum(durations)))
        transition = _Transition(start, end, times, inputs, lead)
        residual = self._residual(transition, self._scale)
        if float(np.linalg.norm(residual)) > JUMP:
            self.jumps += 1
            return
        if float(np.max(np.abs(inputs))) > EXCITED:
            self._transitions.append(transition)
            self._fit()
            residual = self._residual(transition, self._scale)
        self._residuals.append(residual)

    def _fit(self) -> None:
        """Refit all transitions kept, from the constants believed so far."""
        prior = 1.0 / self._unknowns.spread**2
        for _ in range(_ROUNDS):
            before = self._scale
            linear = [self._linear(transition) for transition in self._transitions]
            jacobian = np.vstack([part.jacobian for part in linear])
            residuals = [part.residual + part.jacobian @ (before - part.at) for part in linear]
            residual = np.concatenate(residuals)
            variance = _variance(residuals, SIZE)
            information = np.diag(prior) + jacobian.T @ jacobian / variance
            right = (self._unknowns.centre - before) * prior - jacobian.T @ residual / variance
            change = np.linalg.solve(information, right)
            self._scale = self._unknowns.within(before + change)
            self._covariance = np.asarray(np.linalg.inv(information), dtype=float)
            if float(np.max(np.abs(self._scale - before))) < _SETTLED:
                break

    def _linear(self, transition: _Transition) -> _Linear:
        linear = transition.linear
        if linear is not None:
            moved = np.abs(self._scale - linear.at) / self._unknowns.spread
            if float(np.max(moved)) < _STILL_LINEAR:
                return linear
        residual = self._residual(transition, self._scale)
        linear = _Linear(self._scale, residual, self._jacobian(transition, residual))
        transition.linear = linear
        return linear

    def _residual(self, transition: _Transition, scale: Vector) -> Vector:
        """Return prediction minus measurement, shape (6,)."""
        durations, inputs = transition.window(self._unknowns.lag(scale))
        constants = self._unknowns.constants(scale)
        predicted = roll_out(transition.start, inputs, durations, constants, _STEP)[-1]
        difference: Vector = predicted - nearer_sign(transition.end, predicted)
        return difference

    def _jacobian(self, transition: _Transition, residual: Vector) -> Vector:
        """Return d residual / d scale by differences, shape (6, 5)."""
        columns = []
        for i in range(SIZE):
            scale = self._scale.copy()
            # Both ways are inside for the lag, whose window cannot begin before the lead.
            step = -_DIFFERENCE if self._unknowns.is_highest(scale, i) else _DIFFERENCE
            scale[i] += step
            columns.append((self._residual(transition, scale) - residual) / step)
        return np.column_stack(columns)


def _variance(residuals: list[Vector], fitted: int) -> float:
    """Return the noise variance that residuals show, `fitted` unknowns having been fitted."""
    squares = sum(float(r @ r) for r in residuals)
    freedom = max(1, _FREEDOM * len(residuals) - fitted) if residuals else 0
    expected = _EXPECTATION_COUNTS * _EXPECTED_NOISE**2
    return max(LEAST_NOISE**2, (squares + expected) / (freedom + _EXPECTATION_COUNTS))

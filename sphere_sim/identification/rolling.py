# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lumped constants, offset of stamps and noise of poses that were measured from outside.

A batch of all poses, by least squares. The recording is cut into pieces of some seconds; each has
its own pose and momentum at its start, so that a push, slip or a rough floor ends with its piece,
and all have the constants, the offset of the stamps, and slope and imbalance in common. Poses are
predicted by the controller's integrator from the measured rotor speeds. The covariance is that by
the residuals, or by the scatter between the pieces, whichever is larger; where the model leaves
errors that last, it is increased by as much as they exceed the noise.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.first_order_hold import SHORTEST
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, QUATERNION, Vector
from sphere_nmpc.model.units import RobotUnits
from sphere_nmpc.solver.roll_out import propagate, roll_out
from sphere_sim.evaluation.series import RobotSeries
from sphere_sim.identification.inertial import Track

OFFSET = 4
"""Place of the offset [s] among the common unknowns, behind Rs, c1, r1, r3 over the given ones."""
_COMMON, _LOCAL = 10, 8
"""Numbers of common unknowns, slope and imbalance the last five, and of those of a piece."""
_TORQUES = slice(5, 10)
_OFFSET_DEVIATION = 0.05
"""Standard deviation of the offset of stamps that is expected [s]."""
_ITERATIONS = 15
_CONVERGED = 1e-3
"""Step over the standard deviation below which the iteration has converged [-]."""
_SEEN = 0.5
"""Standard deviation over the expected one from which on an unknown is not seen [-]."""
_FEWEST = 10
"""Poses of a piece that are worth their eight unknowns."""
_LEAST = 1e-6
"""Standard deviation of a pose by rounding, and step of one that is small enough [m, rad]."""
_SETTLED = 1e-2
"""Relative change of the noise below which it has converged [-]."""
_LONGEST_GAP = 0.2
"""Longest time between two rotor speeds that counts as known [s]."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Common unknowns, what each piece begins with, and how well they are known.

    Attributes
    ----------
    common : ndarray, shape (10,)
        Constants over those given, offset of the stamps [s], slope and imbalance [rad/s^2].
    covariance : ndarray, shape (10, 10)
        Their covariance; that of what is fixed is the expected one.
    starts : list of ndarray, each of shape (9,)
        State at the first pose of each piece.
    noise : ndarray, shape (2,)
        Root mean square of what is left of positions [m] and orientations [rad], in the median of
        the pieces.
    seen : ndarray of bool, shape (10,)
        Which unknowns the motion shows; the others are as given.
    lasting : float
        What is left over the part of it that differs between neighbours, at least 1: more than 1
        where it is not noise of the poses, but what the model lacks.
    left_out : int
        Poses that are too far off to be used.
    """

    common: Vector
    covariance: Vector
    starts: list[Vector]
    noise: Vector
    seen: NDArray[np.bool_]
    lasting: float = 1.0
    left_out: int = 0

    @property
    def deviations(self) -> Vector:
        """Standard deviations of the common unknowns."""
        return np.sqrt(np.diag(self.covariance))


class BatchFit:
    """Least squares over some pieces of a recording, from the constants of a given robot."""

    def __init__(self, recorded: RobotSeries, robot: RobotParameters) -> None:
        self._poses, self._speeds = recorded.poses, recorded.rotor_speeds
        self.nominal = robot.lumped.as_array()
        numbers = EstimatorSettings().of(RobotUnits.of(robot))
        self._step, self.length = numbers.step, numbers.longest
        self.pieces = self._cut()
        """Indices of the poses of each piece."""
        self._outlier = numbers.improbable
        self._expected = np.array([
            *numbers.constants, _OFFSET_DEVIATION, *(numbers.tilt,) * 2, *(numbers.imbalance,) * 3
        ])
        self._push = numbers.push

    def _cut(self) -> list[NDArray[np.intp]]:
        """Return the indices of the poses of each piece, of `length` [s]."""
        times, turned = self._poses.times, self._speeds.times
        margin = 2.0 * _OFFSET_DEVIATION
        number = np.floor((times - times[0]) / self.length)
        known = (times > turned[0] + margin) & (times < turned[-1] - margin)
        gaps = np.flatnonzero(np.diff(turned) > _LONGEST_GAP)
        found = [np.flatnonzero(known & (number == k)) for k in range(int(number[-1]) + 1)]
        return [
            one for one in found if one.size >= _FEWEST and not np.any(
                (turned[gaps + 1] > times[one[0]] - margin)
                & (turned[gaps] < times[one[-1]] + margin)
            )
        ]

    def _inputs(self, times: Vector) -> tuple[Vector, Vector, NDArray[np.intp]]:
        """Return the rotor speeds from the first to the last time, as straight pieces.

        That is their lengths, the speeds at their ends, and which of these are the `times`.
        """
        turned = self._speeds.times
        begin, end = np.searchsorted(turned, times[[0, -1]], side="right")
        knots = np.unique(np.concatenate((times, turned[begin:end])))
        knots = knots[knots <= times[-1]]
        return np.diff(knots), self._speeds.interpolated(knots), np.searchsorted(knots, times)

    @cached_property
    def given(self) -> Estimate:
        """What is known before: the given robot, and the measured poses."""
        common: Vector = np.concatenate((np.ones(4), np.zeros(6)))
        starts = [
            np.concatenate((self._poses.values[piece[0]], np.zeros(3))) for piece in self.pieces
        ]
        return Estimate(
            common, np.diag(self._expected**2), starts, np.zeros(2), np.zeros(_COMMON, dtype=bool)
        )

    def constants(self, common: Vector) -> Vector:
        """Return the lumped constants, within what a robot can have."""
        found: Vector = self.nominal * common[:4]
        found[2:] = np.minimum(found[2:], 1.0 - 1e-3)
        return found

    def fitted(self, chosen: list[int], begin: Estimate | None = None) -> Estimate:
        """Return the estimate by the pieces with the numbers `chosen`.

        Unknowns that are not seen are fixed, the worst first, and the others estimated again.
        """
        found = begin or self.given
        free = np.ones(_COMMON, dtype=bool)
        while True:
            found = self._solved(chosen, found, free)
            ratio = np.where(free, found.deviations / self._expected, 0.0)[: OFFSET + 1]
            worst = int(np.argmax(ratio))
            if ratio[worst] < _SEEN:
                return replace(found, seen=free)
            free[worst] = False
            common = found.common.copy()
            common[worst] = self.given.common[worst]
            found = replace(found, common=common)

    def track(self, chosen: list[int], at: Estimate, step: float) -> Track:
        """Return the motion in pieces by an estimate, each `step` [s], in times of the rotors."""
        constants = self.constants(at.common)
        disturbance = Disturbance.from_array(at.common[_TORQUES])
        found = []
        for number in chosen:
            piece = self.pieces[number]
            first, last = self._poses.times[piece[[0, -1]]] + at.common[OFFSET]
            times = np.linspace(first, last - SHORTEST, max(2, round((last - first) / step)))
            both = np.sort(np.concatenate((times, times + SHORTEST)))
            durations, speeds, places = self._inputs(both)
            states = roll_out(
                at.starts[number], speeds, durations, constants, self._step, disturbance
            )[places]
            states, later = states[::2], states[1::2]
            moved = rotation.products(rotation.conjugate(states[:, QUATERNION]).T,
                                      later[:, QUATERNION].T)
            rates = 2.0 / SHORTEST * moved[1:].T
            found.append((times, states[:, QUATERNION], rates, np.full(times.size, number)))
        return Track(*(np.concatenate(one) for one in zip(*found, strict=True)))

    def left(self, chosen: list[int], at: Estimate) -> Vector:
        """Return the root mean square of what the common unknowns leave [m, rad], shape (2,)."""
        return self._solved(chosen, at, np.zeros(_COMMON, dtype=bool)).noise

    def _solved(self, chosen: list[int], begin: Estimate, free: NDArray[np.bool_]) -> Estimate:
        common, starts = begin.common.copy(), [state.copy() for state in begin.starts]
        scales: Vector = np.full((len(chosen), 2), np.inf)
        columns = np.flatnonzero(free)
        prior = np.diag(1.0 / self._expected[columns] ** 2)
        for _ in range(_ITERATIONS):
            parts = [self._linearised(k, starts[k], common) for k in chosen]
            kept = [
                np.sum((part[0] / np.repeat(scale, (2, 3))) ** 2, axis=1) < self._outlier
                for part, scale in zip(parts, scales, strict=True)
            ]
            before, scales = scales, _scales([
                part[0][one] for part, one in zip(parts, kept, strict=True)
            ])
            information = prior.copy()
            gradient = prior @ (self.given.common - common)[columns]
            scores, backs = list[Vector](), list[tuple[Vector, Vector]]()
            for part, one, scale in zip(parts, kept, scales, strict=True):
                (residual, by_local, by_common), weights = part, np.repeat(1.0 / scale, (2, 3))
                r = (residual[one] * weights).ravel()
                a = (by_local[one] * weights[:, None]).reshape(-1, _LOCAL)
                b = (by_common[one] * weights[:, None]).reshape(-1, _COMMON)[:, columns]
                own = a.T @ a
                own[5:, 5:] += np.eye(3) / self._push**2
                momentum = starts[chosen[len(scores)]][6:] / self._push**2
                right = a.T @ r - np.concatenate((np.zeros(5), momentum))
                gain = np.linalg.solve(own, a.T @ b)
                information += b.T @ b - (a.T @ b).T @ gain
                scores.append(b.T @ r - gain.T @ right)
                backs.append((np.asarray(np.linalg.solve(own, right)), np.asarray(gain)))
            covariance = np.linalg.inv(information) if columns.size else np.zeros((0, 0))
            step = covariance @ (gradient + np.sum(scores, axis=0))
            common[columns] += step
            moved = 0.0
            for k, (alone, gain) in zip(chosen, backs, strict=True):
                change = alone - gain @ step
                moved = max(moved, float(np.max(np.abs(change[2:5]))))
                starts[k] = apply_error(starts[k], change)
            settled = np.all(np.abs(before - scales) < _SETTLED * scales)
            ratio = np.abs(step) / np.sqrt(np.diag(covariance))
            if settled and np.all(ratio < _CONVERGED) and moved < _LEAST:
                break
        whole = np.diag(self._expected**2)
        if columns.size:
            found = np.array(scores) - np.mean(scores, axis=0)
            spread = covariance @ (found.T @ found) @ covariance
            larger = np.sqrt(np.maximum(np.diag(spread) / np.diag(covariance), 1.0))
            whole[np.ix_(columns, columns)] = covariance * np.outer(larger, larger)
        left = [part[0][one] for part, one in zip(parts, kept, strict=True)]
        noise, lasting = np.min(scales, axis=0), _lasting(left)
        whole[np.ix_(columns, columns)] *= lasting**2
        left_out = sum(int(np.sum(~one)) for one in kept)
        return Estimate(common, whole, starts, noise, free, lasting, left_out)

    def _linearised(
        self, index: int, start: Vector, common: Vector
    ) -> tuple[Vector, Vector, Vector]:
        """Return residuals of the poses of a piece, (K, 5), and their derivatives by unknowns."""
        piece, constants = self.pieces[index], self.constants(common)
        disturbance = Disturbance.from_array(common[_TORQUES])
        times = self._poses.times[piece] + common[OFFSET]
        durations, speeds, places = self._inputs(times)
        count = piece.size
        by_local = np.empty((count, 5, _LOCAL))
        by_common = np.zeros((count, 5, _COMMON))
        residual, states = np.empty((count, 5)), np.empty((count, 9))
        state, chain = start, np.eye(8)
        others: Vector = np.zeros((8, 9))
        for m in range(count):
            if m:
                first, last = places[m - 1], places[m]
                part = propagate(
                    state, speeds[first : last + 1], durations[first:last], constants,
                    self._step, disturbance,
                )
                state, chain = part.state, part.by_start @ chain
                others = part.by_start @ others
                others[:, :4] += part.by_constants
                others[:, 4:] += part.by_torques
            states[m] = state
            residual[m] = error_between(state[POSE], self._poses.values[piece[m]])
            by_local[m], by_common[m, :, :4] = chain[:5], others[:5, :4] * self.nominal
            by_common[m, :, _TORQUES] = others[:5, 4:]
        rates = self._rates(states, speeds[places], constants, disturbance)
        by_common[:, :, OFFSET] = rates - by_local[:, :, :5] @ rates[0]
        return residual, by_local, by_common

    def _rates(
        self, states: Vector, speeds: Vector, constants: Vector, disturbance: Disturbance
    ) -> Vector:
        """Return the rates of the errors of poses [m/s, rad/s], shape (K, 5)."""
        short = np.array([SHORTEST])
        later = [
            roll_out(state, np.array((u, u)), short, constants, SHORTEST, disturbance)[-1]
            for state, u in zip(states, speeds, strict=True)
        ]
        return np.array([
            error_between(a[POSE], b[POSE]) for a, b in zip(states, later, strict=True)
        ]) / SHORTEST


def _lasting(residuals: list[Vector]) -> float:
    """Return the ratio of residuals to those whose neighbours are independent, at least 1."""
    whole = np.concatenate(residuals)
    steps = np.concatenate([np.diff(one, axis=0) for one in residuals])
    ratios = [
        np.sqrt(2.0 * np.mean(whole[:, part] ** 2) / max(np.mean(steps[:, part] ** 2), _LEAST**2))
        for part in (slice(0, 2), slice(2, 5))
    ]
    return max(1.0, *map(float, ratios))


def _scales(residuals: list[Vector]) -> Vector:
    """Return the noise of positions [m] and orientations [rad] in each piece, shape (n, 2).

    It is that of what is left there, so that a slip counts for little, and at least the median.
    """
    own = []
    for left in residuals:
        kept = max(1.0 - _LOCAL / (5.0 * max(len(left), 1)), 0.1)
        squares = np.array([np.mean(left[:, :2] ** 2), np.mean(left[:, 2:] ** 2)])
        own.append(np.sqrt(squares / kept))
    found: Vector = np.maximum(np.maximum(own, np.median(own, axis=0)), _LEAST)
    return found

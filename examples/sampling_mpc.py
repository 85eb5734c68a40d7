#!/usr/bin/env python3
# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A sampling-based MPC: the cross-entropy method on roll-outs, scored in a suite."""

import sys
from typing import Any

import numpy as np

from sphere_nmpc import ControllerSettings, RobotParameters, Situation, roll_out, score

KNOTS, SAMPLES, ELITES, ROUNDS = 6, 100, 8, 8
"""Rotor speeds planned ahead, the last of which are 0, and samples of each round."""
STAGE_WEIGHT = 0.1
"""Weight of the mean error on the way, that at the end counting 1."""


class SamplingMpc:
    """Function of a situation that keeps its best plan, shape (KNOTS, 2) [rad/s], for the next."""

    def __init__(self, settings: ControllerSettings, robot: RobotParameters) -> None:
        self._limit, self._rng = robot.max_rotor_speed, np.random.default_rng(1)
        self._durations = np.full(KNOTS, settings.control_period)
        self._best = np.zeros((KNOTS, 2))

    def __call__(self, now: Situation) -> Any:
        """Return the first rotor speeds of the best plan [rad/s]."""
        best: Any = np.vstack((self._best[1:], np.zeros(2)))
        # What a loop of the rotor speeds moves the sphere by rises with their square.
        spread = min(0.5, 0.5 * np.sqrt(self._errors(now, [best])[0, -1]))
        mean, deviation = best, np.full((KNOTS, 2), spread * self._limit)
        for _ in range(ROUNDS):
            samples = self._rng.normal(mean, deviation, (SAMPLES, KNOTS, 2))
            samples[0], samples[:, -1] = best, 0.0
            samples = samples.clip(-self._limit, self._limit)
            errors = self._errors(now, samples)
            costs = errors[:, -1] + STAGE_WEIGHT * errors.mean(axis=1)
            elite = samples[np.argsort(costs)[:ELITES]]
            best, mean, deviation = elite[0], elite.mean(axis=0), elite.std(axis=0)
        self._best = best
        return best[0]

    def _errors(self, now: Situation, samples: Any) -> Any:
        """Return the distance from the goal at each knot of each sample."""
        constants, goal = now.constants.as_array(), now.goal.pose
        poses = np.array([
            roll_out(now.state, np.vstack((now.speeds, one)), self._durations, constants)[1:, :6]
            for one in samples
        ])
        signs = np.array([np.ones(6), (1, 1, -1, -1, -1, -1)])  # of one orientation
        return np.linalg.norm(poses[:, :, None] - signs * goal, axis=-1).min(axis=-1)


if __name__ == "__main__":
    print(score(SamplingMpc, sys.argv[1], ControllerSettings(sample_period=0.5)))

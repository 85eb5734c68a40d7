# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Intermediate goals on the way to a far one, for a sphere with momentum.

With momentum a sphere cannot roll steadily, and whole turns cannot be left out of a plan: its size
would grow with the distance. So a far goal is approached by goals some metres ahead on the
straight line to it.
"""

from dataclasses import replace

import numpy as np

from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings


class IntermediateGoals:
    """Replacement of a far goal by one on the way to it, where the sphere has momentum.

    Parameters
    ----------
    settings : TimeOptimalSettings
        Distances.
    """

    def __init__(self, settings: TimeOptimalSettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget the intermediate goal."""
        self._place: Vector | None = None

    def aim(
        self, situation: Situation, time_left: float, found_none: bool = False
    ) -> tuple[Situation, bool]:
        """Return the situation with the goal to plan for, and whether that is a new one.

        Parameters
        ----------
        situation : Situation
            With the final goal.
        time_left : float
            Time to the arrival of the plan that is being followed [s]; 0 without one.
        found_none : bool, optional
            Whether the last search has found no arrival; the next one is then to a nearer goal.
        """
        settings, last = self._settings, self._place
        here, there = situation.state[POSITION], situation.goal[POSITION]
        near = settings.reach_with_momentum
        farthest = near if last is not None or found_none else settings.far_distance
        distance = float(np.linalg.norm(there - here))
        if situation.drift.is_zero or distance <= farthest:
            self._place = None
            return situation, last is not None
        if last is None or time_left <= 0.0:
            self._place = here + (near / distance) * (there - here)
        goal = situation.goal.copy()
        goal[POSITION] = self._place
        return replace(situation, goal=goal), self._place is not last

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Intermediate goals on the straight line to a far one.

With momentum a sphere cannot roll steadily, and whole turns cannot be left out of a plan: its size
would grow with the distance. A far goal is then approached by goals some metres ahead. Without
momentum only goals at kilometres need intermediate ones, as the direction of steady rolling would
have to be planned to more digits than the solver attains.
"""

from dataclasses import replace

import numpy as np

from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings


class IntermediateGoals:
    """Replacement of a far goal by one on the way to it.

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
        rolls_steadily = situation.drift.is_zero
        near = settings.reach if rolls_steadily else settings.reach_with_momentum
        farthest = settings.farthest if rolls_steadily else settings.far_distance
        if not rolls_steadily and (last is not None or found_none):
            farthest = near
        distance = float(np.linalg.norm(there - here))
        if distance <= farthest:
            self._place = None
            return situation, last is not None
        is_near = last is not None and float(np.linalg.norm(last - here)) < 0.5 * near
        if last is None or time_left <= 0.0 or (rolls_steadily and is_near):
            self._place = here + (near / distance) * (there - here)
        goal = situation.goal.copy()
        goal[POSITION] = self._place
        return replace(situation, goal=goal), self._place is not last

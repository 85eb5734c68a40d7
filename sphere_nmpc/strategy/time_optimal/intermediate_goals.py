# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Intermediate goals on the way to a far one, so that a sample's work is independent of distance.

The long interval of steady rolling is integrated in short steps, and of plans that take minutes a
search finds few that reach the goal. So a far goal is approached by a goal some metres ahead on
the straight line to it. Before the plan brakes, that goal is moved on by whole turns of the shell:
the same plan with a longer interval of steady rolling then leads there.
"""

from dataclasses import replace

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings


class IntermediateGoals:
    """Replacement of a far goal by one on the way to it.

    Parameters
    ----------
    settings : TimeOptimalSettings
        Distances, turns of the shell, time before braking.
    """

    def __init__(self, settings: TimeOptimalSettings) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget the intermediate goal."""
        self._place: Vector | None = None

    def aim(
        self, situation: Situation, time_left: float, found_none: bool = False
    ) -> tuple[Situation, bool, bool]:
        """Return the situation with the goal to plan for, and how it relates to the last one.

        Parameters
        ----------
        situation : Situation
            With the final goal.
        time_left : float
            Time to the arrival of the plan that is being followed [s]; 0 without one.
        found_none : bool, optional
            Whether the last search has found no arrival. With momentum, where a sphere cannot roll
            steadily, the next one is to a nearer goal.

        Returns
        -------
        situation : Situation
            With the final goal, or an intermediate one.
        is_new : bool
            Whether its goal differs from the last one.
        is_moved_on : bool
            Whether its goal is the last one, moved on by whole turns of the shell.
        """
        settings = self._settings
        here, there = situation.state[POSITION], situation.goal[POSITION]
        distance = float(np.linalg.norm(there - here))
        last = self._place
        limited = not np.isinf(situation.time_budget)
        far = settings.far_distance_in_time if limited else settings.far_distance
        rolls_steadily = situation.drift.is_zero
        near = settings.intermediate_distance if rolls_steadily else settings.reach_with_momentum
        if found_none and not rolls_steadily:
            far = near
        if distance <= (far if last is None else near):
            self._place = None
            return situation, last is not None, False
        is_moved_on = last is not None and 0.0 < time_left < settings.braking_time
        is_moved_on = is_moved_on and rolls_steadily
        if last is None or time_left <= 0.0:
            self._place = _towards(here, there, near)
        elif is_moved_on:
            self._place = _towards(last, there, self._advance(situation.constants))
        goal: Vector = situation.goal.copy()
        goal[POSITION] = self._place
        return replace(situation, goal=goal), self._place is not last, is_moved_on

    def extended(
        self, arrival: Arrival, rest: FirstOrderHold, situation: Situation
    ) -> Arrival | None:
        """Return an arrival at a goal that was moved on: roll on as now, then arrive as planned.

        Parameters
        ----------
        arrival : Arrival
            At the goal before it was moved.
        rest : FirstOrderHold
            The rest of its hold, from time 0 (now) on [s].
        situation : Situation
            With the goal that was moved.

        Returns
        -------
        Arrival or None
            An initial guess, not solved; None where the shell hardly rolls now.
        """
        constants = situation.constants
        rate = constants.input_gain * float(np.linalg.norm(rest.speeds[0]))
        if rate < self._settings.least_rolling:
            return None
        longer = self._advance(constants) / (constants.shell_radius * rate)
        times = np.concatenate(([0.0], longer + rest.times))
        hold = FirstOrderHold(times, np.vstack((rest.speeds[:1], rest.speeds)))
        goal = arrival.goal.copy()
        goal[POSITION] = situation.goal[POSITION]
        return replace(arrival, hold=hold, goal=goal)

    def _advance(self, constants: LumpedConstants) -> float:
        """Return the distance by which an intermediate goal is moved on [m]."""
        turns = self._settings.intermediate_turns
        return turns * 2.0 * float(np.pi) * constants.shell_radius


def _towards(place: Vector, goal: Vector, distance: float) -> Vector:
    """Return the point `distance` [m] from `place` on the line to `goal`, shape (2,)."""
    way = goal - place
    moved: Vector = place + (distance / float(np.linalg.norm(way))) * way
    return moved

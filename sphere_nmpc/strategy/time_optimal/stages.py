# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Intermediate goals on a long way, so that the work of a sample does not grow with the distance.

The long interval of steady rolling is integrated in short steps, and a search over motions of
minutes finds few that arrive. So a far goal is approached by a goal some metres ahead on the
straight line to it. Before the plan brakes, that goal is moved on by whole turns of the shell: the
same plan with a longer stretch of steady rolling then leads there.
"""

from dataclasses import replace

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival
from sphere_nmpc.strategy.time_optimal.grid import MANOEUVRE

FAR = 60.0
"""Distance [m] beyond which a goal is approached by intermediate ones ..."""
FAR_IN_TIME = 8.0
"""... and the one where the answer may take a limited time: on a busy machine a tenth of a second
finds no arrival over 10 m, and the sphere would not set off at all."""
STAGE = 5.0
"""Distance of the first intermediate goal [m], and the one from which on the goal itself is aimed
at."""
_TURNS = 4
"""Turns of the shell by which it is moved on; an even number leaves the quaternion's sign."""
_BRAKING = MANOEUVRE + 0.5
"""Time left of a plan [s] at which it still rolls on."""
_ROLLING = 1.0
"""Least rate of the shell [rad/s] at which rolling on leads anywhere."""


class Stages:
    """Replace a goal that is far away by one on the way to it."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the intermediate goal."""
        self._place: Vector | None = None

    def aim(self, situation: Situation, time_left: float) -> tuple[Situation, bool, bool]:
        """Return the situation with the goal to plan for, and what became of the one before.

        Parameters
        ----------
        situation : Situation
            With the goal itself.
        time_left : float
            Time to the arrival of the plan in hand [s]; 0 without one.

        Returns
        -------
        situation : Situation
            With a goal that is near.
        is_new : bool
            Whether its goal is another than before.
        is_onward : bool
            Whether it is the one before, moved on by whole turns.
        """
        here, there = situation.state[POSITION], situation.goal[POSITION]
        distance = float(np.linalg.norm(there - here))
        before = self._place
        reach = FAR if np.isinf(situation.time_budget) else FAR_IN_TIME
        if distance <= (reach if before is None else STAGE):
            self._place = None
            return situation, before is not None, False
        is_onward = before is not None and 0.0 < time_left < _BRAKING
        if before is None or time_left <= 0.0:
            self._place = _towards(here, there, STAGE)
        elif is_onward:
            self._place = _towards(before, there, _onward(situation.constants))
        goal: Vector = situation.goal.copy()
        goal[POSITION] = self._place
        return replace(situation, goal=goal), self._place is not before, is_onward


def led_on(arrival: Arrival, rest: FirstOrderHold, situation: Situation) -> Arrival | None:
    """Return an arrival with a goal that was moved on: roll on as now, then arrive as planned.

    Parameters
    ----------
    arrival : Arrival
        At the goal before it was moved.
    rest : FirstOrderHold
        What is left of its hold, from time 0 (now) on [s].
    situation : Situation
        With the goal that was moved.

    Returns
    -------
    Arrival or None
        Not solved yet; None where the shell hardly rolls now.
    """
    constants = situation.constants
    rate = constants.input_gain * float(np.linalg.norm(rest.speeds[0]))
    if rate < _ROLLING:
        return None
    longer = _onward(constants) / (constants.shell_radius * rate)
    times = np.concatenate(([0.0], longer + rest.times))
    hold = FirstOrderHold(times, np.vstack((rest.speeds[:1], rest.speeds)))
    goal = arrival.goal.copy()
    goal[POSITION] = situation.goal[POSITION]
    return replace(arrival, hold=hold, goal=goal)


def _onward(constants: LumpedConstants) -> float:
    """Return by how far an intermediate goal is moved on [m]."""
    return _TURNS * 2.0 * float(np.pi) * constants.shell_radius


def _towards(place: Vector, goal: Vector, distance: float) -> Vector:
    way = goal - place
    moved: Vector = place + (distance / float(np.linalg.norm(way))) * way
    return moved

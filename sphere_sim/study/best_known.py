# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Best known time: that of the fastest motion from start to goal that was found.

A long multi-start search for arrivals on a coarse grid of knots, whose best result is shortened
on finer and finer grids: to rest, |u| <= u_max, |du/dt| <= the limit of acceleration and torque.
The true minimum time may be shorter.
"""

import hashlib
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.progress import Progress

from sphere_nmpc.cache import cache_folder
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import nearer_sign, state_error
from sphere_nmpc.model.torque import within_torque
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Accuracy, Arrival, ArrivalSolver
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_sim.evaluation.metrics import SETTLED_ERROR
from sphere_sim.study.best_known_cache import BestKnownCache
from sphere_sim.study.motion import Motion
from sphere_sim.study.progress import shown
from sphere_sim.study.workers import Workers

SEARCH_VERSION = 1
"""To be raised with any change of the search that finds other times: times of another version in
the cache are not used."""
SEARCHES = 2
"""Independent searches for each scenario."""
EFFORT = 400_000
"""Work of each search: solver iterations times intervals, about a microsecond each."""
_TUNING = TimeOptimalSettings()
"""Tuning of the searches: that of the strategy."""
GRIDS = (0.25, 0.125, 0.0625)
"""Spacing of the knots [s], coarse to fine; the search uses the first."""
_STEP = 0.0625
"""Longest integration step of the final motion [s]."""
_REST_SPEED = 0.5
"""Error of the rotor speeds at rest of the final motion [rad/s]."""
_STRETCHES = (1.0, 1.01, 1.02, 1.05, 1.1)
"""Factors of the duration that are tried in turn on a finer grid [-]."""
_LARGEST_SHARE, _SMALLEST_SHARE = 0.08, 0.003
"""Share of the duration by which a motion is shortened, at first and at last [-]."""


def best_known_time(motion: Motion, robot: RobotParameters) -> float:
    """Return the time of the fastest motion found [s]; nan if none, 0 if the start is settled.

    Parameters
    ----------
    motion : Motion
        Start, goal and drift.
    robot : RobotParameters
        Parameters and limits of the robot that moves.
    """
    if state_error(motion.start, motion.goal) < SETTLED_ERROR and motion.starts_at_rest:
        return 0.0
    robot = within_torque(robot)
    goal = nearer_sign(motion.goal, motion.start)
    situation = Situation(
        0.0, motion.start, goal, motion.speeds, robot.lumped, drift=motion.drift
    )
    earliest = float("nan")
    for seed in range(SEARCHES):
        search = ArrivalSearch(robot, GRIDS[0], situation, GRIDS[0], seed, _TUNING)
        arrival = search.improve(EFFORT)
        for period in GRIDS[1:]:
            if arrival is not None:
                arrival = _refined(arrival, period, situation, robot)
        if arrival is not None:
            earliest = float(np.fmin(earliest, arrival.duration))
    return earliest


def _refined(
    arrival: Arrival, period: float, situation: Situation, robot: RobotParameters
) -> Arrival | None:
    """Return a shorter arrival with knots `period` [s] apart; None where there is none."""
    tolerance = _TUNING.coarse_error
    accuracy = Accuracy(40, _STEP, 0.1 * tolerance, _REST_SPEED)
    solver = ArrivalSolver(robot, period, accuracy, _TUNING)

    def solve(duration: float, guess: Arrival) -> Arrival | None:
        found = solver.solve(situation, guess.goal, duration, guess.hold, period)
        return found if found.error <= tolerance else None

    # The search integrates with coarse steps: its arrival may have to be slightly later.
    stretched = (solve(stretch * arrival.duration, arrival) for stretch in _STRETCHES)
    best = next((found for found in stretched if found is not None), None)
    if best is None:
        return None
    share = _LARGEST_SHARE
    while share > _SMALLEST_SHARE:
        shorter = solve((1.0 - share) * best.duration, best)
        if shorter is None:
            share *= 0.5
        else:
            best = shorter
    return best


def best_known_times(
    motions: Sequence[Motion], robot: RobotParameters, workers: Workers
) -> list[float]:
    """Return the best known time of each motion [s], from the cache where it is there.

    A cache that cannot be used is a warning; all times are then searched for.

    Parameters
    ----------
    motions : sequence of Motion
        Starts, goals and drifts.
    robot : RobotParameters
        Parameters and limits of the robot that moves.
    workers : Workers
        Where the searches run.

    Raises
    ------
    WorkersError
        If the workers cannot be started or reached, or die.
    InvalidParameterError
        If the torque limit leaves no acceleration.
    """
    cache = BestKnownCache(cache_folder() / "best_known_times.jsonl")
    keys = [_key(motion, robot) for motion in motions]
    missing = {key: m for key, m in zip(keys, motions, strict=True) if key not in cache.known}
    if missing:
        columns = Progress.get_default_columns()
        bar = Progress(*columns, console=Console(stderr=True), transient=True)
        with shown(bar) as progress:
            task = progress.add_task("best known times", total=len(missing))
            searches = [(key, (motion, robot)) for key, motion in missing.items()]
            for key, seconds in workers.run(best_known_time, searches, "search"):
                cache.add(key, seconds)
                progress.advance(task)
    return [cache.known[key] for key in keys]


def _key(motion: Motion, robot: RobotParameters) -> str:
    """Return a key of all that the best known time depends on, to nine digits."""
    limits = (robot.max_rotor_speed, within_torque(robot).max_rotor_acceleration)
    search = (SEARCH_VERSION, SEARCHES, EFFORT, *GRIDS)
    numbers = [*motion.start, *motion.goal, *robot.lumped.as_array(), *limits, *search]
    if not (motion.drift.is_zero and motion.starts_at_rest):
        numbers += [*motion.speeds, *motion.drift.as_array()]
    text = " ".join(f"{float(number):.9g}" for number in numbers)
    return hashlib.sha256(text.encode()).hexdigest()[:24]

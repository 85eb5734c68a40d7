# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Best known times: those of the fastest motion from start to goal that was found.

A long multi-start search for arrivals, the best of which is solved again on finer knots: to rest,
|u| <= u_max, |du/dt| <= the limit of acceleration and torque.
The true minimum time may be shorter.
"""

import contextlib
import hashlib
import json
import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import Progress

from sphere_nmpc.foreign.own_folder import cache_folder, own_folder
from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance, is_zero
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    MOMENTUM,
    POSE,
    Vector,
    nearer_sign,
    state_error,
    without_momentum,
)
from sphere_nmpc.model.torque import within_torque
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver
from sphere_nmpc.strategy.time_optimal.knots import Grid
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_sim.evaluation.metrics import SETTLED_ERROR, settling_index, state_errors
from sphere_sim.study.motion import Motion
from sphere_sim.study.progress import shown
from sphere_sim.study.workers import Workers

SEARCH_VERSION = 3
"""Version, to be raised with any change of the search that finds other times: times of another one
in the cache are not used."""
SEARCHES = 2
"""Independent searches for each scenario."""
EFFORT = 400_000
"""Work of each search by default: solver iterations times intervals, about a microsecond each."""
_TUNING = TimeOptimalSettings()
"""Tuning of the searches: that of the strategy."""
_FINER = 2
"""Factor on the number of knots on which the best motion is solved again."""
_ITERATIONS = 200
"""Cap on the iterations of the final solve."""
_STEP = 0.0625
"""Longest integration step of the final motion [s]."""
_MOMENTUM_STEPS = 16
"""Steps in which momentum and disturbance are raised."""
_MOMENTUM_VERSION = 2
"""Version as `SEARCH_VERSION`, for times with momentum alone."""
_RESOLUTION = 0.01
"""Resolution of the settling time [s], that of the runs."""
_log = logging.getLogger("sphere_nmpc")


class BestKnownTimes(NamedTuple):
    """Times of the fastest motion that was found [s]; nan if none.

    It ends at rest at the goal after its duration. It has settled somewhat before: with that the
    settling time of a run is compared.
    """

    duration: float
    settling: float


def best_known_time(
    motion: Motion, robot: RobotParameters, factor: float = 1.0
) -> BestKnownTimes:
    """Return the times of the fastest motion found for a robot; 0 if the start is settled.

    The work of each search is `factor` times `EFFORT`.
    """
    nearest = motion.orientation.nearest(motion.goal, motion.start)
    if state_error(motion.start, nearest) < SETTLED_ERROR and motion.starts_at_rest:
        return BestKnownTimes(0.0, 0.0)
    robot = within_torque(robot)
    goal = nearer_sign(nearest, motion.start)
    situation = Situation.of(
        0.0, motion.start, Goal(goal, motion.orientation), motion.speeds, robot.lumped,
        disturbance=motion.disturbance,
    )
    solver = ArrivalSolver(robot, Grid.of(robot, _TUNING.spacing), _TUNING)
    fine = ArrivalSolver(robot, Grid.of(robot, _TUNING.spacing / _FINER), _TUNING)
    earliest: Plan | None = None
    for seed in range(SEARCHES):
        arrival = _searched(situation, solver, seed, round(factor * EFFORT))
        if arrival is not None:
            arrival = _solved(fine, situation, arrival)
        if arrival is not None and (
            earliest is None or arrival.duration < earliest.duration
        ):
            earliest = arrival
    if earliest is None:
        return BestKnownTimes(math.nan, math.nan)
    return BestKnownTimes(earliest.duration, _settling(earliest, situation))


def _settling(arrival: Plan, situation: Situation) -> float:
    """Return the time from which the error of a motion stays below `SETTLED_ERROR` [s].

    It is sampled from the last knot above that on. Before that knot the states at the knots
    suffice, also of a motion with whole turns, which its solution does not integrate.
    """
    hold = arrival.hold
    knot = max(0, (settling_index(_errors(arrival.states, arrival)) or 0) - 1)
    times = np.arange(hold.times[knot], hold.end, _RESOLUTION)
    times = np.unique(np.concatenate((times, hold.times[knot:])))
    states = roll_out(
        arrival.states[knot], np.array([hold.at(time) for time in times]), np.diff(times),
        situation.constants.as_array(), _STEP, situation.disturbance,
    )
    index = settling_index(_errors(states, arrival))
    return hold.end if index is None else float(times[index])


def _errors(states: Vector, arrival: Plan) -> Vector:
    """Return the distance of each state, (K, 9), from the nearest member of the goals, (K,)."""
    poses = states[:, POSE]
    goal = arrival.leg.goal
    return state_errors(poses, goal.orientation.nearest_of(goal.pose, poses))


def _searched(
    situation: Situation, solver: ArrivalSolver, seed: int, work: int
) -> Plan | None:
    """Return the earliest arrival that a search finds.

    Few guesses lead to a far goal with momentum. The search is therefore continued from an arrival
    without, from which momentum and disturbance are raised in steps.
    """
    is_there = state_error(situation.state, situation.goal.pose) < SETTLED_ERROR
    # At the goal a sphere without momentum would be there in no time.
    if is_there or is_zero(situation.momentum, situation.disturbance):
        return ArrivalSearch(solver, situation, seed).improve(work)
    still = replace(
        situation, state=without_momentum(situation.state), disturbance=UNDISTURBED
    )
    raised = _searched(still, solver, seed, work)
    for step in range(1, _MOMENTUM_STEPS + 1):
        if raised is not None:
            share, state = step / _MOMENTUM_STEPS, still.state.copy()
            state[MOMENTUM] = share * situation.state[MOMENTUM]
            disturbance = Disturbance.from_array(share * situation.disturbance.as_array())
            between = replace(situation, state=state, disturbance=disturbance)
            raised = _solved(solver, between, raised)
    return ArrivalSearch(solver, situation, seed, raised).improve(work)


def _solved(solver: ArrivalSolver, situation: Situation, guess: Plan) -> Plan | None:
    """Return the fastest arrival near a guess; None where it leaves an error."""
    refined = replace(guess, hold=solver.grid.refined(guess.hold))
    *_, found = solver.solves(situation, refined, iterations=_ITERATIONS)
    return found if found.error <= _TUNING.arrival_error else None


def best_known_times(
    motions: Sequence[Motion], robot: RobotParameters, workers: Workers, factor: float = 1.0
) -> list[BestKnownTimes]:
    """Return the best known times of each motion of a robot, from the cache where they are there.

    A cache that cannot be used is a warning; all times are then searched for. Those of another
    factor, see `best_known_time`, are not used.
    """
    cache = BestKnownCache(cache_folder() / "best_known_times.jsonl")
    keys = [_key(motion, robot, factor) for motion in motions]
    missing = {key: m for key, m in zip(keys, motions, strict=True) if key not in cache.known}
    if missing:
        columns = Progress.get_default_columns()
        bar = Progress(*columns, console=Console(stderr=True), transient=True)
        with shown(bar) as progress:
            task = progress.add_task("best known times", total=len(missing))
            searches = [(key, (motion, robot, factor)) for key, motion in missing.items()]
            for key, found in workers.run(best_known_time, searches, "search"):
                cache.add(key, found)
                progress.advance(task)
    return [cache.known[key] for key in keys]


def _key(motion: Motion, robot: RobotParameters, factor: float) -> str:
    """Return a key of all that the best known times depend on, to nine digits."""
    limits = (robot.max_rotor_speed, within_torque(robot).max_rotor_acceleration)
    search = (SEARCH_VERSION, SEARCHES, round(factor * EFFORT), _FINER)
    numbers = [*motion.start[POSE], *motion.goal, *robot.lumped.as_array(), *limits, *search]
    if not motion.starts_in_model_of_paper:
        numbers += [*motion.speeds, *motion.start[MOMENTUM], *motion.disturbance.as_array()]
        numbers += [_MOMENTUM_STEPS, _MOMENTUM_VERSION]
    if motion.orientation is not Orientation.FULL:
        numbers += [*motion.orientation.weights]
    text = " ".join(f"{float(number):.9g}" for number in numbers)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


class BestKnownCache:
    """Times found earlier, by key; a file that cannot be used is a warning and costs time only.

    The file is created with the first times that are added. Of a key that is there several times
    the shortest motion counts; lines that are damaged are skipped.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._is_usable = True
        self.known: dict[str, BestKnownTimes] = {}
        """Times by key."""
        try:
            # Reading anything but a regular file might never end.
            own_folder(path.parent)
            if path.exists() and not path.is_file():
                raise OSError("not a file")
            text = path.read_bytes() if path.exists() else b""
        except OSError as error:
            self._warn("read", error)
            return
        # A crash may leave a line incomplete.
        for line in text.splitlines():
            with contextlib.suppress(ValueError, TypeError, RecursionError):
                key, *seconds = json.loads(line.decode())
                found = BestKnownTimes(*map(float, seconds))
                if any(time < 0.0 or math.isinf(time) for time in found):
                    continue
                if not self.known.get(str(key), found).duration < found.duration:
                    self.known[str(key)] = found

    def add(self, key: str, found: BestKnownTimes) -> None:
        """Keep times, also in the file where that is possible."""
        self.known[key] = found
        if not self._is_usable:
            return
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps([key, *found]) + "\n")
        except OSError as error:
            self._warn("written", error)

    def _warn(self, what: str, error: OSError) -> None:
        self._is_usable = False
        _log.warning(
            "sphere_nmpc study: %s cannot be %s (%s); best known times are not kept, and searched "
            "for again next time", self._path, what, error.strerror or error,
        )

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The best known time from each start to its goal, to hold a controller's times against.

A long search over arrivals on the controller's own grid, then the best of it shortened on ever
finer grids: rest to rest, |u| <= u_max, |du/dt| <= its limit. It is an upper estimate of the least
time: every figure is a motion that was found. Results are kept in the user's cache folder and only
ever replaced by earlier arrivals.
"""

import hashlib
import json
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from rich.progress import Progress

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, nearer_sign, state_error
from sphere_nmpc.solver.native import cache_folder
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver, Effort
from sphere_nmpc.strategy.time_optimal.search import ARRIVED, ArrivalSearch
from sphere_sim.scenarios import Scenario

SEARCHES = 2
"""Independent searches a scenario."""
EFFORT = 400_000
"""Work of each: solver iterations times intervals, about a microsecond each."""
GRIDS = (0.25, 0.125, 0.0625)
"""Spacing of the knots [s], coarse to fine; the search is done on the first."""
_STEP = 0.0625
"""Longest integration step of what is reported [s]."""
_SMALLEST_SHARE = 0.003
_THERE = 1e-2
"""A start this near to the goal counts as settled: there is no time to compare with."""


def best_known_time(scenario: Scenario, robot: RobotParameters) -> float:
    """Return the earliest arrival found [s]; nan where none was, 0 where start and goal agree.

    Parameters
    ----------
    scenario : Scenario
        Where from and where to.
    robot : RobotParameters
        True parameters and limits.
    """
    if state_error(scenario.start, scenario.goal) < _THERE:
        return 0.0
    goal = nearer_sign(scenario.goal, scenario.start)
    situation = Situation(0.0, scenario.start, goal, np.zeros(INPUT_SIZE), robot.lumped)
    earliest = float("nan")
    for seed in range(SEARCHES):
        search = ArrivalSearch(robot, GRIDS[0], situation, GRIDS[0], seed)
        arrival = search.improve(EFFORT)
        if arrival is None:
            continue
        for period in GRIDS[1:]:
            solver = ArrivalSolver(robot, period, Effort(40, _STEP, 0.1 * ARRIVED))
            # The search integrates coarsely: what it found may have to be a little later.
            for stretch in (1.0, 1.01, 1.02, 1.05, 1.1):
                duration = stretch * arrival.duration
                precise = solver.solve(situation, arrival.goal, duration, arrival.hold, period)
                if precise.miss <= ARRIVED:
                    break
            else:
                return float("nan")
            arrival = precise
            share = 0.08
            while share > _SMALLEST_SHARE:
                duration = (1.0 - share) * arrival.duration
                earlier = solver.solve(situation, arrival.goal, duration, arrival.hold, period)
                if earlier.miss <= ARRIVED:
                    arrival = earlier
                else:
                    share *= 0.5
        earliest = float(np.fmin(earliest, arrival.duration))
    return earliest


def best_known_times(
    scenarios: Sequence[Scenario], robot: RobotParameters | None = None, jobs: int | None = None
) -> list[float]:
    """Return the best known time of each scenario [s], from the cache where it is known.

    Parameters
    ----------
    scenarios : sequence of Scenario
        Where from and where to.
    robot : RobotParameters, optional
        True parameters and limits; Table 1 by default.
    jobs : int, optional
        Processes; all cores by default.
    """
    robot = RobotParameters() if robot is None else robot
    known = _read(_cache_file())
    keys = [_key(scenario, robot) for scenario in scenarios]
    missing = {key: s for key, s in zip(keys, scenarios, strict=True) if key not in known}
    if missing:
        # Fresh interpreters: a fork would copy the threads of whoever calls.
        context = get_context("spawn")
        with (
            ProcessPoolExecutor(jobs or os.cpu_count(), mp_context=context) as pool,
            Progress(transient=True) as progress,
        ):
            task = progress.add_task("best known times", total=len(missing))
            futures = {pool.submit(best_known_time, s, robot): k for k, s in missing.items()}
            try:
                for future in as_completed(futures):
                    known[futures[future]] = future.result()
                    _append(_cache_file(), futures[future], known[futures[future]])
                    progress.advance(task)
            except BaseException:
                # What waits would be made first otherwise, hours of it.
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    return [known[key] for key in keys]


def _key(scenario: Scenario, robot: RobotParameters) -> str:
    """Name a problem by what decides its answer, to nine digits."""
    limits = (robot.max_rotor_speed, robot.max_rotor_acceleration, SEARCHES, EFFORT)
    numbers = [*scenario.start, *scenario.goal, *robot.lumped.as_array(), *limits]
    text = " ".join(f"{float(number):.9g}" for number in numbers)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def _cache_file() -> Path:
    return cache_folder() / "best_known_times.jsonl"


def _read(path: Path) -> dict[str, float]:
    """Return the known times; a torn last line, as a crash leaves it, is passed over."""
    known: dict[str, float] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                key, seconds = json.loads(line)
                known[key] = float(np.fmin(known.get(key, np.nan), float(seconds)))
            except (ValueError, TypeError):
                continue
    return known


def _append(path: Path, key: str, seconds: float) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps([key, seconds]) + "\n")

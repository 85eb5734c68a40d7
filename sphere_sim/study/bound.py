# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The best known time from each start to its goal, to hold a controller's times against.

A long search over arrivals on the controller's own grid, then the best of it shortened on ever
finer grids: rest to rest, |u| <= u_max, |du/dt| <= its limit. It is an upper estimate of the least
time: every figure is a motion that was found. Results are kept in the user's cache folder and only
ever replaced by earlier arrivals.
"""

import contextlib
import hashlib
import json
import logging
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from sphere_nmpc.cache import cache_folder
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, nearer_sign, state_error
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver, Effort
from sphere_nmpc.strategy.time_optimal.search import ARRIVED, ArrivalSearch
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.processes import Processes
from sphere_sim.study.progress import shown

_log = logging.getLogger("sphere_nmpc")

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
    scenarios: Sequence[Scenario], robot: RobotParameters | None = None, jobs: int = 1
) -> list[float]:
    """Return the best known time of each scenario [s], from the cache where it is known.

    A cache that cannot be used is told; all times are searched for then.

    Parameters
    ----------
    scenarios : sequence of Scenario
        Where from and where to.
    robot : RobotParameters, optional
        True parameters and limits; Table 1 by default.
    jobs : int, optional
        Processes; with 1 the search is done in this one.

    Raises
    ------
    WorkersError
        If the processes cannot be started or die.
    """
    robot = RobotParameters() if robot is None else robot
    cache = _Cache(cache_folder() / "best_known_times.jsonl")
    keys = [_key(scenario, robot) for scenario in scenarios]
    missing = {key: s for key, s in zip(keys, scenarios, strict=True) if key not in cache.known}
    if missing:
        columns = Progress.get_default_columns()
        bar = Progress(*columns, console=Console(stderr=True), transient=True)
        with Processes(jobs) as processes, shown(bar) as progress:
            task = progress.add_task("best known times", total=len(missing))
            searches = ((key, (scenario, robot)) for key, scenario in missing.items())
            for key, seconds in processes.run(best_known_time, searches, "search"):
                cache.add(key, seconds)
                progress.advance(task)
    return [cache.known[key] for key in keys]


def _key(scenario: Scenario, robot: RobotParameters) -> str:
    """Name a problem by what decides its answer, to nine digits."""
    limits = (robot.max_rotor_speed, robot.max_rotor_acceleration, SEARCHES, EFFORT)
    numbers = [*scenario.start, *scenario.goal, *robot.lumped.as_array(), *limits]
    text = " ".join(f"{float(number):.9g}" for number in numbers)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


class _Cache:
    """Times that were found before, in a file that a search can do without."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._is_kept = True
        self.known: dict[str, float] = {}
        try:
            # Anything but a regular file might be read for ever.
            if path.exists() and not path.is_file():
                raise OSError("not a file")
            text = path.read_bytes() if path.exists() else b""
        except OSError as error:
            self._tell("read", error)
            return
        # Torn lines, as a crash leaves them, are passed over.
        for line in text.splitlines():
            with contextlib.suppress(ValueError, TypeError, RecursionError):
                key, seconds = json.loads(line.decode())
                if not (float(seconds) < 0.0 or math.isinf(seconds)):
                    self.known[str(key)] = float(np.fmin(self.known.get(key, np.nan), seconds))

    def add(self, key: str, seconds: float) -> None:
        self.known[key] = seconds
        if not self._is_kept:
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps([key, seconds]) + "\n")
        except OSError as error:
            self._tell("written", error)

    def _tell(self, what: str, error: OSError) -> None:
        self._is_kept = False
        _log.warning(
            "sphere_nmpc study: %s cannot be %s (%s); best known times are not kept, and searched "
            "for again next time", self._path, what, error.strerror or error,
        )

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops of all benchmarked solvers, case by case and round by round.

A solver runs a case from start to end, as it would in a controller; if the solvers alternated at
each sampling instant, each would find the processor's caches filled by another one. Their order
rotates, so that other load of the machine affects all of them alike. Each run has its own plant
(`sphere_sim.world.plant`), which integrates by another method than any solver predicts with.
"""

import contextlib
import gc
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from sphere_nmpc.model.state import INPUT_SIZE
from sphere_sim.benchmark.problem import ROBOT, SAMPLE_PERIOD, BenchmarkedSolver, Maker
from sphere_sim.evaluation.metrics import settling_index, state_errors
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.world.plant.rolling_plant import RollingPlant

_SOLVE_ERRORS = (RuntimeError, ArithmeticError, ValueError)
WARM_UP_SOLVES, WARM_UP_SECONDS = 3, 0.5
OUTPUTS_PER_SAMPLE = 5
"""Evaluations of the error in a sample period, as it may rise between two sampling instants."""


@dataclass(eq=False)
class SolverRecord:
    """Times, settling times and failures of one solver."""

    solver: BenchmarkedSolver
    setup_s: float = 0.0
    """Time of the set-up, compilation included [s]."""
    wall: list[float] = field(default_factory=list)
    """Wall time of each solve [s]."""
    cpu: list[float] = field(default_factory=list)
    """Processor time of each solve [s]."""
    settle: list[float | None] = field(default_factory=list)
    """Settling time of each case [s]; None where the run did not settle or was stopped."""
    failures: int = 0
    """Solves that raised an exception or of which the solver itself reports no success."""
    stopped: bool = False
    """Whether its remaining runs were cancelled as its time budget was spent."""
    spent: float = 0.0
    """Wall time of all solves [s]."""

    def run(
        self, scenario: Scenario, samples: int, budget: float
    ) -> Generator[None, None, float | None]:
        """Run a case for a number of samples; yield after every solve.

        Returns the settling time [s]; None where the run did not settle, or was stopped as more
        than `budget` [s] had been spent.
        """
        self._warm_up(scenario)
        plant = RollingPlant(ROBOT, scenario.start)
        states = [plant.state]
        # Else the solve in which the collector starts would last longer.
        gc.collect()
        gc.disable()
        try:
            for _ in range(samples):
                self._sample(plant, states)
                self.stopped = self.spent > budget
                if self.stopped:
                    return None
                yield
        finally:
            gc.enable()
        index = settling_index(state_errors(np.array(states), scenario.goal))
        return None if index is None else round(index * SAMPLE_PERIOD / OUTPUTS_PER_SAMPLE, 9)

    def _warm_up(self, scenario: Scenario) -> None:
        self.solver.start(scenario.goal)
        # An error here occurs again in the run, where it is counted.
        with contextlib.suppress(*_SOLVE_ERRORS):
            began = time.perf_counter()
            for _ in range(WARM_UP_SOLVES):
                self.solver.solve(scenario.start, np.zeros(INPUT_SIZE))
                if time.perf_counter() - began > WARM_UP_SECONDS:
                    break
        self.solver.start(scenario.goal)

    def _sample(self, plant: RollingPlant, states: list[np.ndarray]) -> None:
        state, in_force = plant.state, plant.rotor_speeds
        speeds, took = in_force * 0.0, None
        wall, cpu = time.perf_counter(), time.thread_time()
        try:
            answer = self.solver.solve(state, in_force)
            solved, speeds, took = answer.solved, answer.speeds, answer.took
        except _SOLVE_ERRORS:
            solved = False
        cpu, wall = time.thread_time() - cpu, time.perf_counter() - wall
        wall, cpu = took or (wall, cpu)
        self.wall.append(wall)
        self.cpu.append(cpu)
        self.spent += wall
        self.failures += not solved
        for k in range(1, OUTPUTS_PER_SAMPLE + 1):
            share = k / OUTPUTS_PER_SAMPLE
            reference = in_force + share * (speeds - in_force)
            plant.advance(reference, SAMPLE_PERIOD / OUTPUTS_PER_SAMPLE)
            states.append(plant.state)


def set_up(
    makers: dict[str, Maker], report: Callable[[str], None]
) -> tuple[dict[str, SolverRecord], dict[str, str]]:
    """Set solvers up, each by its maker; `report` is called with each name before.

    Returns the empty records of those that could be set up, and the reasons for the others.
    """
    records: dict[str, SolverRecord] = {}
    missing: dict[str, str] = {}
    for name, make in makers.items():
        report(name)
        began = time.perf_counter()
        try:
            solver = make()
        except ModuleNotFoundError as error:
            missing[name] = f"not installed ({error.name or error})"
        except Exception as error:
            # The others are benchmarked all the same.
            first_line, *_ = str(error).splitlines() or [type(error).__name__]
            missing[name] = f"could not be set up: {first_line[:120]}"
        else:
            records[name] = SolverRecord(solver, time.perf_counter() - began)
    return records, missing


def run_closed_loops(
    records: dict[str, SolverRecord],
    scenarios: Sequence[Scenario],
    samples: int,
    rounds: int,
    budget: float,
) -> Iterator[None]:
    """Run all cases `rounds` times, each for a number of samples; yield after every solve.

    The records from `set_up` are filled; settling times are those of the first round. A solver may
    spend the wall time `budget` [s] in all its solves.
    """
    for turn in range(rounds):
        for place, scenario in enumerate(scenarios):
            turned = list(records.values())
            shift = (turn + place) % len(turned)
            for record in turned[shift:] + turned[:shift]:
                settled = None
                if not record.stopped:
                    settled = yield from record.run(scenario, samples, budget)
                if turn == 0:
                    record.settle.append(settled)

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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from sphere_nmpc.model.state import INPUT_SIZE, Vector
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
    """Times, settling times and failures of one solver.

    Attributes
    ----------
    wall, cpu : list of float
        Wall and processor time of each solve [s].
    settle : list of (float or None)
        Settling time of each case [s]; None where the run did not settle or was stopped.
    failures : int
        Solves that raised an exception or of which the solver itself reports no success.
    setup_s : float
        Time of the set-up, compilation included [s].
    stopped : bool
        Whether its remaining runs were cancelled as its time budget was spent.
    spent : float
        Wall time of all solves [s].
    """

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    settle: list[float | None] = field(default_factory=list)
    failures: int = 0
    setup_s: float = 0.0
    stopped: bool = False
    spent: float = 0.0


class _Runner:
    """One solver in one run."""

    def __init__(
        self, solver: BenchmarkedSolver, record: SolverRecord, scenario: Scenario
    ) -> None:
        self.solver, self.record = solver, record
        self._goal = scenario.goal
        solver.start(scenario.goal)
        # An error here occurs again in the run, where it is counted.
        with contextlib.suppress(*_SOLVE_ERRORS):
            began = time.perf_counter()
            for _ in range(WARM_UP_SOLVES):
                solver.solve(scenario.start, np.zeros(INPUT_SIZE))
                if time.perf_counter() - began > WARM_UP_SECONDS:
                    break
        solver.start(scenario.goal)
        self._plant = RollingPlant(ROBOT, scenario.start)
        self._states = [self._plant.state]

    def samples(self, number: int, budget: float) -> Iterator[None]:
        # Else the solve in which the collector starts would last longer.
        gc.collect()
        gc.disable()
        try:
            for _ in range(number):
                self.sample()
                self.record.stopped = self.record.spent > budget
                if self.record.stopped:
                    break
                yield
        finally:
            gc.enable()

    def sample(self) -> None:
        state, in_force = self._plant.state, self._plant.rotor_speeds
        speeds, took = in_force * 0.0, None
        wall, cpu = time.perf_counter(), time.thread_time()
        try:
            answer = self.solver.solve(state, in_force)
            solved, speeds, took = answer.solved, answer.speeds, answer.took
        except _SOLVE_ERRORS:
            solved = False
        cpu, wall = time.thread_time() - cpu, time.perf_counter() - wall
        wall, cpu = took or (wall, cpu)
        self.record.wall.append(wall)
        self.record.cpu.append(cpu)
        self.record.spent += wall
        self.record.failures += not solved
        for k in range(1, OUTPUTS_PER_SAMPLE + 1):
            share = k / OUTPUTS_PER_SAMPLE
            reference = in_force + share * (speeds - in_force)
            self._plant.advance(reference, SAMPLE_PERIOD / OUTPUTS_PER_SAMPLE)
            self._states.append(self._plant.state)

    def settling_time(self) -> float | None:
        errors: Vector = state_errors(np.array(self._states), self._goal)
        index = settling_index(errors)
        return None if index is None else round(index * SAMPLE_PERIOD / OUTPUTS_PER_SAMPLE, 9)


def set_up(
    makers: dict[str, Maker], report: Callable[[str], None]
) -> tuple[dict[str, BenchmarkedSolver], dict[str, SolverRecord], dict[str, str]]:
    """Set solvers up.

    Parameters
    ----------
    makers : dict of str to callable
        For each name a function that sets the solver up.
    report : callable
        Is called with each name before the set-up.

    Returns
    -------
    solvers : dict of str to BenchmarkedSolver
        Those that could be set up.
    records : dict of str to SolverRecord
        Their empty records.
    missing : dict of str to str
        The reason for each of the others.
    """
    solvers: dict[str, BenchmarkedSolver] = {}
    records: dict[str, SolverRecord] = {}
    missing: dict[str, str] = {}
    for name, make in makers.items():
        report(name)
        began = time.perf_counter()
        try:
            solvers[name] = make()
        except ModuleNotFoundError as error:
            missing[name] = f"not installed ({error.name or error})"
        except Exception as error:
            # The others are benchmarked all the same.
            first_line, *_ = str(error).splitlines() or [type(error).__name__]
            missing[name] = f"could not be set up: {first_line[:120]}"
        else:
            records[name] = SolverRecord(setup_s=time.perf_counter() - began)
    return solvers, records, missing


def run_closed_loops(
    solvers: dict[str, BenchmarkedSolver],
    records: dict[str, SolverRecord],
    scenarios: Sequence[Scenario],
    samples: int,
    rounds: int,
    budget: float,
) -> Iterator[None]:
    """Run all closed loops.

    Parameters
    ----------
    solvers, records
        From `set_up`; the records are filled.
    scenarios : sequence of Scenario
        The cases.
    samples : int
        Sampling instants of a run.
    rounds : int
        How often all cases are run; settling times are those of the first round.
    budget : float
        Wall time that a solver may spend in all its solves [s].

    Yields
    ------
    None
        After every solve.
    """
    for turn in range(rounds):
        for place, scenario in enumerate(scenarios):
            names = list(solvers)
            shift = (turn + place) % len(names)
            for name in names[shift:] + names[:shift]:
                settled = None
                if not records[name].stopped:
                    runner = _Runner(solvers[name], records[name], scenario)
                    for _ in runner.samples(samples, budget):
                        yield
                    settled = None if records[name].stopped else runner.settling_time()
                if turn == 0:
                    records[name].settle.append(settled)

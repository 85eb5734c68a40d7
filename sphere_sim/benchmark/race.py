# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops of all contenders in turn, case by case and round by round.

A contender runs a case from end to end, as it would in a controller of its own; taking turns at
every sample instead would have each pay for the caches that the one before it has filled. The
order rotates, so that whatever else the machine does meanwhile hits all of them alike. Each has a
world of its own, the plant of `sphere_sim.world.plant`, which integrates by another method than
any solver predicts with.
"""

import contextlib
import gc
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_sim.benchmark.contender import ROBOT, SAMPLE_PERIOD, Contender, Maker
from sphere_sim.evaluation.metrics import settling_index, state_errors
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.world.plant.rolling_plant import RollingPlant

_SOLVE_ERRORS = (RuntimeError, ArithmeticError, ValueError)
WARM_UP_SOLVES, WARM_UP_SECONDS = 3, 0.5
OUTPUTS_PER_SAMPLE = 5
"""The error is looked at every 0.1 s, as it may rise again between two samples."""


@dataclass(eq=False)
class Record:
    """What one contender has done.

    Attributes
    ----------
    wall, cpu : list of float
        Time of every solve as its caller saw it, and the thread's processor time [s].
    settle : list of (float or None)
        Settling time of each case [s]; None where it never settled or was stopped.
    failures : int
        Solves that raised or did not succeed by the contender's own account.
    setup_s : float
        How long it took to set up, compilation included [s].
    stopped : bool
        Whether it was taken out as its time was up.
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
    """One contender in one run."""

    def __init__(self, contender: Contender, record: Record, scenario: Scenario) -> None:
        self.contender, self.record = contender, record
        self._goal = scenario.goal
        contender.start(scenario.goal)
        # What fails here fails again when it counts.
        with contextlib.suppress(*_SOLVE_ERRORS):
            began = time.perf_counter()
            for _ in range(WARM_UP_SOLVES):
                contender.solve(scenario.start, np.zeros(INPUT_SIZE))
                if time.perf_counter() - began > WARM_UP_SECONDS:
                    break
        contender.start(scenario.goal)
        self._plant = RollingPlant(ROBOT, scenario.start)
        self._states = [self._plant.state]

    def samples(self, number: int, budget: float) -> Iterator[None]:
        # The collector would charge one contender for what another has left behind.
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
            answer = self.contender.solve(state, in_force)
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
            there = in_force + share * (speeds - in_force)
            self._plant.advance(there, SAMPLE_PERIOD / OUTPUTS_PER_SAMPLE)
            self._states.append(self._plant.state)

    def settling_time(self) -> float | None:
        errors: Vector = state_errors(np.array(self._states), self._goal)
        index = settling_index(errors)
        return None if index is None else round(index * SAMPLE_PERIOD / OUTPUTS_PER_SAMPLE, 9)


def set_up(
    makers: dict[str, Maker], told: Callable[[str], None]
) -> tuple[dict[str, Contender], dict[str, Record], dict[str, str]]:
    """Return the contenders that can be had, their empty records, and why the others cannot."""
    contenders: dict[str, Contender] = {}
    records: dict[str, Record] = {}
    missing: dict[str, str] = {}
    for name, make in makers.items():
        told(name)
        began = time.perf_counter()
        try:
            contenders[name] = make()
        except ModuleNotFoundError as error:
            missing[name] = f"not installed ({error.name or error})"
        except Exception as error:
            # A peer that breaks must not take the others with it; its reason is reported.
            missing[name] = f"could not be set up: {str(error).splitlines()[0][:120]}"
        else:
            records[name] = Record(setup_s=time.perf_counter() - began)
    return contenders, records, missing


def race(
    contenders: dict[str, Contender],
    records: dict[str, Record],
    scenarios: Sequence[Scenario],
    samples: int,
    rounds: int,
    budget: float,
) -> Iterator[None]:
    """Run all closed loops.

    Parameters
    ----------
    contenders, records
        From `set_up`; the records are filled.
    scenarios : sequence of Scenario
        The cases.
    samples : int
        Sample instants of a run.
    rounds : int
        How often all cases are run; settling times are those of the first.
    budget : float
        Wall time a contender may spend in its solves, all in all [s].

    Yields
    ------
    None
        After every solve.
    """
    for turn in range(rounds):
        for place, scenario in enumerate(scenarios):
            names = list(contenders)
            shift = (turn + place) % len(names)
            for name in names[shift:] + names[:shift]:
                settled = None
                if not records[name].stopped:
                    runner = _Runner(contenders[name], records[name], scenario)
                    for _ in runner.samples(samples, budget):
                        yield
                    settled = None if records[name].stopped else runner.settling_time()
                if turn == 0:
                    records[name].settle.append(settled)

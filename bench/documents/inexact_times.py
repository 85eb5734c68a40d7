# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops with stamps that are not the times of measurement, lost poses, and late commands.

``python bench/documents/inexact_times.py`` prints a table for docs/algorithm.md: the ideal plant,
nominal parameters, no ROS, so that the load of the machine does not matter. Each run is compared
with that of exact times at the same pose rate: settling time (error below 1e-2 from then on), and
the largest distance from the goal over that at the start.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from tables import Row, Table, print_tables

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import POSE, Vector, make_state
from sphere_sim.evaluation.metrics import position_errors, state_errors
from sphere_sim.scenario.scenarios import PAPER_CASES, Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import prepare

_CONDITIONS = StudyConditions(20.0)
RATES = 20, 50, 200
"""Pose rates [Hz]."""
SETTLED = 1e-2
_MS = 1_000_000
_BUNCH, _APART = 60, 0.3
"""Time over which poses gather in a bunch, and spacing of the stamps within one [ms]."""

POSES = (
    "exact", "late 5", "late 10", "late 20", "steps 10", "steps 16", "steps 50", "bunches",
    "lost", "outliers",
)
"""Kinds of poses; numbers are in ms."""
COMMANDS = ("late", "lost")
"""Kinds of commands that are not all in time."""


def stamped(
    kind: str, instants: Vector, rng: np.random.Generator
) -> list[tuple[float, float, float, bool]]:
    """Return arrival, stamp and time of measurement of poses [ms], and whether each is wrong.

    They are measured at `instants` [ms] and in the order of their arrival.
    """
    name, _, size = kind.partition(" ")
    found = []
    for k, time in enumerate(instants.tolist()):
        stamp, arrives, wrong = time, time, False
        if name == "late":
            arrives = stamp = time + float(size) * rng.random()
        elif name == "early":
            stamp = time - float(size) * rng.random()
        elif name == "steps":
            stamp = float(size) * math.floor(time / float(size))
        elif name == "bunches":
            first = math.ceil(time / _BUNCH) * _BUNCH
            spacing = instants[1] - instants[0]
            place = round((time - (first - _BUNCH)) / spacing)
            arrives = stamp = first + _APART * place
        elif name == "lost" and rng.random() < 0.2:
            continue
        elif name == "outliers":
            wrong = k % 40 == 30
        found.append((arrives, stamp, time, wrong))
    return sorted(found)


def run(
    scenario: Scenario, poses: str, commands: str, rate: int, measured: bool, duration: float
) -> tuple[float, float, float, float]:
    """Run a loop.

    Returns the settling time [s], inf without one, the largest distance from the goal beyond
    that at the start [m], the largest momentum that was believed [rad/s], and the final error.
    """
    rng = np.random.default_rng(scenario.seed)
    simulator, controller = prepare(_CONDITIONS, scenario)
    controller.set_goal(scenario.goal)
    period = 1000.0 / rate
    instants = np.array([k * period for k in range(round(1e3 * duration / period))])
    due = stamped(poses, instants, rng)
    measurements = iter(instants.tolist())
    states: dict[float, Vector] = {}
    next_measured = next(measurements)
    on_way: list[tuple[float, FirstOrderHold]] = []
    control = round(1e3 * _CONDITIONS.controller.control_period)
    trajectory, momentum = [], 0.0
    lost = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    for now in range(round(1e3 * duration)):
        while next_measured <= now:
            # Poses are measured at the millisecond in which they are due.
            states[next_measured] = simulator.measured_state()
            next_measured = next(measurements, math.inf)
        while due and due[0][0] <= now:
            _, stamp, time, wrong = due.pop(0)
            controller.observe(1e-3 * stamp, lost if wrong else states[time])
        if measured and now % 10 == 0:
            controller.observe_rotors(1e-3 * now, simulator.plant.rotor_speeds)
        if now % control == 0:
            decision = controller.decide(1e-3 * now)
            momentum = max(momentum, float(np.linalg.norm(decision.momentum)))
            hold = controller.commit(decision, 1e-3 * now)
            late = 0.0
            if commands != "in time" and rng.random() < 0.2:
                late = rng.uniform(50.0, 250.0) if commands == "late" else math.inf
            if hold is not None:
                on_way.append((now + late, hold))
        for hold in [one[1] for one in on_way if one[0] <= now]:
            if simulator.follower.is_newer(hold):
                simulator.follower.follow_trajectory(hold)
        on_way = [one for one in on_way if one[0] > now]
        trajectory.append(simulator.plant.state[POSE])
        simulator.advance_to((now + 1) * _MS)
    path = np.array(trajectory)
    errors = state_errors(path, scenario.goal)
    late_errors = np.flatnonzero(~(errors < SETTLED))
    first = int(late_errors[-1]) + 1 if late_errors.size else 0
    settled = 1e-3 * first if first < len(path) - 500 else math.inf
    away = position_errors(path, scenario.goal)
    return settled, float(np.max(away) - away[0]), momentum, float(errors[-1])


def scenarios(seeds: list[int]) -> list[Scenario]:
    """Return the paper's cases 1 and 3 and a drawn scenario, one for each seed in turn."""
    drawn = draw_scenarios(1, 1)[0]
    chosen = (PAPER_CASES[3], PAPER_CASES[1], drawn)
    return [replace(chosen[k % 3], seed=seed) for k, seed in enumerate(seeds)]


def _rows(number: int, seed: int) -> Iterator[Row]:
    chosen = scenarios(list(range(seed, seed + number)))
    links = [(poses, "in time", False) for poses in POSES]
    links[1:1] = product(("exact",), COMMANDS, (False, True))
    for poses, commands, measured in links:
        yield Row((poses, commands, "yes" if measured else "no"), [
            (scenario, poses, commands, rate, measured, _CONDITIONS.duration)
            for rate in RATES for scenario in chosen
        ])


def _cells(found: list[Any], exact: list[Any]) -> Iterator[object]:
    by_rate = np.reshape(found, (len(RATES), -1, 4))
    ratios = by_rate[:, :, 0] / np.reshape(exact, by_rate.shape)[:, :, 0]
    for of_rate, ratio in zip(by_rate, ratios, strict=True):
        yield f"{np.max(ratio):.2f} ({np.max(of_rate[:, 2]):.2g})"
    yield from (np.sum(~(ratios <= 2.0)), f"{np.max(by_rate[:, :, 1]):.2f}",
                f"{np.max(by_rate[:, :, 3]):.1e}")


TABLE = Table(
    ("poses", "commands", "joint states",
     *(f"{rate} Hz: over exact times, worst (largest momentum [rad/s])" for rate in RATES),
     "longer than twice", "farther than at the start [m]", "final error, worst"),
    _rows, run, _cells, number=3, has_reference=True,
)

if __name__ == "__main__":
    print_tables({"": TABLE}, __doc__)

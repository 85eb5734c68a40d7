# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops with stamps that are not the times of measurement, lost poses, and late commands.

``python bench/documents/inexact_times.py --seeds 1 2 3`` prints a table for docs/algorithm.md: the
ideal plant, nominal parameters, no ROS, so that the load of the machine does not matter. Each run
is compared with that of exact times at the same pose rate: settling time (error below 1e-2 from
then on), and the largest distance from the goal over that at the start.
"""

import argparse
import math
from dataclasses import replace
from itertools import product

import numpy as np
from tables import header, in_processes, row

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, Vector, make_state
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.metrics import position_errors, state_errors
from sphere_sim.scenario.scenarios import PAPER_CASES, Scenario, draw_scenarios
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
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
COMMANDS = ("in time", "late", "lost")


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
    scenario: Scenario, poses: str, commands: str, rate: int, measured: bool, duration: float,
    settings: ControllerSettings | None = None,
) -> tuple[float, float, float, float]:
    """Run a loop.

    Returns the settling time [s], inf without one, the largest distance from the goal beyond
    that at the start [m], the largest momentum that was believed [rad/s], and the final error.
    """
    rng = np.random.default_rng(scenario.seed)
    settings = settings or ControllerSettings()
    simulator = Simulator(
        SimulatorSettings(initial_state=tuple(scenario.start)), ROBOT,
        make_plant("rolling", ROBOT, scenario.start),
    )
    controller = Controller(settings, ROBOT)
    controller.set_goal(scenario.goal)
    period = 1000.0 / rate
    instants = np.array([k * period for k in range(round(1e3 * duration / period))])
    due = stamped(poses, instants, rng)
    measurements = iter(instants.tolist())
    states: dict[float, Vector] = {}
    next_measured = next(measurements)
    on_way: list[tuple[float, FirstOrderHold]] = []
    control = round(1e3 * settings.control_period)
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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--rates", type=int, nargs="+", default=RATES)
    parser.add_argument("--poses", nargs="+", default=POSES)
    parser.add_argument("--commands", nargs="+", default=COMMANDS)
    parser.add_argument("--duration", type=float, default=20.0)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    limit_library_threads()
    links = [
        (commands, measured) for commands in given.commands
        for measured in ((False,) if commands == "in time" else (False, True))
    ]
    cells = [
        (rate, poses, commands, measured)
        for rate, poses, (commands, measured) in product(given.rates, given.poses, links)
        if poses == "exact" or commands == "in time"
    ]
    chosen = scenarios(given.seeds)
    tasks = [
        (scenario, poses, commands, rate, measured, given.duration)
        for rate, poses, commands, measured in cells for scenario in chosen
    ]
    exact = [(s, "exact", "in time", rate, False, given.duration) for rate in given.rates
             for s in chosen]
    results = list(in_processes(run, [*exact, *tasks], given.jobs))
    count = len(chosen)
    reference = {
        rate: np.array(results[k * count : (k + 1) * count])[:, 0]
        for k, rate in enumerate(given.rates)
    }
    results = results[len(exact) :]
    print(header("rate [Hz]", "poses", "commands", "joint states", "settles [s]",
                 "over exact times, worst", "farther than at the start [m]",
                 "largest momentum [rad/s]", "final error, worst"))
    bad = 0
    for k, (rate, poses, commands, measured) in enumerate(cells):
        found = np.array(results[k * count : (k + 1) * count])
        ratio = float(np.max(found[:, 0] / reference[rate]))
        bad += int(np.sum(~(found[:, 0] / reference[rate] <= 2.0)))
        print(row(
            rate, poses, commands, "yes" if measured else "no",
            " ".join(f"{value:.2f}" for value in found[:, 0]), f"{ratio:.2f}",
            f"{np.max(found[:, 1]):.2f}", f"{np.max(found[:, 2]):.2g}",
            f"{np.max(found[:, 3]):.1e}",
        ), flush=True)
    print(f"\n{bad} of {len(results)} runs take longer than twice the exact time")


if __name__ == "__main__":
    main()

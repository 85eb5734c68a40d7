# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""How long a sphere stays at its goal on a slope or out of balance, of the time that it could.

``python bench/documents/momentum_holding.py --runs 48`` prints a table for docs/momentum.md:
closed loops on ``rigid_body`` with parameters wrong by 3 %, to drawn upright goals. A sphere has
arrived when its error falls below 1e-2 for half a second and stays until the error exceeds it. It
could stay until a rotor at rest at the goal would be at its limit, with the true momentum and
torques of the plant; what it could not reach before that is not counted.
"""

import argparse
import math
from dataclasses import dataclass

import numpy as np
from tables import header, in_processes, median_and_worst, row

from sphere_nmpc.model.disturbance import Disturbance, time_to_saturation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.quantity import NANOSECONDS
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.evaluation.metrics import SETTLED_ERROR, state_errors
from sphere_sim.scenario.perturbation import DisturbanceDraws, perturbed
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.motion import disturbance_of
from sphere_sim.study.single_run import prepare
from sphere_sim.world.disturbances import DisturbanceSettings

PERTURBATION = 3.0
"""Largest error of the parameters [%]."""
SEED = 31
DWELL, OUTPUT = 0.5, 0.02
"""Time for which the error has to be small for an arrival, and spacing of a run's rows [s]."""


@dataclass(frozen=True)
class Case:
    """Disturbance of a row of the table.

    Inclination [deg], distance of the centre of mass from the centre [mm], rolling friction [mm],
    and length of a run [s].
    """

    name: str
    slope: float = 0.0
    offset: float = 0.0
    friction: float = 0.0
    duration: float = 30.0


CASES = (
    Case("slope 0.1°", slope=0.1),
    Case("slope 0.5°", slope=0.5, duration=15.0),
    Case("slope 1°", slope=1.0, duration=10.0),
    Case("0.5 mm off", offset=0.5),
    Case("1 mm off", offset=1.0),
    Case("2 mm off", offset=2.0),
    Case("1 mm off, rolling friction 0.1 mm", offset=1.0, friction=0.1),
)


@dataclass(frozen=True)
class Stay:
    """Times of a run [s]."""

    arrived: float = math.nan
    """Arrival; nan if there is none."""
    left: float = math.nan
    """End of the stay; that of the run for a sphere that stays."""
    limit: float = math.inf
    """When a rotor is at its limit; inf if that does not happen."""
    predicted: float = math.nan
    """Time from the arrival to saturation that the controller predicted."""


def run(case: Case, index: int) -> Stay:
    """Run a drawn scenario."""
    draws = DisturbanceDraws(slope=math.radians(case.slope), offset=1e-3 * case.offset)
    scenario = draws.applied_to(draw_scenarios(index + 1, SEED, "upright")[index])
    settings = [("simulator.plant", "rigid_body"), ("rolling_friction", str(1e-3 * case.friction))]
    conditions = StudyConditions(case.duration, PERTURBATION).with_settings(settings)
    simulator, controller = prepare(conditions, scenario)
    momenta: dict[int, Vector] = {}
    advance = simulator.advance_to

    def record(then: int) -> None:
        momenta[simulator.now] = simulator.plant.momentum
        advance(then)

    simulator.advance_to = record  # type: ignore[method-assign]
    period = conditions.controller.control_period
    found = run_closed_loop(simulator, controller, scenario.goal, case.duration, period, OUTPUT)
    small = state_errors(found.states, scenario.goal) < SETTLED_ERROR
    rows = round(DWELL / OUTPUT)
    starts = [i for i in range(small.size - rows) if small[i : i + rows].all()]
    if not starts:
        return Stay()
    first = starts[0]
    outside = np.flatnonzero(~small[first:])
    left = found.times[first + int(outside[0])] if outside.size else case.duration
    arrived, robot = float(found.times[first]), conditions.robot
    # The sampling instant after the arrival, at which the controller holds.
    instant = math.ceil(arrived / period) * period
    truth = _truth(
        scenario.disturbances, robot, scenario.seed, momenta[round(instant * NANOSECONDS)]
    )
    turn, limit = scenario.goal[QUATERNION], robot.max_rotor_speed
    decision = found.decisions[round(instant / period)]
    estimated = time_to_saturation(decision.momentum, decision.disturbance, turn, limit)
    return Stay(
        arrived, float(left), instant + time_to_saturation(*truth, turn, limit),
        instant + estimated - arrived,
    )


def _truth(
    disturbances: dict[str, float], robot: RobotParameters, seed: int, momentum: Vector
) -> tuple[Vector, Disturbance]:
    """Return an angular momentum [N m s] and the disturbance in the units of the robot drawn."""
    robot = perturbed(robot, PERTURBATION / 100.0, np.random.default_rng([seed, 2]))
    settings = DisturbanceSettings(**disturbances)
    return momentum / robot.rotor_axial_inertia, disturbance_of(settings, robot)


def _row(case: Case, stays: list[Stay]) -> str:
    arrived = [o for o in stays if not math.isnan(o.arrived)]
    possible = [o for o in arrived if min(o.limit, case.duration) > o.arrived + DWELL]
    shares = [
        (o.left - o.arrived) / (min(o.limit, case.duration) - o.arrived) for o in possible
    ]
    errors = [
        abs(o.predicted / (o.limit - o.arrived) - 1.0) for o in possible
        if math.isfinite(o.limit)
    ]
    return row(
        case.name, f"{len(arrived)} of {len(stays)}",
        median_and_worst([o.arrived for o in arrived], ".1f"),
        f"{sum(share >= 0.8 for share in shares)} of {len(shares)}",
        f"{np.median(shares):.2f} ({min(shares):.2f})" if shares else "-",
        f"{100 * np.median(errors):.1f} % ({100 * max(errors):.1f} %)" if errors else "-",
    )


def main() -> None:
    """Print a row for each disturbance."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=48)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--cases", type=int, nargs="+", default=list(range(len(CASES))))
    arguments = parser.parse_args()
    print(header(
        "disturbance", "arrived", "after, median (worst) [s]", "stayed 80 % of the time it could",
        "share of it, median (least)", "predicted time to saturation off by, median (worst)",
    ))
    for case in (CASES[i] for i in arguments.cases):
        tasks = [(case, index) for index in range(arguments.runs)]
        print(_row(case, in_processes(run, tasks, arguments.jobs)), flush=True)


if __name__ == "__main__":
    main()

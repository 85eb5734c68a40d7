# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""One run of a study: the closed loop of a scenario and its results."""

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from functools import lru_cache

import numpy as np

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.stability import Sample, StabilityMonitor
from sphere_nmpc.errors import printable_line
from sphere_nmpc.estimation.rotor_history import enter, knots_of
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.settings import FloorSettings
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, POSITION, Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Strategy
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.metrics import (
    LOOSELY_SETTLED,
    measure,
    measure_along,
    stay_below,
)
from sphere_sim.evaluation.odometry_poses import OdometryPoses
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.record import (
    ODOMETRY_RESULT_COLUMNS,
    PATH_RESULT_COLUMNS,
    RunRecord,
    Value,
    finite,
)
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.simulator import Simulator
from sphere_sim.world.walls import Contact, Walls, walls_of

StrategyMaker = Callable[[ControllerSettings, RobotParameters], Strategy]
"""Makes the strategy of a run, instead of the one that the settings name."""

_ROUNDING = 1e-9


@lru_cache(maxsize=1)
def floor_of(settings: FloorSettings, radius: float) -> tuple[Floor, Walls | None]:
    """Return the floor of a sphere of a radius [m] and its walls, those before for the same map.

    `InvalidMapError` is raised if the map file cannot be used.
    """
    floor = settings.whole(radius)
    return floor, None if floor.is_empty else walls_of(floor.grid)


def prepare(
    conditions: StudyConditions, scenario: Scenario, make: StrategyMaker | None = None
) -> tuple[Simulator, Controller]:
    """Return simulator and controller of a run, with the true robot drawn by the scenario's seed.

    An error is raised if the settings do not fit together or the plant's package is missing.
    """
    # Streams 0, 1 and 3 of this seed belong to the simulator.
    rng = np.random.default_rng([scenario.seed, 2])
    robot = perturbed(conditions.robot, conditions.perturbation / 100.0, rng)
    return assemble(conditions, scenario, robot, make)


def assemble(
    conditions: StudyConditions, scenario: Scenario, robot: RobotParameters,
    make: StrategyMaker | None = None,
) -> tuple[Simulator, Controller]:
    """Return simulator and controller of a run; the controller has the nominal parameters."""
    settings = conditions.controller
    if scenario.path_speed is not None:
        settings = replace(settings, path_speed=scenario.path_speed)
    simulation = replace(
        conditions.simulator, initial_state=tuple(scenario.start), seed=scenario.seed
    )
    disturbances = replace(conditions.disturbances, **scenario.disturbances)
    # The limits of the drives are those of the nominal robot.
    own = conditions.of_plant.for_robot(conditions.robot)
    floor, walls = floor_of(scenario.floor(conditions.floor), conditions.robot.shell_radius)
    plant = make_plant(simulation.plant, robot, scenario.start, own, disturbances, walls)
    strategy = None if make is None else make(settings, conditions.robot)
    controller = Controller(settings, conditions.robot, strategy)
    controller.floor = floor
    imu = conditions.imu if simulation.has_odometry else None
    return Simulator(simulation, robot, plant, imu), controller


def course_of(conditions: StudyConditions, scenario: Scenario) -> Course:
    """Return the course of a run; `InvalidStateError` is raised for too long a path."""
    return scenario.course(conditions.controller.path_tolerance, conditions.robot.shell_radius)


def closed_loop(
    conditions: StudyConditions, scenario: Scenario,
    made: tuple[Simulator, Controller] | None = None, goal: Goal | Course | None = None,
    output_period: float = 0.01, poses: OdometryPoses | None = None,
) -> Trajectory:
    """Make the run of a scenario, by default with what `prepare` returns and its own course.

    For `output_period` and `poses` see `run_closed_loop`.
    """
    simulator, controller = made or prepare(conditions, scenario)
    return run_closed_loop(
        simulator, controller, course_of(conditions, scenario) if goal is None else goal,
        conditions.duration, output_period, conditions.latency, scenario.push, poses,
    )


def run_scenario(
    conditions: StudyConditions, scenario: Scenario, make: StrategyMaker | None = None
) -> RunRecord:
    """Run a scenario and evaluate the run.

    A run that crashes is recorded as such, so that the study continues with the others. That the
    machine cannot make the run (MemoryError, OSError) is no result of it.
    """
    strategy = conditions.controller.strategy
    try:
        course = course_of(conditions, scenario)
        simulator, controller = prepare(conditions, scenario, make)
        poses = None if simulator.imu is None else OdometryPoses(
            simulator, simulator.imu, conditions.odometry, conditions.robot
        )
        made = simulator, controller
        trajectory = closed_loop(conditions, scenario, made, course, poses=poses)
        inputs = followed_inputs(trajectory.holds, conditions.duration)
        results = _results(trajectory, inputs)
        results |= _along(trajectory, course, conditions.robot.shell_radius)
        settling = results["settle_time_s"]
        if scenario.push is not None and trajectory.at_push.size and settling is not None:
            results["recover_s"] = max(0.0, float(settling) - scenario.push.time)
        results |= _contacts(simulator.plant.contact, trajectory)
        if poses is not None:
            results |= dict(zip(ODOMETRY_RESULT_COLUMNS, map(finite, poses.errors()), strict=True))
    except (MemoryError, OSError):
        raise
    except Exception as error:
        crash = f"{type(error).__name__}: {error}"
        return RunRecord({"strategy": strategy, "settled": False, "crash": crash})
    if scenario.follows is None:
        results |= _stability_of(trajectory.decisions, scenario.goal, conditions)
    results = {"strategy": strategy, **results, "failures": controller.failures}
    if controller.failures:
        results["last_failure"] = printable_line(controller.last_failure)
    return RunRecord(results, inputs.times, inputs.speeds, trajectory.at_push)


def _results(trajectory: Trajectory, inputs: FirstOrderHold) -> dict[str, Value]:
    planned = [d.plan.made.solve_time for d in trajectory.decisions if d.solved and d.is_new]
    measured = measure(trajectory, trajectory.goal, np.array(planned))
    turned = trajectory.rotor_speeds
    speeds = np.vstack((turned.values, inputs.speeds))
    results = {name: finite(value) for name, value in asdict(measured).items()}
    stay = stay_below(trajectory.times, trajectory.errors, LOOSELY_SETTLED)
    if stay is not None:
        results["loose_settle_time_s"] = stay.since
        results["tail_error_p95"] = stay.p95
    results["max_rotor_speed"] = _rounded(float(np.max(np.abs(speeds))))
    results["max_rotor_acceleration"] = _rounded(
        max(
            _largest_slope(inputs.times, inputs.speeds),
            _largest_slope(turned.times, turned.values),
        )
    )
    if planned:
        results["solve_ms_max"] = 1e3 * max(planned)
    return results


def _along(trajectory: Trajectory, course: Course, radius: float) -> dict[str, Value]:
    """Return the results of a run along a path; none without one."""
    paths = [leg.follows for leg in course.legs if leg.follows is not None]
    if not paths:
        return {}
    # Half a radius is far more than it rolls from one sample to the next.
    found = measure_along(trajectory.times, trajectory.states[:, POSITION], paths, 0.5 * radius)
    results = dict(zip(PATH_RESULT_COLUMNS, map(finite, found), strict=True))
    # At the start of a closed path the sphere is at its end, too.
    is_there = results["path_time_s"] is not None
    return results if is_there else {**results, "settled": False, "settle_time_s": None}


def _contacts(contact: Contact, trajectory: Trajectory) -> dict[str, Value]:
    """Return the results of a run on a floor with walls; none without walls."""
    if contact.walls is None:
        return {}
    reasons = (
        d.plan.given_up for d in reversed(trajectory.decisions)
        if d.plan.status is PlanStatus.RAMP_TO_REST and d.plan.given_up
    )
    return {
        "contacts": contact.touches,
        "least_clearance_m": contact.least_clearance(trajectory.states[:, POSITION]),
        "reason": next(reasons, None),
    }


def _largest_slope(times: Vector, speeds: Vector) -> float:
    if times.size < 2:
        return 0.0
    slopes = np.diff(speeds, axis=0) / np.diff(times)[:, None]
    return float(np.max(np.abs(slopes)))


def _rounded(value: float) -> float:
    """Return the value without the digits in which difference quotients are inaccurate."""
    return float(f"{value:.9g}")


def followed_inputs(holds: Iterable[FirstOrderHold], duration: float) -> FirstOrderHold:
    """Join all commands of a run into one hold with knots at 0 and `duration` [s].

    The commands are in the order in which they took effect; each replaces the previous ones from
    its first knot on.
    """
    taken = deque[FirstOrderHold]()
    for hold in holds:
        enter(hold, taken)
    return FirstOrderHold(*knots_of(taken, 0.0, duration))


def _stability_of(
    decisions: list[Decision], goal: Vector, conditions: StudyConditions
) -> dict[str, Value]:
    """Count the steps that violate the decrease which a strategy's argument needs.

    The strategy ``paper`` has the value function of Theorem 3, which should decrease by the stage
    cost (Eq. 42) outside the neighbourhood D. ``time_optimal`` has the remaining time to the
    arrival, which has to decrease by the time that passes.

    Returns ``stability_steps`` that could be evaluated and ``stability_violations`` among them.
    """
    if conditions.controller.strategy == "paper":
        return _value_decrease(decisions, goal, conditions)
    arrivals = [d.plan.arrival for d in decisions if d.solved]
    known = [a for a in arrivals if not math.isnan(a)]
    pairs = list(itertools.pairwise(known))
    broken = sum(b > a + _ROUNDING for a, b in pairs)
    return {"stability_steps": len(pairs), "stability_violations": broken}


def _value_decrease(
    decisions: list[Decision], goal: Vector, conditions: StudyConditions
) -> dict[str, Value]:
    monitor = StabilityMonitor()
    settings = conditions.controller
    judged = broken = 0
    for k, decision in enumerate(decisions):
        if decision.state is None or not decision.solved or math.isnan(decision.plan.made.cost):
            continue
        report = monitor.update(
            Sample(
                time=k * settings.control_period,
                state=settings.units.scaled(decision.state[POSE]),
                goal=settings.units.scaled(goal), value=decision.plan.made.cost,
                next_input=decision.plan.hold.speeds[1],
                weights=(
                    settings.alpha, settings.terminal_weight, conditions.robot.max_rotor_speed
                ),
            )
        )
        judged, broken = report.judged, report.violations
    return {"stability_steps": judged, "stability_violations": broken}

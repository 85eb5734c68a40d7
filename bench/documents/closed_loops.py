# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of closed loops without ROS.

    python bench/documents/closed_loops.py cases       # docs/results.md, cases of the paper
    python bench/documents/closed_loops.py robots      # docs/results.md, robots drawn at random
    python bench/documents/closed_loops.py floors      # docs/rigid_body.md, floors and drives
    python bench/documents/closed_loops.py poses       # docs/rigid_body.md, poses of a bad sensor
    python bench/documents/closed_loops.py holding     # docs/momentum.md, how long a goal is held
    python bench/documents/closed_loops.py momentum    # docs/momentum.md, with noisy poses

The documents say what the runs of each are and how they are judged.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from sized_robots import ROBOTS, drawn_robot
from tables import Row, Table, drawn, median_and_worst, print_tables

from sphere_nmpc.model.disturbance import momentum_of_push, rest_speeds, time_to_saturation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.model.units import RobotUnits
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.evaluation.metrics import (
    SETTLED_ERROR,
    angle_errors,
    position_errors,
)
from sphere_sim.scenario.perturbation import DisturbanceDraws, perturbed
from sphere_sim.scenario.scenarios import PAPER_CASES, Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.motion import disturbance_of
from sphere_sim.study.single_run import closed_loop, prepare, run_scenario
from sphere_sim.world.disturbances import DisturbanceSettings, Push

CONTACT = "simulator.plant=rigid_body "


def settling(conditions: StudyConditions, scenario: Scenario) -> float:
    """Return when a run has settled [s]; NaN if it has not."""
    found = run_scenario(conditions, scenario).results["settle_time_s"]
    return math.nan if found is None else float(found)


# The paper's cases, without noise and with exact parameters.


def _of_cases(*_: int) -> Iterator[Row]:
    for plant, strategy in (
        ("rolling", "time_optimal"), ("rolling", "plan_keeping"), ("rolling", "paper"),
        ("rigid_body", "time_optimal"), ("rigid_body", "paper"),
    ):
        settings = f"simulator.plant={plant} controller.strategy={strategy}"
        # The slowest settle after 12.6 s.
        yield Row.of((plant, f"`{strategy}`"), settings, 20.0, PAPER_CASES.values())


CASES = Table(
    ("plant", "strategy", *map(str, PAPER_CASES)), _of_cases, settling,
    lambda found, _: [f"{time:.2f}" for time in found],
)


# Goals that each strategy reaches with robots from 3 cm to 1 m, drawn at random.

_DRAWN = 12
"""Robots that are drawn."""
_ROBOTS_DURATION = 40.0
"""Length of a run [s] with the robot of Table 1. For another it is that in the time of the robot,
and longer by the root of the ratio of radii for a smaller one, to which the goals are farther
away: half as long again as the slowest runs."""


def _of_robots(number: int, seed: int) -> Iterator[Row]:
    robots = [robot for robot in ROBOTS.values() if robot != RobotParameters()]
    names = [name for name, robot in ROBOTS.items() if robot != RobotParameters()]
    robots += [drawn_robot(seed + n) for n in range(_DRAWN)]
    for name, robot in zip([*names, *range(1, _DRAWN + 1)], robots, strict=True):
        units, speed = RobotUnits.of(robot), robot.max_rotor_speed
        plain = StudyConditions(
            _ROBOTS_DURATION * units.time * max(1.0, units.length**-0.5), robot=robot
        )
        goals = drawn(plain, number, seed)
        period = ControllerSettings(strategy="paper").of(robot).period
        yield Row(
            (name, f"{robot.shell_radius:.3f}", f"{speed:.0f}",
             f"{speed / robot.max_rotor_acceleration:.2f}", f"{period:g}"),
            [(replace(plain, controller=ControllerSettings(strategy=strategy)), goal)
             for strategy in STRATEGIES for goal in goals],
        )


def _reached(found: list[float], _: object) -> list[str]:
    settled = np.isfinite(np.reshape(found, (len(STRATEGIES), -1)))
    return [f"{count} of {settled.shape[1]}" for count in settled.sum(axis=1)]


ROBOTS_DRAWN = Table(
    ("robot", "radius [m]", "largest speed [rad/s]", "ramp to it [s]", "T of `paper` [s]",
     *(f"`{name}`" for name in STRATEGIES)),
    _of_robots, settling, _reached, number=20,
)


# A slippery or tilted floor, weak drives, and pushes.

_TAIL = 5.0
"""Length of the end of a run over which errors are reported [s]."""
_SLIPPERY, _WEAK = "rigid_body.friction=0.2", "rigid_body.torque_limit=1.6"
_EVENTS: tuple[tuple[str, tuple[int, ...], str, Push | None], ...] = (
    ("friction 0.2", (1, 2, 3), _SLIPPERY, None),
    ("the same, `max_rotor_acceleration` 250", (1, 2, 3),
     f"{_SLIPPERY} robot.max_rotor_acceleration=250 rigid_body.torque_limit=3.2", None),
    ("drives of 1.6 N m", (1,), _WEAK, None),
    ("the same, `max_rotor_torque` 1.6", (1,), f"{_WEAK} robot.max_rotor_torque=1.6", None),
    ("push of 1 N s at rest, at 12 s", (3,), "", Push(12.0, (1.0, 0.0))),
    ("push of 1 N s in motion, at 2 s", (1,), "", Push(2.0, (1.0, 0.0))),
    ("push of 0.1 N s in motion, at 2 s", (1,), "", Push(2.0, (0.1, 0.0))),
    ("slope of 0.1 degree", (1,), f"disturbances.slope={math.radians(0.1)}", None),
    ("slope of 1 degree", (1,), f"disturbances.slope={math.radians(1.0)}", None),
)


def _of_floors(*_: int) -> Iterator[Row]:
    for name, cases, settings, push in _EVENTS:
        for case, strategy in product(cases, ("paper", "time_optimal")):
            scenario = replace(PAPER_CASES[case], push=push)
            yield Row.of((name, case, strategy), f"{CONTACT}{settings} controller.strategy="
                         f"{strategy}", 20.0, [scenario])


def _event(conditions: StudyConditions, scenario: Scenario) -> list[str]:
    """Return the cells of a run."""
    found = closed_loop(conditions, scenario)
    tail = found.states[found.times > conditions.duration - _TAIL]
    errors = position_errors(tail, scenario.goal), np.degrees(angle_errors(tail, scenario.goal))
    return ["no" if np.isnan(found.settled_after) else f"{found.settled_after:.1f} s"] + [
        "{:.3f} m, {:.1f}°".format(*map(of, errors)) for of in (np.median, np.max)
    ]


FLOORS = Table(
    ("what happens", "case", "strategy", "settled", "last 5 s, median", "last 5 s, largest"),
    _of_floors, _event, lambda found, _: found[0],
)


# Slow, noisy and late poses: lost ones in the paper's cases, and momentum at upright goals.

NEAR, NEAR_ANGLE = 0.03, float(np.radians(3.0))
"""Errors below which a sphere with noisy poses is at its goal [m, rad]."""
_OUTPUT = 0.02
"""Spacing of a run's rows [s]."""
_HELD = 0.95
"""Share of the speed limit up to which the rotors count as able to hold the momentum; some is
needed for corrections."""
_SENSOR = (f"simulator.position_noise=0.005 simulator.orientation_noise={math.radians(1.0)} "
           "simulator.sensor_rate=20 simulator.sensor_latency=0.05 ")
_NOISE_GIVEN = (f"controller.pose_position_noise=0.005 "
                f"controller.pose_orientation_noise={math.radians(1.0)} ")
# Strategies with the input weight alpha; a larger weight reacts less to noise.
_WAYS = (("time_optimal", 0.5), ("paper", 0.5), ("paper", 5.0))
_PUSH, _SLOPE, _OFFSET = (0.5, 0.5), math.radians(0.3), 5e-4
_MOMENTA = {
    "none": DisturbanceDraws(),
    "push of 0.5 N s": DisturbanceDraws(push=_PUSH),
    "slope of 0.3°": DisturbanceDraws(slope=_SLOPE),
    "centre of mass 0.5 mm off": DisturbanceDraws(offset=_OFFSET),
    "all three": DisturbanceDraws(push=_PUSH, slope=_SLOPE, offset=_OFFSET),
}


def _of_poses(number: int, seed: int) -> Iterator[Row]:
    scenarios = [replace(paper, seed=seed) for seed in range(seed, seed + number)
                 for paper in PAPER_CASES.values()]
    for plant, (strategy, weight), poses in product(
        ("rolling", "rigid_body"), _WAYS, ("fused", "trusted")
    ):
        name = strategy if strategy == "time_optimal" else f"{strategy}, α = {weight:g}"
        yield Row.of(
            (plant, name, poses),
            f"{_SENSOR}simulator.plant={plant} simulator.sensor_dropout=0.2 controller.strategy="
            f"{strategy} controller.input_weight={weight} "
            f"{_NOISE_GIVEN if poses == 'fused' else ''}", 30.0, scenarios,
        )


def _of_momentum(number: int, seed: int) -> Iterator[Row]:
    nearer = np.where(np.arange(6) < 2, 0.5, 1.0)  # within 1.5 m
    for name, draws in _MOMENTA.items():
        scenarios = [
            replace(one, start=nearer * one.start, goal=nearer * one.goal)
            for one in drawn(StudyConditions(), number, seed, "upright", draws)
        ]
        for is_on in ("true", "false"):
            settings = f"{CONTACT}{_SENSOR}{_NOISE_GIVEN}controller.momentum={is_on}"
            yield Row.of((name, "on" if is_on == "true" else "off"), settings, 20.0, scenarios,
                         percent=3.0)


def _speeds_of_rest(
    scenario: Scenario, times: Vector, states: Vector, robot: RobotParameters
) -> Vector:
    """Return the rotor speeds that hold the true momentum at the goal [rad/s], shape (n, 2)."""
    disturbance = disturbance_of(DisturbanceSettings(**scenario.disturbances), robot)
    torques = np.array([disturbance.at_rest(state[QUATERNION]) for state in states])
    momenta = np.cumsum(torques, axis=0) * _OUTPUT
    if scenario.push is not None:
        jump = momentum_of_push(robot, np.array(scenario.push.impulse))
        momenta[times >= scenario.push.time] += jump
    goal = scenario.goal[QUATERNION]
    return np.array([rest_speeds(momentum, goal) for momentum in momenta])


def _arrival(
    conditions: StudyConditions, scenario: Scenario, tail: float
) -> tuple[float, float, float, float]:
    """Make a run that is judged as long as the rotors can hold the momentum at its goal.

    Returns the time until which it is judged [s], the time from which on it stays near the goal
    [s], inf if that is not for the `tail` before the former [s], and the largest errors in the
    tail [m, rad].
    """
    found, robot = closed_loop(conditions, scenario, output_period=_OUTPUT), conditions.robot
    needed = np.abs(_speeds_of_rest(scenario, found.times, found.states, robot)).max(axis=1)
    held = needed < _HELD * robot.max_rotor_speed
    count = held.size if held.all() else int(np.argmin(held))
    times, states = found.times[:count], found.states[:count]
    judged = float(times[-1])
    position, angle = (of(states, scenario.goal) for of in (position_errors, angle_errors))
    far = np.flatnonzero((position > NEAR) | (angle > NEAR_ANGLE))
    first = int(far[-1]) + 1 if far.size else 0
    # An arrival just before the end does not show that the sphere stays there.
    stays = first < count and times[first] <= judged - tail
    last = times > judged - tail
    return (judged, float(times[first]) if stays else math.inf, float(np.max(position[last])),
            float(np.max(angle[last])))


def _arrivals(found: list[Any]) -> tuple[Vector, Vector, str, str, str]:
    """Return until when runs are judged, when they have arrived [s], and this in words.

    Their number, times and errors at the end.
    """
    judged, arrived, position, angle = np.array(found).T
    arrived = arrived[np.isfinite(arrived)]
    p, a = 100.0 * position, np.degrees(angle)
    errors = f"{np.median(p):.1f} cm, {np.median(a):.1f}° ({np.max(p):.1f} cm, {np.max(a):.1f}°)"
    number = f"{len(arrived)} of {len(found)}"
    return judged, arrived, number, median_and_worst(arrived, ".1f"), errors


def _cells_of_momentum(found: list[Any], _: object) -> list[object]:
    judged, arrived, number, times, errors = _arrivals(found)
    until = f"{min(judged):.0f} to {max(judged):.0f}"
    return [until, number, np.sum(arrived <= 8.0), times, errors]


POSES = Table(
    ("plant", "strategy", "poses", "arrived at the end", "from, median (worst) [s]",
     "largest error in the last 10 s, median (worst)"),
    _of_poses, partial(_arrival, tail=10.0), lambda found, _: _arrivals(found)[2:], number=4,
)
MOMENTUM = Table(
    ("disturbance", "`momentum`", "judged until [s]", "settled", "by 8 s",
     "after, median (worst) [s]", "largest error in the last second, median (worst)"),
    _of_momentum, partial(_arrival, tail=1.0), _cells_of_momentum, number=20, seed=0,
)


# How long a sphere stays at its goal on a slope or out of balance, of the time that it could.

_PERCENT = 3.0
"""Largest error of the parameters [%]."""
_DWELL = 0.5
"""Time for which the error has to be small for an arrival [s]."""
_HOLDING = (  # inclination [degree], centre of mass [mm], rolling friction [m], duration [s]
    ("slope 0.1°", 0.1, 0.0, 0.0, 30.0),
    ("slope 0.5°", 0.5, 0.0, 0.0, 15.0),
    ("slope 1°", 1.0, 0.0, 0.0, 10.0),
    ("0.5 mm off", 0.0, 0.5, 0.0, 30.0),
    ("1 mm off", 0.0, 1.0, 0.0, 30.0),
    ("2 mm off", 0.0, 2.0, 0.0, 30.0),
    ("1 mm off, rolling friction 0.1 mm", 0.0, 1.0, 1e-4, 30.0),
)


@dataclass(frozen=True)
class Stay:
    """Times of a run [s]; of its end `left` for a sphere that stays."""

    arrived: float = math.nan
    left: float = math.nan
    possible: float = math.nan
    """End of the longest stay that is possible in the run."""
    limit: float = math.inf
    """When a rotor is at its limit; inf if that does not happen."""
    predicted: float = math.nan
    """Time from the arrival to saturation that the controller predicted."""


def _of_holding(number: int, seed: int) -> Iterator[Row]:
    for name, degrees, offset, friction, duration in _HOLDING:
        draws = DisturbanceDraws(slope=math.radians(degrees), offset=1e-3 * offset)
        settings = f"{CONTACT}disturbances.rolling_friction={friction}"
        scenarios = drawn(StudyConditions(), number, seed, "upright", draws)
        yield Row.of((name,), settings, duration, scenarios, _PERCENT)


def _stay(conditions: StudyConditions, scenario: Scenario) -> Stay:
    simulator, controller = prepare(conditions, scenario)
    momenta: dict[int, Vector] = {}
    advance = simulator.advance_to

    def record(then: int) -> None:
        momenta[simulator.now] = simulator.plant.momentum
        advance(then)

    simulator.advance_to = record  # type: ignore[method-assign]
    made, duration = (simulator, controller), conditions.duration
    found = closed_loop(conditions, scenario, made, output_period=_OUTPUT)
    small = found.errors < SETTLED_ERROR
    rows = round(_DWELL / _OUTPUT)
    first = next((i for i in range(small.size - rows) if small[i : i + rows].all()), None)
    if first is None:
        return Stay()
    outside = np.flatnonzero(~small[first:])
    left = found.times[first + int(outside[0])] if outside.size else duration
    arrived, robot = float(found.times[first]), conditions.robot
    # The sampling instant after the arrival, at which the controller holds.
    period = conditions.controller.control_period
    instant = math.ceil(arrived / period) * period
    turn, limit = scenario.goal[QUATERNION], robot.max_rotor_speed
    # Of the robot that is drawn for the run.
    true = perturbed(robot, _PERCENT / 100.0, np.random.default_rng([scenario.seed, 2]))
    disturbance = disturbance_of(DisturbanceSettings(**scenario.disturbances), true)
    momentum = momenta[round(instant * NANOSECONDS)] / true.rotor_axial_inertia
    saturated = instant + time_to_saturation(momentum, disturbance, turn, limit)
    decision = found.decisions[round(instant / period)]
    estimated = time_to_saturation(decision.momentum, decision.disturbance, turn, limit)
    return Stay(
        arrived, float(left), min(saturated, duration), saturated, instant + estimated - arrived
    )


def _cells_of_holding(found: list[Stay], _: object) -> Iterable[object]:
    arrived = [o for o in found if not math.isnan(o.arrived)]
    possible = [o for o in arrived if o.possible > o.arrived + _DWELL]
    shares = [(o.left - o.arrived) / (o.possible - o.arrived) for o in possible]
    errors = [
        abs(o.predicted / (o.limit - o.arrived) - 1.0) for o in possible
        if math.isfinite(o.limit)
    ]
    return (
        f"{len(arrived)} of {len(found)}",
        median_and_worst([o.arrived for o in arrived], ".1f"),
        f"{sum(share >= 0.8 for share in shares)} of {len(shares)}",
        f"{np.median(shares):.2f} ({min(shares):.2f})" if shares else "-",
        f"{100 * np.median(errors):.1f} % ({100 * max(errors):.1f} %)" if errors else "-",
    )


HOLDING = Table(
    ("disturbance", "arrived", "after, median (worst) [s]", "stayed 80 % of the time it could",
     "share of it, median (least)", "predicted time to saturation off by, median (worst)"),
    _of_holding, _stay, _cells_of_holding, number=48, seed=31,
)

TABLES = {
    "cases": CASES, "robots": ROBOTS_DRAWN, "floors": FLOORS, "poses": POSES, "holding": HOLDING,
    "momentum": MOMENTUM,
}

if __name__ == "__main__":
    print_tables(TABLES, __doc__)

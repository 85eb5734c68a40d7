# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Odometry from inside: goals reached by it, drift, consistency, fixes, other methods, its cost.

    python bench/odometry.py --json out/odometry.json                # about half an hour
    python bench/odometry.py --parts drift others --seeds 10
    python bench/odometry.py --parts goals wrong --goals 20

Errors are those of the true state. `others` has the sensor data of `drift` and needs the package
`ahrs` from PyPI. A figure of three is median, 95th percentile and maximum.
"""

import argparse
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import odometry_others as other_ways
from node_runs import machine, write_json
from rich.console import Console
from rich.progress import track
from scipy.stats import chi2

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.library_threads import limit_library_threads
from sphere_nmpc.model import rotation
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_nmpc.quantity import NANOSECONDS
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.evaluation.metrics import angle_errors, position_errors
from sphere_sim.evaluation.odometry_poses import OdometryPoses
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.world.imu_sensor import ImuSensor
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.simulator import Simulator

_LIMITS = {"goals": (0.02, 1.5), "wrong": (0.04, 2.0)}
"""Errors at rest within which a goal is reached [m, degree]."""
_WRONG, _WRONG_RADIUS = 0.03, 0.003
"""Largest relative error of each parameter and of the radius [-]."""
_DRIVE = 60.0
"""Duration of a random drive [s]."""
_EVERY = 10
"""Readings from one evaluation of an estimate to the next."""
_INSTANTS = np.array([5.0, 15.0, 30.0, 45.0, 60.0])
"""Times at which the consistency is evaluated [s]."""
_PARTS_OF_POSE = {
    "pose": slice(0, 5), "position": slice(0, 2), "tilt": slice(2, 4), "heading": slice(4, 5)
}
_FIX_EVERY, _FIX_LATE, _FIX_NOISE = 10.0, 0.2, (5e-3, np.radians(0.5))
"""Period and least age of a fix [s], and its noise [m, rad]."""


class Drive(NamedTuple):
    """Readings of IMU and encoders and the true poses at their times, from rest; n of each."""

    times: Vector
    rates: Vector
    forces: Vector
    angles: Vector
    speeds: Vector
    states: Vector

    @property
    def way(self) -> Vector:
        """Length of the way up to each reading [m], shape (n,)."""
        steps = np.linalg.norm(np.diff(self.states[:, POSITION], axis=0), axis=1)
        return np.concatenate(([0.0], np.cumsum(steps)))


def conditions_of(plant: str, *more: tuple[str, str]) -> StudyConditions:
    """Return conditions of runs of 15 s with an odometry on a plant."""
    own = [("rigid_body.friction", "0.5")] if plant == "rigid_body" else []
    given = [("simulator.plant", plant), ("simulator.pose_source", "odometry"), *own, *more]
    return StudyConditions(duration=15.0).with_settings(given)


def world(conditions: StudyConditions, scenario: Scenario, wrong: float = 0.0) -> Simulator:
    """Return the simulator of a scenario, whose robot has parameters that are wrong by a share."""
    simulation = replace(
        conditions.simulator, initial_state=tuple(scenario.start), seed=scenario.seed
    )
    rng = np.random.default_rng([scenario.seed, 2])
    robot = perturbed(conditions.robot, wrong, rng)
    if wrong:
        radius = conditions.robot.shell_radius * (1.0 + _WRONG_RADIUS * rng.uniform(-1.0, 1.0))
        robot = replace(robot, shell_radius=float(radius))
    own = conditions.of_plant.for_robot(conditions.robot)
    plant = make_plant(simulation.plant, robot, scenario.start, own)
    return Simulator(simulation, robot, plant, conditions.imu)


def sensor_of(simulator: Simulator) -> ImuSensor:
    """Return the IMU of a simulator that has one."""
    assert simulator.imu is not None
    return simulator.imu


def world_error(pose: Vector, state: Vector) -> Vector:
    """Return the error of a pose: position [m], rotation [rad], both in the world, shape (5,)."""
    error = error_between(pose, state)
    error[2:] = rotation.matrix(pose[QUATERNION]) @ error[2:]
    return error


def sizes(errors: Vector) -> Vector:
    """Return position [mm], heading and tilt [deg] of errors, (n, 5), shape (n, 3)."""
    place, tilt = (np.linalg.norm(errors[:, part], axis=1) for part in (slice(2), slice(2, 4)))
    angles = np.degrees(np.column_stack((np.abs(errors[:, 4]), tilt)))
    return np.column_stack((1e3 * place, angles))


def quantiles(values: Vector) -> list[float]:
    """Return median, 95th percentile and maximum."""
    return np.quantile(values, (0.5, 0.95, 1.0)).tolist()  # type: ignore[no-any-return]


def goal_run(
    conditions: StudyConditions, scenario: Scenario, limits: tuple[float, float],
    wrong: float = 0.0, exact: bool = False,
) -> dict[str, Any]:
    """Return the errors at the end of a run to a goal, and when it has come within limits."""
    simulator = world(conditions, scenario, wrong)
    poses = None if exact else OdometryPoses(
        simulator, sensor_of(simulator), conditions.odometry, conditions.robot
    )
    controller = Controller(conditions.controller, conditions.robot)
    period = conditions.controller.control_period
    found = run_closed_loop(
        simulator, controller, scenario.goal, conditions.duration, period, poses=poses
    )
    off = position_errors(found.states, scenario.goal)
    turned = np.degrees(angle_errors(found.states, scenario.goal))
    outside = np.flatnonzero((off > limits[0]) | (turned > limits[1]))
    first = int(outside[-1]) + 1 if outside.size else 0
    settled = float(found.times[first]) if first < len(found.times) else None
    own = (0.0, 0.0) if poses is None else poses.errors()
    return {"seed": scenario.seed, "position_m": float(off[-1]), "angle_deg": float(turned[-1]),
            "settled_s": settled, "odometry_m": own[0], "odometry_heading_deg": own[1]}


def goals(options: argparse.Namespace, part: str) -> dict[str, Any]:
    """Measure random goals, with exact parameters and with wrong ones."""
    wrong = _WRONG if part == "wrong" else 0.0
    more = [("odometry.constants_deviation", "0.02")] if wrong else []
    conditions, limits = conditions_of("rigid_body", *more), _LIMITS[part]
    scenarios = draw_scenarios(options.goals, options.seed)
    runs = [goal_run(conditions, one, limits, wrong) for one in shown(scenarios, part)]
    exact = [] if wrong else [
        goal_run(conditions, one, limits, exact=True) for one in shown(scenarios, "exact poses")
    ]
    reached = sum(run["settled_s"] is not None for run in runs)
    print(f"{part}: {reached} of {len(runs)} within {100 * limits[0]:g} cm and {limits[1]:g} deg; "
          "median, p95, max:", end="")
    found: dict[str, Any] = {"reached": reached, "runs": runs, "exact": exact}
    for name in ("position_m", "angle_deg"):
        found[name] = quantiles(np.array([run[name] for run in runs]))
        print(f"  {name} " + " ".join(f"{value:.4f}" for value in found[name]), end="")
    print()
    pairs = [(a["settled_s"], b["settled_s"]) for a, b in zip(runs, exact, strict=False)]
    both = np.array([pair for pair in pairs if None not in pair], dtype=float)
    if len(both):
        ratios = both[:, 0] / both[:, 1]
        found["settling_over_exact"] = [float(np.median(ratios)), float(np.mean(ratios))]
        found["settling_means_s"] = both.mean(axis=0).tolist()
        print(f"  settling over that with exact poses, {len(both)} pairs: median "
              f"{np.median(ratios):.3f}, mean {np.mean(ratios):.3f}; means "
              "{:.2f} and {:.2f} s".format(*both.mean(axis=0)))
    return found


def shown(items: Any, name: str) -> Any:
    """Return an iterable with a progress bar on standard error."""
    return track(items, description=name, console=Console(stderr=True))


def recorded(
    conditions: StudyConditions, scenario: Scenario, duration: float = _DRIVE
) -> Drive:
    """Return a drive with random rotor speeds, a new target every 0.3 to 1 s, and its readings."""
    robot, simulator = conditions.robot, world(conditions, scenario)
    rng = np.random.default_rng([scenario.seed, 8])
    step, speeds, target, due = 0.01, [np.zeros(2)], np.zeros(2), 0.0
    largest = robot.max_rotor_acceleration * step
    for time_now in step * np.arange(round(duration / step)):
        if time_now >= due:
            target = rng.uniform(-robot.max_rotor_speed, robot.max_rotor_speed, 2)
            due = time_now + rng.uniform(0.3, 1.0)
        target = target if time_now < duration - 1.0 else np.zeros(2)
        speeds.append(speeds[-1] + np.clip(target - speeds[-1], -largest, largest))
    simulator.follower.follow_trajectory(
        FirstOrderHold(step * np.arange(len(speeds)), np.array(speeds))
    )
    imu = sensor_of(simulator)
    readings = imu.at_rest(conditions.odometry.calibration_time + 0.2, simulator.plant)
    readings += simulator.imu_readings()
    states = [simulator.plant.state] * len(readings)
    while simulator.time < duration:
        simulator.advance_to(simulator.now + imu.period)
        readings += simulator.imu_readings()
        states.append(simulator.plant.state)
    stamps, rates, forces, angles, turning, _ = zip(*readings, strict=True)
    rows = np.array(stamps) / NANOSECONDS, rates, forces, angles, turning, states
    return Drive(*(np.array(row) for row in rows))


def followed(
    conditions: StudyConditions, drive: Drive, start: Vector, radius: float = 1.0
) -> tuple[Vector, list[Any], Counter[str]]:
    """Return errors in the world, (m, 5), estimates and the conditions told during a drive.

    Position and rotation of the start are given, and `radius` is the share of the true one that
    the odometry has.
    """
    settings = replace(conditions.odometry, initial_state=tuple(start.tolist()))
    robot = conditions.robot
    robot = replace(robot, shell_radius=robot.shell_radius * radius)
    odometry = Odometry(settings, conditions.imu, robot)
    errors, estimates, told, before = [], [], Counter[str](), set[str]()
    for k, (stamp, rate, force, angles, speeds, state) in enumerate(zip(*drive, strict=True)):
        odometry.observe_imu(stamp, rate, force)
        odometry.observe_rotors(stamp, speeds, angles)
        if k % _EVERY == 0:
            odometry.check(stamp)
            kinds = {one.kind.name for one in odometry.conditions}
            told.update(kinds - before)
            before = kinds
            estimate = odometry.estimate
            if estimate is not None:
                estimates.append(estimate)
                errors.append(world_error(estimate.pose, state))
    return np.array(errors), estimates, told


def squares(error: Vector, estimate: Any) -> list[float]:
    """Return the normalised squares of the error of an estimate, by part of the pose."""
    turn = np.eye(5)
    turn[2:, 2:] = rotation.matrix(estimate.pose[QUATERNION])
    spread = turn @ estimate.covariance @ turn.T
    return [
        float(error[part] @ np.linalg.solve(spread[part, part], error[part]))
        for part in _PARTS_OF_POSE.values()
    ]


def summary(drives: list[Drive], ends: Vector) -> dict[str, Any]:
    """Return the errors at the end of drives: [mm, deg, deg], shape (n, 3), in words of JSON."""
    ways = np.array([drive.way[-1] for drive in drives])
    share = 0.1 * ends[:, 0] / ways
    return {"position_of_way_percent": quantiles(share), "heading_deg": quantiles(ends[:, 1]),
            "tilt_deg": quantiles(ends[:, 2]), "of_way_of_runs": share.tolist()}


def say(name: str, found: dict[str, Any]) -> None:
    """Print the errors of one method, median, p95 and max of each."""
    print(f"  {name:34}", *(
        f"{quantity} " + " ".join(f"{value:.3g}" for value in found[quantity])
        for quantity in ("position_of_way_percent", "heading_deg", "tilt_deg")
    ), sep="   ", flush=True)


def drift(options: argparse.Namespace, with_others: bool) -> dict[str, Any]:
    """Measure drift, consistency and, on the same data, the other methods, on both plants."""
    found: dict[str, Any] = {}
    for plant in ("rigid_body", "rolling"):
        conditions = conditions_of(plant)
        scenarios = draw_scenarios(options.seeds, options.seed)
        drives = [recorded(conditions, one) for one in shown(scenarios, f"drives, {plant}")]
        own, told, normalised = [], Counter[str](), []
        for drive, scenario in shown(list(zip(drives, scenarios, strict=True)), "odometry"):
            errors, _, seen = followed(conditions, drive, scenario.start)
            told += seen
            own.append(errors)
            rng = np.random.default_rng([scenario.seed, 9])
            given = conditions.odometry
            deviations = [given.position_deviation] * 2 + [given.orientation_deviation] * 3
            start = apply_error(scenario.start, deviations * rng.normal(size=5))
            radius = float(1.0 / (1.0 + given.radius_deviation * rng.normal()))
            errors, estimates, _ = followed(conditions, drive, start, radius)
            times = np.array([one.time for one in estimates])
            at = np.searchsorted(times, _INSTANTS - 0.5 / conditions.imu.rate)
            at = np.minimum(at, len(times) - 1)
            normalised.append([squares(errors[i], estimates[i]) for i in at])
        ends = sizes(np.array([errors[-1] for errors in own]))
        found[plant] = result = summary(drives, ends)
        result["way_m"] = quantiles(np.array([drive.way[-1] for drive in drives]))
        result["conditions"] = dict(told)
        print(f"drift on {plant}, way median {result['way_m'][0]:.1f} m, told in all {dict(told)}")
        say("odometry", result)
        result["consistency"] = consistency(np.array(normalised))
        result["over_way"] = {"odometry": over_way(drives, own)}
        if with_others:
            others(conditions, drives, result)
    return found


def consistency(normalised: Vector) -> dict[str, Any]:
    """Return the normalised squares of n runs over degrees of freedom, and bounds of 95 %."""
    found: dict[str, Any] = {}
    print(f"  consistency at {_INSTANTS.tolist()} s; 1 is expected")
    for k, (name, part) in enumerate(_PARTS_OF_POSE.items()):
        freedom = (part.stop - part.start) * len(normalised)
        bounds = chi2.ppf((0.025, 0.975), freedom) / freedom
        means = normalised[:, :, k].sum(axis=0) / freedom
        found[name] = {"bounds": bounds.tolist(), "means": means.tolist()}
        print(f"    {name:9} [{bounds[0]:.2f}, {bounds[1]:.2f}]  "
              + " ".join(f"{value:.2f}" for value in means))
    return found


def over_way(drives: list[Drive], errors: list[Vector]) -> dict[str, list[float]]:
    """Return the median of the position errors [m] of drives at ways [m] that all of them have."""
    shortest = min(float(drive.way[-1]) for drive in drives)
    ways = np.linspace(0.0, shortest, 41)
    rows = []
    for drive, found in zip(drives, errors, strict=True):
        way = drive.way[:: len(drive.way) // len(found)][-len(found) :]
        rows.append(np.interp(ways, way, np.linalg.norm(found[:, POSITION], axis=1)))
    return {"way_m": ways.tolist(), "median_m": np.median(rows, axis=0).tolist()}


def others(conditions: StudyConditions, drives: list[Drive], result: dict[str, Any]) -> None:
    """Measure the other methods on drives, each with the gain of the attitude filter best for it.

    The gyro is calibrated by its mean at rest, as the start of all, which is the true one.
    """
    radius, imu = conditions.robot.shell_radius, conditions.imu
    ends: dict[str, dict[float, list[Vector]]] = {}
    for drive in shown(drives, "others"):
        times, start = drive.times, drive.states[0]
        rates = other_ways.calibrated(times, drive.rates)
        for gain in other_ways.GAINS:
            turns = other_ways.attitudes(
                times, rates, drive.forces, start[QUATERNION], gain
            )
            ways = {"attitude filter and rolling":
                    other_ways.rolled(times, rates, turns, start, radius)}
            if gain == other_ways.GAINS[0]:
                for fused in (True, False):
                    name = f"model of robot_localization, {'with' if fused else 'no'} orientation"
                    ways[name] = other_ways.general(
                        times, rates, drive.forces, turns, start, radius, imu, fused
                    )
            for name, poses in ways.items():
                kept = zip(poses[::_EVERY], drive.states[::_EVERY], strict=True)
                errors = np.array([world_error(*pair) for pair in kept])
                ends.setdefault(name, {}).setdefault(gain, []).append(errors)
    for name, of_gains in ends.items():
        found = {
            gain: summary(drives, sizes(np.array([one[-1] for one in errors])))
            for gain, errors in of_gains.items()
        }
        best = min(found, key=lambda gain: found[gain]["position_of_way_percent"][0])
        say(f"{name}, gain {best:g}", found[best])
        result[name] = {str(gain): one for gain, one in found.items()}
        result["over_way"][name] = over_way(drives, of_gains[best])


def fixes(options: argparse.Namespace) -> dict[str, Any]:
    """Measure the odometry in twenty minutes of random goals with late, noisy fixes."""
    conditions = conditions_of("rigid_body")
    scenarios = draw_scenarios(round(options.minutes * 60.0), options.seed + 1)
    simulator = world(conditions, scenarios[0])
    poses = OdometryPoses(
        simulator, sensor_of(simulator), conditions.odometry, conditions.robot
    )
    controller = Controller(conditions.controller, conditions.robot)
    rng, plant = np.random.default_rng([options.seed, 10]), simulator.plant
    limits, deviations = _LIMITS["goals"], np.repeat(_FIX_NOISE, (2, 3))
    waiting: list[tuple[float, Vector]] = []
    given: list[float] = []
    errors, number, since, near = [], 0, 0.0, 0.0
    bar = shown(range(len(scenarios)), "fixes")
    seconds = iter(bar)

    def observe() -> list[tuple[int, Vector]]:
        nonlocal number, since, near
        found, now, state = poses(), simulator.time, plant.state
        if waiting and now >= waiting[0][0] + _FIX_LATE - 1e-9:
            poses.odometry.correct(*waiting.pop(), np.diag(deviations**2))
            found = poses()
        if now >= _FIX_EVERY * (len(given) + 1) - 1e-9:
            waiting.append((now, apply_error(state, deviations * rng.normal(size=5))))
            given.append(now)
        errors.append(world_error(found[-1][1], state))
        goal = scenarios[number].goal[None]
        if (position_errors(state[None], goal)[0] > limits[0]
                or np.degrees(angle_errors(state[None], goal)[0]) > limits[1]):
            near = now
        if now - near >= 1.0 or now - since >= 12.0:
            number, since, near = number + 1, now, now
            controller.set_goal(scenarios[number].goal)
        if now % 1.0 == 0.0:
            next(seconds, None)
        return found

    run_closed_loop(
        simulator, controller, scenarios[0].goal, 60.0 * options.minutes,
        conditions.controller.control_period, poses=observe,
    )
    found = sizes(np.array(errors))
    names = ("position_mm", "heading_deg", "tilt_deg")
    result: dict[str, Any] = {"goals": number, "fixes": poses.odometry.fixes_used}
    result |= {"left_out": poses.odometry.fixes_left_out}
    print(f"fixes over {options.minutes:g} min: {result}; rms, then median, p95, max:")
    for name, values in zip(names, found.T, strict=True):
        result[name] = [float(np.sqrt(np.mean(values**2))), *quantiles(values)]
        print(f"  {name:12} " + " ".join(f"{value:.3g}" for value in result[name]))
    return result


def cost(options: argparse.Namespace) -> dict[str, Any]:
    """Measure the time of an update by a reading of IMU and encoders."""
    result: dict[str, Any] = {}
    for rate in (100, 500):
        conditions = conditions_of("rigid_body", ("imu.rate", str(rate)))
        scenario = draw_scenarios(1, options.seed)[0]
        drive = recorded(conditions, scenario, 20.0)
        settings = replace(conditions.odometry, initial_state=tuple(scenario.start.tolist()))
        odometry = Odometry(settings, conditions.imu, conditions.robot)
        took = []
        for stamp, turning, force, angles, speeds, _ in zip(*drive, strict=True):
            began = time.perf_counter()
            odometry.observe_imu(stamp, turning, force)
            odometry.observe_rotors(stamp, speeds, angles)
            took.append(time.perf_counter() - began)
        # Before the start of the motion everything is loaded.
        kept = np.array(took)[drive.times > 0.0]
        middle, p99 = 1e3 * np.quantile(kept, (0.5, 0.99))
        result[str(rate)] = {"median_ms": middle, "mean_ms": 1e3 * kept.mean(), "p99_ms": p99,
                             "of_a_core_percent": 100.0 * rate * kept.mean()}
        print(f"cost at {rate} Hz:", *(f"{name} {value:.3f}" for name, value
                                       in result[str(rate)].items()))
    return result


def main() -> None:
    """Measure the parts that are wanted, print their figures and write them."""
    parts = ("goals", "wrong", "drift", "others", "fixes", "cost")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=parts, default=parts)
    parser.add_argument("--goals", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=50, help="drives on each plant")
    parser.add_argument("--minutes", type=float, default=20.0, help="length of the run with fixes")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    limit_library_threads()
    result: dict[str, Any] = {"machine": machine()}
    for part in ("goals", "wrong"):
        if part in options.parts:
            result[part] = goals(options, part)
    if {"drift", "others"} & {*options.parts}:
        result["drift"] = drift(options, "others" in options.parts)
    for name, measured in (("fixes", fixes), ("cost", cost)):
        if name in options.parts:
            result[name] = measured(options)
    write_json(options.json, result)


if __name__ == "__main__":
    main()

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random drives of a simulated sphere: drift and consistency of the odometry, other methods."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from odometry_others import poses_by_others
from rich.console import Console
from rich.progress import track
from scipy.stats import chi2

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry.pose_estimate import PoseEstimate
from sphere_nmpc.model import rotation
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_nmpc.quantities import NANOSECONDS
from sphere_sim.evaluation.followed_odometry import FollowedOdometry
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import assemble
from sphere_sim.world.imu_sensor import ImuSensor
from sphere_sim.world.simulator import Simulator

T = TypeVar("T")
INSTANTS = np.array([5.0, 15.0, 30.0, 45.0, 60.0])
"""Times at which the consistency is evaluated [s]."""
_WRONG_RADIUS = 0.003
"""Largest relative error of the radius where parameters are wrong [-]."""
_DRIVE = 60.0
"""Duration of a random drive [s]."""
_EVERY = 10
"""Readings from one evaluation of an estimate to the next."""
_PARTS_OF_POSE = {
    "pose": slice(0, 5), "position": slice(0, 2), "tilt": slice(2, 4), "heading": slice(4, 5)
}


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


FURTHER: list[tuple[str, str]] = []
"""Settings of all runs, by name and value."""


def conditions_of(plant: str, *more: tuple[str, str]) -> StudyConditions:
    """Return conditions of runs of 15 s with an odometry on a plant."""
    own = [("rigid_body.friction", "0.5")] if plant == "rigid_body" else []
    given = [("simulator.plant", plant), ("simulator.pose_source", "odometry")]
    given += [*own, *FURTHER, *more]
    return StudyConditions(duration=15.0).with_settings(given)


def world(
    conditions: StudyConditions, scenario: Scenario, wrong: float = 0.0
) -> tuple[Simulator, ImuSensor, Controller]:
    """Return simulator, IMU and controller of a run; the parameters are wrong by a share."""
    rng = np.random.default_rng([scenario.seed, 2])
    robot = perturbed(conditions.robot, wrong, rng)
    if wrong:
        radius = conditions.robot.shell_radius * (1.0 + _WRONG_RADIUS * rng.uniform(-1.0, 1.0))
        robot = replace(robot, shell_radius=float(radius))
    simulator, controller = assemble(conditions, scenario, robot)
    assert simulator.imu is not None
    return simulator, simulator.imu, controller


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
    found: list[float] = np.quantile(values, (0.5, 0.95, 1.0)).tolist()
    return found


def shown(items: Iterable[T], name: str) -> Iterable[T]:
    """Return an iterable with a progress bar on standard error."""
    return track(items, description=name, console=Console(stderr=True))


def recorded(
    conditions: StudyConditions, scenario: Scenario, duration: float = _DRIVE
) -> Drive:
    """Return a drive with random rotor speeds, a new target every 0.3 to 1 s, and its readings."""
    robot, (simulator, imu, _) = conditions.robot, world(conditions, scenario)
    rng = np.random.default_rng([scenario.seed, 8])
    step, due = 0.01, 0.0
    target: Vector = np.zeros(2)
    speeds: list[Vector] = [np.zeros(2)]
    largest = robot.max_rotor_acceleration * step
    for time_now in step * np.arange(round(duration / step)):
        if time_now >= due:
            target = rng.uniform(-robot.max_rotor_speed, robot.max_rotor_speed, 2)
            due = time_now + rng.uniform(0.3, 1.0)
        target = target if time_now < duration - 1.0 else np.zeros(2)
        speeds.append(speeds[-1] + np.clip(target - speeds[-1], -largest, largest))
    times: Vector = step * np.arange(len(speeds), dtype=float)
    simulator.follower.follow_trajectory(FirstOrderHold(times, np.array(speeds)))
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
) -> tuple[Vector, list[PoseEstimate], Counter[str]]:
    """Return errors in the world, (m, 5), estimates and the conditions told during a drive.

    Position and rotation of the start are given, and `radius` is the share of the true one that
    the odometry has.
    """
    settings = replace(conditions.odometry, initial_state=tuple(start.tolist()))
    robot = conditions.robot
    robot = replace(robot, shell_radius=robot.shell_radius * radius)
    odometry = Odometry(settings, conditions.imu, robot)
    errors, followed = [], FollowedOdometry(odometry)
    for k, (stamp, rate, force, angles, speeds, state) in enumerate(zip(*drive, strict=True)):
        odometry.observe_imu(stamp, rate, force)
        odometry.observe_rotors(stamp, speeds, angles)
        if k % _EVERY == 0:
            odometry.check(stamp)
            estimate = followed.read(stamp)
            if estimate is not None:
                errors.append(world_error(estimate.pose, state))
    told = Counter(spell.condition.kind.name for spell in followed.spells)
    return np.array(errors), followed.estimates, told


def squares(error: Vector, estimate: PoseEstimate) -> list[float]:
    """Return the normalised squares of the error of an estimate, by part of the pose."""
    turn = np.eye(5)
    turn[2:, 2:] = rotation.matrix(estimate.pose[QUATERNION])
    spread = turn @ estimate.covariance @ turn.T
    return [
        float(error[part] @ np.linalg.solve(spread[part, part], error[part]))
        for part in _PARTS_OF_POSE.values()
    ]


def summary(drives: list[Drive], errors: list[Vector]) -> dict[str, Any]:
    """Return the errors at the end of drives, and over the way the median of that of position."""
    ends = sizes(np.array([found[-1] for found in errors]))
    share = 0.1 * ends[:, 0] / [drive.way[-1] for drive in drives]
    ways = np.linspace(0.0, min(float(drive.way[-1]) for drive in drives), 41)
    rows = []
    for drive, found in zip(drives, errors, strict=True):
        # There are as many evaluations of each as follow its calibration.
        way = drive.way[::_EVERY][-len(found):]
        rows.append(np.interp(ways, way, np.linalg.norm(found[:, POSITION], axis=1)))
    return {
        "position_of_way_percent": quantiles(share), "heading_deg": quantiles(ends[:, 1]),
        "tilt_deg": quantiles(ends[:, 2]), "of_way_of_runs": share.tolist(),
        "way_m": ways.tolist(), "over_way_m": np.median(rows, axis=0).tolist(),
    }


def drift(number: int, seed: int, with_others: bool) -> dict[str, Any]:
    """Measure drift, consistency and, on the same data, the other methods, on both plants.

    The heading's error is that after a minute.
    """
    result: dict[str, Any] = {}
    for plant in ("rigid_body", "rolling"):
        conditions = conditions_of(plant)
        scenarios = draw_scenarios(number, seed)
        drives = [recorded(conditions, one) for one in shown(scenarios, f"drives, {plant}")]
        own, told, normalised = [], Counter[str](), []
        for drive, scenario in shown(list(zip(drives, scenarios, strict=True)), "odometry"):
            errors, _, seen = followed(conditions, drive, scenario.start)
            own.append(errors)
            told += seen
            rng = np.random.default_rng([scenario.seed, 9])
            given = conditions.odometry
            deviations = np.repeat(
                (given.position_deviation, given.orientation_deviation), (2, 3)
            )
            start = apply_error(scenario.start, deviations * rng.normal(size=5))
            radius = float(1.0 / (1.0 + given.radius_deviation * rng.normal()))
            errors, estimates, _ = followed(conditions, drive, start, radius)
            times = [one.time for one in estimates]
            at = [bisect_left(times, instant - 1e-6) for instant in INSTANTS]
            normalised.append([squares(errors[i], estimates[i]) for i in at])
        result[plant] = {
            "ways_m": quantiles(np.array([drive.way[-1] for drive in drives])),
            "conditions": dict(told), "consistency": consistency(np.array(normalised)),
            "odometry": summary(drives, own),
            **(others(conditions, drives) if with_others else {}),
        }
    return result


def consistency(normalised: Vector) -> dict[str, Any]:
    """Return normalised squares of n runs, 1 expected at each instant, with bounds of 95 %."""
    found = {}
    for k, (name, part) in enumerate(_PARTS_OF_POSE.items()):
        freedom = (part.stop - part.start) * len(normalised)
        bounds = chi2.ppf((0.025, 0.975), freedom) / freedom
        means = normalised[:, :, k].sum(axis=0) / freedom
        found[name] = {"means": means.tolist(), "bounds": bounds.tolist()}
    return found


def others(conditions: StudyConditions, drives: list[Drive]) -> dict[str, Any]:
    """Measure the other methods on drives; the attitude filter has the best gain of several."""
    found: dict[str, list[Vector]] = {}
    for drive in shown(drives, "others"):
        ways = poses_by_others(
            drive.times, drive.rates, drive.forces, drive.states[0],
            conditions.robot.shell_radius, conditions.imu,
        )
        for name, poses in ways.items():
            kept = zip(poses[::_EVERY], drive.states[::_EVERY], strict=True)
            found.setdefault(name, []).append(np.array([world_error(*pair) for pair in kept]))
    return {name: summary(drives, errors) for name, errors in found.items()}

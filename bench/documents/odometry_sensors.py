# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Consistency of the odometry with the errors that sensors have: NEES by kind of error.

A simulator of its own, with nothing of the project in it but the robot's constants: the balance of
momentum is integrated at 2 kHz (RK4), the specific force is that of the differentiated velocity,
and a device filters, turns, mixes and samples both. Drives of 60 s with rest at the start, in the
middle and at the end. Printed is the normalised square of the error of the pose over its 5 degrees
of freedom (1 is consistent), in motion and at the end, and the median error at the end.

    python bench/documents/odometry_sensors.py --drives 50 --jobs 2
"""

import argparse
import math
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import butter, lfilter
from scipy.spatial.transform import Rotation
from tables import header, in_processes, row

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry_settings import OdometrySettings
from sphere_nmpc.model.error_state import error_between
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector

FINE = 2000
"""Rate of the integration [Hz]."""
DURATION = 60.0
RESTS = ((0.0, 3.0), (28.0, 33.0), (57.0, 60.0))
LOOKS = (15.0, 25.0, 32.5, 45.0, 55.0, 59.5)
"""Times at which errors are taken [s]: the third and the last at rest."""
DEGREE = math.pi / 180.0
SMALL = RobotParameters(
    shell_radius=0.05, shell_mass=0.1, shell_inertia=1.4e-4, rotor_offset=0.02,
    counterweight_mass=0.03, rotor_mass=0.03, rotor_axial_inertia=6e-6,
    rotor_transverse_inertia=4e-6, counterweight_axial_inertia=4e-6,
    counterweight_transverse_inertia=4e-6, max_rotor_speed=300.0, max_rotor_acceleration=3000.0,
)
KINDS: dict[str, dict[str, float]] = {
    "as assumed": {},
    "values at instants": {"filter": 0.0},
    "low pass of 45 Hz": {"filter": 45.0},
    "cross-axis 0.3 %": {"cross": 0.003},
    "cross-axis 1 %": {"cross": 0.01},
    "misalignment 1 deg": {"misaligned": 1.0 * DEGREE},
    "g-sensitivity 0.1 deg/s/g": {"by_force": 0.1 * DEGREE / 9.81},
    "mounting 2 deg": {"mounting": 2.0 * DEGREE},
    "lever arm 3 mm": {"lever": 3e-3},
    "gyro jump 0.5 deg/s": {"jump": 0.5 * DEGREE},
    "drift 50 mm/s^2 a minute": {"drift": 0.05 / 60.0},
    "encoder of 1 count": {"counts": 2.0 * math.pi / 4096.0},
    "200 Hz": {"rate": 200.0},
    "5 cm robot, 1 kHz": {"rate": 1000.0, "small": 1.0, "lever": 1e-3},
    "all": {
        "filter": 45.0, "cross": 0.005, "misaligned": 0.5 * DEGREE, "lever": 2e-3,
        "by_force": 0.1 * DEGREE / 9.81, "mounting": 1.0 * DEGREE, "drift": 0.05 / 60.0,
    },
}


def motion(rng: np.random.Generator, robot: RobotParameters) -> tuple[Vector, ...]:
    """Return fine times, quaternions xyzw, body rates, positions, and speeds of the rotors."""
    times = np.arange(round(DURATION * FINE) + 1) / FINE
    scale = robot.max_rotor_speed / 100.0
    knots = np.arange(0.0, DURATION + 0.5, 0.5)
    speeds = scale * rng.uniform(-60.0, 60.0, (knots.size, 2))
    for begin, end in RESTS:
        speeds[(knots >= begin) & (knots <= end)] = 0.0
    drives = np.column_stack([np.interp(times, knots, speeds[:, i]) for i in (0, 1)])
    # Rounded corners, as drives have them.
    drives = lfilter(*butter(2, 8.0 / (FINE / 2)), drives, axis=0)
    drives[np.abs(drives) < 1e-6] = 0.0
    c1, r1, r3 = robot.lumped.as_array()[1:]
    deviations = np.array([c1, r1, r3]) * 2e-3

    c1, r1, r3 = np.array([c1, r1, r3]) + deviations * rng.normal(size=3)

    def rate_of(q: Vector, u: Vector) -> Any:
        x, y, z, w = q
        up = np.array((2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z))
        # Sherman and Morrison, for (diag(1, 1, r1/r3) - r1 k k^T) omega = -c1 u.
        inverse = np.array((1.0, 1.0, r3 / r1))
        solved, along = inverse * (-c1 * np.array((u[0], u[1], 0.0))), inverse * up
        return solved + along * (r1 * (up @ solved) / (1.0 - r1 * (up @ along)))

    def slope(q: Vector, u: Vector) -> Any:
        (x, y, z, w), (a, b, c) = q, rate_of(q, u)
        return 0.5 * np.array((
            w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a,
            -x * a - y * b - z * c,
        ))

    q = rng.normal(size=4)
    q = q / np.linalg.norm(q)
    quaternions, rates = np.empty((times.size, 4)), np.empty((times.size, 3))
    step = 1.0 / FINE
    for k in range(times.size):
        quaternions[k], rates[k] = q, rate_of(q, drives[k])
        if k + 1 < times.size and (drives[k].any() or drives[k + 1].any()):
            middle = 0.5 * (drives[k] + drives[k + 1])
            s1 = slope(q, drives[k])
            s2 = slope(q + 0.5 * step * s1, middle)
            s3 = slope(q + 0.5 * step * s2, middle)
            s4 = slope(q + step * s3, drives[k + 1])
            q = q + step / 6.0 * (s1 + 2.0 * s2 + 2.0 * s3 + s4)
            q = q / np.linalg.norm(q)
    radius = robot.shell_radius * (1.0 + 1e-3 * rng.normal())
    world = Rotation.from_quat(quaternions).apply(rates)
    velocity = radius * np.column_stack((world[:, 1], -world[:, 0], 0.0 * world[:, 0]))
    places = np.vstack((np.zeros(3), np.cumsum(
        0.5 * (velocity[1:] + velocity[:-1]) * step, axis=0
    )))
    return times, quaternions, rates, places, velocity, drives


def read(
    rng: np.random.Generator, imu: ImuSettings, moved: tuple[Vector, ...], given: dict[str, float]
) -> tuple[Vector, ...]:
    """Return stamps, rates, forces, angles and speeds of a device with the errors of a kind."""
    times, quaternions, rates, _, velocity, turning = moved
    turns = Rotation.from_quat(quaternions)
    place = np.array(imu.position) + given.get("lever", 0.0) * unit(rng)
    at_place = velocity + turns.apply(np.cross(rates, place))
    acceleration = np.gradient(at_place, 1.0 / FINE, axis=0)
    felt = turns.inv().apply(acceleration + np.array((0.0, 0.0, 9.81)))
    mounted = Rotation.from_matrix(imu.turn)
    mounted = Rotation.from_rotvec(given.get("mounting", 0.0) * unit(rng)) * mounted
    both = np.hstack((mounted.inv().apply(rates), mounted.inv().apply(felt)))
    cross = given.get("cross", 0.0)
    by = np.eye(6)
    for part, scale in ((slice(0, 3), imu.gyro_scale), (slice(3, 6), imu.accelerometer_scale)):
        by[part, part] += cross * (1.0 - np.eye(3)) * rng.choice((-1.0, 1.0), (3, 3))
        by[part, part] += scale * np.diag(rng.normal(size=3))
    turned = Rotation.from_rotvec(given.get("misaligned", 0.0) * unit(rng)).as_matrix()
    by[:3, :3] = by[:3, :3] @ turned
    by[:3, 3:] = given.get("by_force", 0.0) * rng.choice((-1.0, 1.0), (3, 3))
    both = both @ by.T
    rate = given.get("rate", 100.0)
    every = round(FINE / rate)
    cut = given.get("filter", -1.0)
    if cut < 0.0:  # the mean over the time between two readings
        summed = np.vstack((np.zeros(6), np.cumsum(0.5 * (both[1:] + both[:-1]), axis=0)))
        at = np.arange(every, times.size, every)
        sampled = (summed[at] - summed[at - every]) / every
    else:
        if cut > 0.0:
            level = both[0]
            both = level + lfilter(*butter(2, cut / (FINE / 2)), both - level, axis=0)
        at = np.arange(every, times.size, every)
        sampled = both[at]
    stamps, number = times[at], at.size
    biases = np.concatenate((imu.gyro_bias * rng.normal(size=3),
                             imu.accelerometer_bias * rng.normal(size=3)))
    walk = imu.gyro_bias_walk / math.sqrt(rate) * rng.normal(size=(number, 3)).cumsum(axis=0)
    sampled = sampled + biases
    sampled[:, :3] += walk + imu.gyro_noise * math.sqrt(rate) * rng.normal(size=(number, 3))
    sampled[:, 3:] += imu.accelerometer_noise * math.sqrt(rate) * rng.normal(size=(number, 3))
    sampled[:, :3] += np.where(stamps[:, None] > 30.5, given.get("jump", 0.0) * unit(rng), 0.0)
    sampled[:, 3:] += given.get("drift", 0.0) * stamps[:, None] * rng.choice((-1.0, 1.0), 3)
    angles = np.vstack((np.zeros(2), np.cumsum(0.5 * (turning[1:] + turning[:-1]), axis=0))) / FINE
    count = given.get("counts", 0.0)
    speeds = turning[at]
    if count:
        steps = np.round((angles + rng.uniform(0.0, count, 2)) / count) * count
        steps[:, 0] += count * (rng.random(times.size) < 0.5)  # one that toggles
        speeds = (steps[at] - steps[at - every]) * rate
        angles = steps
    return stamps, sampled[:, :3], sampled[:, 3:], angles[at], speeds


def unit(rng: np.random.Generator) -> Vector:
    """Return a random direction, shape (3,)."""
    found = rng.normal(size=3)
    return np.asarray(found / np.linalg.norm(found))


class Followed(NamedTuple):
    """What the odometry found in a drive."""

    looks: list[tuple[float, ...]]
    """For each look the normalised squares of pose, position, orientation and heading over their
    degrees of freedom; the errors of position [m] and orientation [deg]."""
    reported: list[str]
    """Names of conditions."""


def drives(kinds: list[str], seed: int) -> dict[str, Followed]:
    """Return what kinds of errors do to a drive."""
    found: dict[str, Followed] = {}
    for robot in (RobotParameters(), SMALL):
        own = [kind for kind in kinds if bool(KINDS[kind].get("small")) == (robot is SMALL)]
        if own:
            moved = motion(np.random.default_rng([seed, 61]), robot)
            found |= {kind: followed(kind, seed, robot, moved) for kind in own}
    return found


def followed(
    kind: str, seed: int, robot: RobotParameters, moved: tuple[Vector, ...]
) -> Followed:
    """Return what the odometry found in a drive with the errors of a kind."""
    given, rng = KINDS[kind], np.random.default_rng([seed, 62])
    size = robot.shell_radius / 0.3
    imu = ImuSettings(
        position=tuple(size * np.array((0.1, -0.05, 0.08))), orientation=(0.5, 0.5, -0.5, 0.5),
        gyro_range=35.0, accelerometer_range=160.0,
    )
    _, quaternions, _, places = moved[:4]
    stamps, rates, forces, angles, speeds = read(rng, imu, moved, given)
    wrong = Rotation.from_rotvec(5e-3 * rng.normal(size=3)) * Rotation.from_quat(quaternions[0])
    start = (*(1e-3 * rng.normal(size=2)), *np.roll(wrong.as_quat(), 1))
    odometry = Odometry(OdometrySettings(initial_state=start), imu, robot)
    looks, told = list(LOOKS), set[str]()
    found: list[tuple[float, ...]] = []
    for k, stamp in enumerate(stamps.tolist()):
        odometry.observe_imu(stamp, rates[k], forces[k])
        odometry.observe_rotors(stamp, speeds[k], angles[k])
        odometry.check(stamp)
        told |= {one.name for one in odometry.conditions}
        if looks and stamp >= looks[0] - 1e-9 and odometry.estimate is not None:
            looks.pop(0)
            estimate, fine = odometry.estimate, round(stamp * FINE)
            true = np.concatenate((places[fine, :2], np.roll(quaternions[fine], 1)))
            error, within = error_between(estimate.pose, true), estimate.covariance
            square = error @ np.linalg.solve(within, error) / 5.0
            place = error[:2] @ np.linalg.solve(within[:2, :2], error[:2]) / 2.0
            turn = error[2:] @ np.linalg.solve(within[2:, 2:], error[2:]) / 3.0
            up = Rotation.from_quat(quaternions[fine]).inv().apply((0.0, 0.0, 1.0))
            heading = (up @ error[2:]) ** 2 / (up @ within[2:, 2:] @ up)
            squares = map(float, (square, place, turn, heading))
            found.append((
                *squares, float(np.hypot(*error[:2])),
                math.degrees(float(np.linalg.norm(error[2:]))),
            ))
    return Followed(found, sorted(told - {"calibrating at rest"}))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--drives", type=int, default=50)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", nargs="*", default=[], choices=list(KINDS))
    given = parser.parse_args()
    kinds = given.only or list(KINDS)
    tasks = [(kinds, seed) for seed in range(given.drives)]
    every = list(in_processes(drives, tasks, given.jobs))
    print(header(
        "errors", "NEES over degrees of freedom at the end (median)", "in motion",
        "of position at the end", "of orientation", "of heading", "median errors", "reported",
    ))
    for kind in kinds:
        runs = [run[kind] for run in every]
        squares = np.array([run.looks for run in runs])
        ends, moves = squares[:, -1], squares[:, [0, 1, 3, 4], 0]
        mean, *parts = ends[:, :4].mean(axis=0)
        off, degrees = np.median(ends[:, 4:], axis=0)
        print(row(
            kind, f"{mean:.2f} ({np.median(ends[:, 0]):.2f})", f"{moves.mean():.2f}",
            *(f"{part:.2f}" for part in parts), f"{1e3 * off:.1f} mm, {degrees:.2f}°",
            ", ".join(sorted({name for run in runs for name in run.reported})),
        ))


if __name__ == "__main__":
    main()

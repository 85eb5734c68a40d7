# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Constants, noise and drives estimated from the motion of an independently written plant."""

import dataclasses

import numpy as np
import pytest

from sphere_nmpc.estimation import equations, moving_horizon
from sphere_nmpc.estimation.motion import Interval
from sphere_nmpc.estimation.moving_horizon import MovingHorizon
from sphere_nmpc.estimation.posterior import (
    CONSTANTS,
    KNOT,
    LOCAL,
    SHARE,
    Posterior,
    Scaling,
)
from sphere_nmpc.estimation.settings import TABLE_1_NUMBERS
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.world.plant.rolling_plant import RollingPlant

pytestmark = pytest.mark.slow

NOMINAL = RobotParameters()
PERIOD = 0.25
LIMIT = 400.0
"""Limit of the speeds that are sent [rad/s^2]."""
SCALING = Scaling(NOMINAL.lumped, LIMIT, TABLE_1_NUMBERS)
START = np.array([0, 0, 1.0, 0, 0, 0])
EXACT = np.full(5, TABLE_1_NUMBERS.pose)


def new_horizon(acceleration: float = np.inf) -> MovingHorizon:
    scaling = dataclasses.replace(SCALING, acceleration=acceleration)
    horizon = MovingHorizon(scaling, Posterior.initial(0.0, scaling), EXACT, momentum=True)
    horizon.start_at(0.0, START)
    return horizon


def random_speeds(samples: int, seed: int) -> list[Vector]:
    return list(np.random.default_rng(seed).uniform(-100.0, 100.0, (samples, 2)))


def drive(
    horizon: MovingHorizon, robot: RobotParameters, speeds: list[Vector], share: float = np.inf,
    noise: float = 0.0, moved: float = 0.0,
) -> None:
    """Send ramps to a plant with drives of a share of the torque, and pass the poses on.

    The robot is moved by `moved` [m] in each direction during the fifth sample.
    """
    rng, plant = np.random.default_rng(len(speeds)), RollingPlant(robot, START)
    sent: list[Vector] = [np.zeros(2)] * 5
    for i, wanted in enumerate(speeds):
        sent.append(wanted)
        durations, inputs = np.full(5, PERIOD), np.array(sent[-6:])
        raw = Interval(np.array([PERIOD]), plant.state[None], durations, inputs, lead=4.0 * PERIOD)
        driven = raw.driven(share * LIMIT, plant.state, robot.lumped.as_array(), 0.1 * PERIOD)
        pieces, attained, _ = driven.window(0.0)
        for duration, ends in zip(pieces, attained[1:], strict=True):
            plant.advance(ends, float(duration))
        away = noise * rng.normal(size=6)
        away[:2] += moved * (i == 4)
        seen = plant.state + away
        seen[2:] /= np.linalg.norm(seen[2:])
        plant.displace(seen)
        horizon.observe(dataclasses.replace(raw, poses=seen[None]), (i + 1) * PERIOD)


def errors_of_constants(horizon: MovingHorizon, robot: RobotParameters) -> Vector:
    found = horizon.result.common[CONSTANTS] * NOMINAL.lumped.as_array()
    return np.asarray(found / robot.lumped.as_array() - 1.0)


def relative_error(horizon: MovingHorizon, robot: RobotParameters) -> float:
    return float(np.max(np.abs(errors_of_constants(horizon, robot))))


def other_robot(share: float, seed: int) -> RobotParameters:
    return perturbed(NOMINAL, share, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("robot", "samples", "allowed"),
    [
        # The prediction's own error over a sample is 1e-5 of about 0.1 m; one path tells the two
        # ratios apart ten times worse than that.
        *((other_robot(share, seed), 8, 1e-3) for share in (0.03, 0.2) for seed in (0, 1)),
        # Five standard deviations from the prior; the largest that 20 % in all parameters give.
        (dataclasses.replace(
            NOMINAL, rotor_axial_inertia=1.55 * 0.008, rotor_transverse_inertia=0.0045
        ), 4, 3e-3),
    ],
    ids=["3 %", "3 %, other", "20 %", "20 %, other", "far from the prior"],
)
def test_wrong_parameters_are_corrected_within_two_seconds_and_do_not_pass_for_noise(
    robot: RobotParameters, samples: int, allowed: float
) -> None:
    for seed in range(2):
        horizon = new_horizon()
        drive(horizon, robot, random_speeds(samples, seed))
        assert relative_error(horizon, robot) < allowed
        assert horizon.result.noise < 1e-4


def test_noise_is_distinguished_from_wrong_constants() -> None:
    robot = other_robot(0.03, 3)
    horizon = new_horizon()
    drive(horizon, robot, random_speeds(40, 3), noise=1e-3)
    # 12 steps of 5 components: the deviation of a deviation is 9 %; four of these.
    assert horizon.result.noise == pytest.approx(1e-3, rel=0.36)
    deviations = np.sqrt(np.diag(horizon.result.covariance)[KNOT : KNOT + 4])
    assert np.all(np.abs(errors_of_constants(horizon, robot)) < 4.0 * deviations)
    assert horizon.result.undisturbed


def test_jumps_of_a_sphere_at_rest_are_hardly_ever_taken_for_momentum() -> None:
    disturbed, samples = 0, 60
    for seed in range(2):
        rng, horizon, pose = np.random.default_rng(seed), new_horizon(), START.copy()
        for k in range(samples):
            if k % 2 == 0:
                pose = pose + 1e-3 * rng.normal(size=6)
                pose[2:] /= np.linalg.norm(pose[2:])
            still = np.array([PERIOD] * 2), np.zeros((3, 2))
            horizon.observe(
                Interval(np.array([PERIOD]), pose[None], *still, lead=PERIOD), (k + 1) * PERIOD
            )
            disturbed += not horizon.result.undisturbed
    # In each run the scale of the noise has to be learnt, within which the rotors may respond.
    assert disturbed <= 0.02 * 2 * samples


@pytest.mark.parametrize(
    ("share", "moved"), [(0.6, 0.0), (0.93, 0.0), (1.0, 0.0), (0.8, -0.02), (1.0, -0.02)]
)
def test_weak_drives_are_told_from_wrong_constants_and_a_robot_that_is_moved(
    share: float, moved: float
) -> None:
    robot = NOMINAL if moved else other_robot(0.2, 1)
    horizon, rng, speeds = new_horizon(LIMIT), np.random.default_rng(4), [np.zeros(2)]
    for i in range(8):  # ramps at the limit, with pauses between
        change = 0.0 if i % 3 == 2 else rng.choice([-1.0, 1.0], 2) * LIMIT * PERIOD
        speeds.append(np.clip(speeds[-1] + change, -100.0, 100.0))
    drive(horizon, robot, speeds[1:], share, moved=moved)
    assert horizon.result.common[SHARE] == pytest.approx(share, rel=0.01)
    if not moved:
        assert SCALING.lag(horizon.result.common) < 5e-4
        # Eight samples of which a third hold their speeds tell less than random ones.
        assert relative_error(horizon, robot) < 3e-3


def test_an_interval_without_news_is_fitted_once_and_its_covariance_is_that_of_all_unknowns(
    monkeypatch,
) -> None:
    """At rest, or as predicted: one solution, and one to sum up the oldest interval."""
    solved = list[equations.NormalEquations]()

    class Seen(equations.NormalEquations):
        def __init__(self, *given) -> None:
            super().__init__(*given)
            solved.append(self)

    monkeypatch.setattr(moving_horizon, "NormalEquations", Seen)
    counts = []
    for rests in (8, 16):
        drive(new_horizon(LIMIT), NOMINAL, random_speeds(4, 1) + [np.zeros(2)] * rests)
        counts.append(len(solved) - sum(counts))
    assert counts[1] - counts[0] <= 2 * 8
    largest = max(solved, key=lambda one: one.gradient.size)
    expected = np.linalg.inv(largest.information)[-LOCAL:, -LOCAL:]
    units = np.sqrt(np.diag(expected))
    # Rounding, 1e-16, times the condition of the information, below 1e8.
    np.testing.assert_allclose(
        largest.covariance() / np.outer(units, units), expected / np.outer(units, units), atol=1e-8
    )

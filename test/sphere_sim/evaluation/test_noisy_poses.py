# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop on slow, noisy, late and lost poses."""

from functools import cache

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.metrics import angle_errors, position_errors
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
CASE = PAPER_CASES[3]
POSITION_NOISE, ANGLE_NOISE = 0.005, float(np.radians(1.0))
NEAR, NEAR_ANGLE = 0.03, float(np.radians(3.0))


def world(plant: str = "rolling") -> Simulator:
    settings = SimulatorSettings(
        plant=plant, initial_state=tuple(CASE.start), seed=3,
        position_noise=POSITION_NOISE, orientation_noise=ANGLE_NOISE,
        sensor_rate=20.0, sensor_latency=0.05, sensor_dropout=0.2,
    )
    return Simulator(settings, ROBOT)


@cache
def run(strategy: str, plant: str = "rolling", fused: bool = True) -> Trajectory:
    settings = ControllerSettings(
        strategy=strategy, planning_effort=60_000,
        pose_position_noise=POSITION_NOISE if fused else 0.0,
        pose_orientation_noise=ANGLE_NOISE if fused else 0.0,
    )
    controller = Controller(settings, ROBOT)
    return run_closed_loop(
        world(plant), controller, CASE.goal, 12.0, settings.control_period, 0.05
    )


def is_off_goal(states: Vector) -> Vector:
    far: Vector = (position_errors(states, CASE.goal) > NEAR) | (
        angle_errors(states, CASE.goal) > NEAR_ANGLE
    )
    return far


@pytest.mark.parametrize(
    ("strategy", "plant"),
    [("paper", "rolling"), ("time_optimal", "rolling"), ("time_optimal", "rigid_body")],
)
def test_case_3_reaches_the_goal_and_stays_there(strategy: str, plant: str) -> None:
    if plant == "rigid_body":
        pytest.importorskip("mujoco")
    found = run(strategy, plant)
    assert not np.any(is_off_goal(found.states[found.times > 8.0]))


def test_without_the_estimator_the_papers_controller_leaves_the_goal() -> None:
    found = run("paper", fused=False)
    assert np.any(is_off_goal(found.states[found.times > 8.0]))


def test_decisions_have_a_covariance_below_that_of_the_poses() -> None:
    found = run("paper")
    estimated = [d for d in found.decisions if d.state is not None and d.covariance is not None]
    assert len(estimated) >= len(found.decisions) - 1
    last = estimated[-1]
    assert 0.0 < last.position_deviation < POSITION_NOISE
    assert 0.0 < last.angle_deviation < ANGLE_NOISE


def test_decisions_on_exact_poses_have_no_covariance() -> None:
    assert all(d.covariance is None for d in run("paper", fused=False).decisions)

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Order, accuracy and invariants of the Lie-group integrator; figures in ``docs/model.md``."""

import casadi as ca
import numpy as np
from motions import integrate

from sphere_nmpc.model.integrator import step_function
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector, as_state
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
P = ROBOT.lumped.as_array()
PERIOD = 0.5
"""Sample period of the paper [s]."""
DRAWS = 500
START, A, B = as_state([0.3, 0.1, 0.8, 0.6, 0, 0]), np.array([80.0, 10.0]), np.array([-40, 90.0])


def draws() -> tuple[Vector, Vector, Vector]:
    """Return random states, shape (6, K), and speeds at both ends of an interval, (2, K)."""
    rng = np.random.default_rng(0)
    quaternions = rng.normal(size=(4, DRAWS))
    quaternions /= np.linalg.norm(quaternions, axis=0)
    states = np.vstack((rng.uniform(-3, 3, (2, DRAWS)), quaternions))
    u_start, u_end = rng.uniform(-100.0, 100.0, size=(2, 2, DRAWS))
    return states, u_start, u_end


def over_one_period(step: ca.Function, steps: int) -> Vector:
    x, u_start, u_end = draws()
    many = step.map(DRAWS)
    for i in range(steps):
        here = u_start + (u_end - u_start) * (i / steps)
        there = u_start + (u_end - u_start) * ((i + 1) / steps)
        x = np.array(many(x, here, there, PERIOD / steps, P))
    return x


def errors(step: ca.Function, steps: int, truth: Vector) -> Vector:
    return np.linalg.norm(over_one_period(step, steps) - truth, axis=0)


def test_order_is_four_and_error_of_a_period_is_small() -> None:
    truth = over_one_period(step_function(), 200)
    steps = np.array([8, 12, 16, 24, 32])
    medians = [np.median(errors(step_function(), int(n), truth)) for n in steps]
    slope = -np.polyfit(np.log(steps), np.log(medians), 1)[0]
    assert 3.7 < slope < 4.3, slope
    # Five steps at the speeds of the paper; twice what 2000 draws gave, as these are fewer.
    assert np.quantile(errors(step_function(), 5, truth), 0.99) < 4e-4


def test_long_run_agrees_with_the_independent_plant_and_keeps_the_unit_norm() -> None:
    rng = np.random.default_rng(2)
    x = as_state([1.0, -2.0, 0.1, 0.7, -0.1, 0.7])
    plant, u = RollingPlant(ROBOT, x), np.zeros(2)
    for _ in range(20):
        following = rng.uniform(-100, 100, 2)
        x = integrate(x, u, following, PERIOD, P, max_step=0.0125)
        plant.advance(following, PERIOD)
        u = following
    # Both methods make about 1e-7 an interval at full speed, over 20 intervals.
    np.testing.assert_allclose(x, plant.state, atol=5e-6)
    # 800 steps of five exponentials each: a random walk of 1e-16 a factor.
    assert abs(np.linalg.norm(x[QUATERNION]) - 1.0) < 1e-13


def test_motion_runs_backwards_when_the_inputs_do_and_no_time_is_no_motion() -> None:
    there = integrate(START, A, B, PERIOD, P, max_step=0.01)
    back = integrate(there, -B, -A, PERIOD, P, max_step=0.01)
    np.testing.assert_allclose(back, START, atol=1e-7)
    np.testing.assert_array_equal(integrate(START, A, B, 0.0, P), START)

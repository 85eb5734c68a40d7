# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The control loop with momentum: what it reports, and commands within the limits."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision, Mode
from sphere_nmpc.estimation.contract import Estimate
from sphere_nmpc.estimation.exact_poses import ExactPoseEstimator
from sphere_nmpc.model import rotation
from sphere_nmpc.model.drift import Drift, momentum_of_push, slope_torque
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, make_state, state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_nmpc.strategy.rest import SATURATED
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rolling_plant import RollingPlant
from sphere_sim.world.push import Push
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
LIMIT = ROBOT.max_rotor_speed
EFFORT = 20_000
GIVEN = ControllerSettings(learning=False, momentum=False, planning_effort=EFFORT)
"""Settings with an estimator that does not estimate: the drift is given to it."""
PERIOD = GIVEN.period
UPRIGHT = make_state(np.zeros(2), np.array([1.0, 0.0, 0.0, 0.0]))
TILTED = make_state(np.zeros(2), rotation.exponential(np.array([0.15, 0.0, 0.0])))
SLOPE = slope_torque(ROBOT, np.radians(0.5), 0.3)


def give(monkeypatch: pytest.MonkeyPatch, drift: Drift) -> None:
    """Let every estimate have the given drift."""
    estimate = ExactPoseEstimator.estimate

    def with_drift(estimator: ExactPoseEstimator, time: float) -> Estimate | None:
        found = estimate(estimator, time)
        return None if found is None else replace(found, drift=drift)

    monkeypatch.setattr(ExactPoseEstimator, "estimate", with_drift)


def decided(controller: Controller, time: float, state: Vector) -> Decision:
    controller.observe(time, state)
    return controller.decide(time)


def check_limits(hold: FirstOrderHold | None) -> FirstOrderHold:
    assert hold is not None
    assert np.max(np.abs(hold.speeds)) <= LIMIT + 1e-9
    slopes = np.abs(np.diff(hold.speeds, axis=0)) / np.diff(hold.times)[:, None]
    assert np.max(slopes, initial=0.0) <= ROBOT.max_rotor_acceleration + 1e-6
    np.testing.assert_array_equal(hold.speeds[-1], [0.0, 0.0])
    return hold


def test_decision_has_the_drift_and_what_is_given_up_of_the_goal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drift = Drift(np.array([0.0, 30.0, 0.0]), SLOPE)
    give(monkeypatch, drift)
    controller = Controller(GIVEN, ROBOT)
    controller.set_goal(UPRIGHT)
    held = decided(controller, 0.0, UPRIGHT)
    assert held.drift is drift and held.plan.given_up == ""
    controller.set_goal(TILTED)
    turned = decided(controller, PERIOD, UPRIGHT)
    assert turned.mode is Mode.TRACKING
    assert turned.plan.given_up.startswith("orientation by ")
    # The error is that of the goal that was given, not of the nearest one.
    assert turned.angle_error == pytest.approx(0.15, rel=1e-9)


def test_momentum_that_cannot_be_held_is_a_mode_of_its_own(monkeypatch) -> None:
    give(monkeypatch, Drift(np.array([40.0, -150.0, 0.0])))
    controller = Controller(GIVEN, ROBOT)
    controller.set_goal(UPRIGHT)
    decision = decided(controller, 0.0, UPRIGHT)
    assert decision.mode is Mode.SATURATED and decision.solved
    assert decision.plan.status is PlanStatus.SATURATED
    assert decision.plan.given_up == SATURATED
    hold = check_limits(controller.commit(decision, 0.0))
    # From 0 to 100 rad/s at 400 rad/s^2, and then for a second.
    for time in (0.25, 1.25):
        np.testing.assert_allclose(hold.at(time), [40.0, -LIMIT], rtol=1e-12)


def test_failed_plan_leaves_the_rotors_holding_the_momentum_for_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drift = Drift(np.array([20.0, 30.0, 0.0]), SLOPE)
    give(monkeypatch, drift)
    controller = Controller(GIVEN, ROBOT)
    controller.set_goal(UPRIGHT)
    first = decided(controller, 0.0, UPRIGHT)
    assert first.plan.status in (PlanStatus.HOLDING, PlanStatus.SOLVED)
    hold = check_limits(controller.commit(first, 0.0))
    # Up to the ramp to zero, which takes at most a fifth of a second.
    held = drift.after_slope(hold.end - 0.3)
    speeds = float(np.linalg.norm(hold.at(hold.end - 0.3)))
    assert speeds == pytest.approx(float(np.linalg.norm(held.momentum)), rel=0.02)

    def fail(*arguments: object) -> None:
        raise ArithmeticError("made to fail")

    monkeypatch.setattr(
        "sphere_nmpc.strategy.time_optimal.strategy.TimeOptimalStrategy.plan", fail
    )
    for late in (0.0, 0.07):
        decision = decided(controller, PERIOD + late, UPRIGHT)
        assert decision.mode is Mode.FALLBACK and decision.drift is drift
        kept = check_limits(controller.commit(decision, PERIOD + late))
        for time in np.linspace(PERIOD + late, hold.end, 9):
            # Rounding of speeds of up to 100 rad/s.
            np.testing.assert_allclose(kept.at(time), hold.at(time), atol=1e-9)


def test_estimated_slope_saturates_the_rotors_and_is_reported() -> None:
    world = DisturbanceSettings(slope=float(np.radians(1.0)), slope_direction=0.5)
    simulator = Simulator(
        SimulatorSettings(initial_state=tuple(UPRIGHT)), ROBOT, RollingPlant(ROBOT, UPRIGHT, world)
    )
    controller = Controller(ControllerSettings(planning_effort=EFFORT), ROBOT)
    found = run_closed_loop(simulator, controller, UPRIGHT, 6.5, PERIOD)
    assert controller.failures == 0
    for hold in found.holds:
        check_limits(hold)
    expected = slope_torque(ROBOT, world.slope, world.slope_direction)
    np.testing.assert_allclose(found.decisions[-1].drift.slope, expected, atol=0.3)
    # One rotor takes cos 0.5 of 24.4 rad/s^2: it is full after 4.7 s.
    modes = [decision.mode for decision in found.decisions]
    first = modes.index(Mode.SATURATED) * PERIOD
    assert 4.5 <= first <= 5.5
    assert set(modes[modes.index(Mode.SATURATED) :]) == {Mode.SATURATED}
    assert np.max(np.abs(found.speeds)) == LIMIT
    # At rest on the goal for the second before.
    away = np.linalg.norm(found.states[360:460] - UPRIGHT, axis=1)
    assert np.max(away) < 1e-2


def test_estimated_push_at_the_goal_is_held() -> None:
    impulse = (0.5, -0.3)
    simulator = Simulator(SimulatorSettings(initial_state=tuple(UPRIGHT)), ROBOT)
    controller = Controller(ControllerSettings(planning_effort=EFFORT), ROBOT)
    found = run_closed_loop(simulator, controller, UPRIGHT, 8.0, PERIOD, push=Push(2.1, impulse))
    expected = momentum_of_push(ROBOT, np.array(impulse))
    np.testing.assert_allclose(found.decisions[-1].drift.momentum, expected, atol=0.1)
    np.testing.assert_allclose(found.speeds[-1], expected[:2], atol=0.1)
    assert max(state_error(state, UPRIGHT) for state in found.states[-100:]) < 1e-2
    assert found.decisions[-1].mode is Mode.AT_GOAL

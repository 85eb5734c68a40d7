# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The control loop without its transport, in regular operation and when something fails."""

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest

from sphere_nmpc.conditions import Kind
from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.link import Commands
from sphere_nmpc.control.monitors import ArrivalDetector
from sphere_nmpc.estimation.estimator import Estimator
from sphere_nmpc.estimation.pose_filter import Estimate, PoseFilter
from sphere_nmpc.model.disturbance import slope_torque
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, Vector, as_state
from sphere_nmpc.settings import STRATEGIES, ControllerSettings, StrategyEntry
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rolling_plant import RollingPlant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
SETTINGS = ControllerSettings(strategy="paper")
ORIGIN = as_state([0, 0, 1, 0, 0, 0])
START = as_state([2.0, -3.0, 0.03, 0.454, 0.88, 0.1363])
PERIOD = SETTINGS.period


class Scripted:
    """Strategy that returns the knots of the test and records how it was called."""

    def __init__(self) -> None:
        self.knots = np.array([[60.0, -40.0], [20.0, 30.0], [-50.0, 10.0], [30.0, 30.0]])
        self.error: Exception | None = None
        self.states: Vector | None = None
        self.resets = 0
        self.situations: list[Situation] = []

    def plan(self, situation: Situation) -> Plan:
        self.situations.append(situation)
        if self.error is not None:
            raise self.error
        times = situation.time + PERIOD * np.arange(len(self.knots) + 1)
        hold = FirstOrderHold(times, np.vstack((situation.input_in_force, self.knots)))
        states = np.tile(situation.state, (times.size, 1)) if self.states is None else self.states
        return Plan(PlanStatus.SOLVED, hold, states)

    def change(self, settings: ControllerSettings) -> None:
        pass

    def reset(self) -> None:
        self.resets += 1


@pytest.fixture
def strategy() -> Scripted:
    return Scripted()


@pytest.fixture
def controller(strategy: Scripted) -> Controller:
    made = Controller(SETTINGS, ROBOT, strategy)
    made.set_goal(ORIGIN)
    return made


def sample(controller: Controller, time: float, delay: float = 0.0) -> Kind:
    decision = controller.decide(time)
    controller.commit(decision, time + delay)
    return decision.mode


def track(controller: Controller, time: float = 0.0) -> None:
    """Let the controller plan and command its first motion at `time` [s]."""
    controller.observe(time, START)
    assert sample(controller, time) is Kind.TRACKING


def ramp_is_safe(hold: FirstOrderHold) -> None:
    slopes = np.abs(np.diff(hold.speeds, axis=0)) / np.diff(hold.times)[:, None]
    assert np.all(slopes <= ROBOT.max_rotor_acceleration + 1e-6)
    np.testing.assert_array_equal(hold.speeds[-1], [0.0, 0.0])


def within_limits(hold: FirstOrderHold | None) -> FirstOrderHold:
    assert hold is not None
    assert np.max(np.abs(hold.speeds)) <= ROBOT.max_rotor_speed + 1e-9
    ramp_is_safe(hold)
    return hold


def test_without_pose_or_goal_nothing_is_sent() -> None:
    controller = Controller(SETTINGS, ROBOT, Scripted())
    decision = controller.decide(0.0)
    assert decision.mode is Kind.NO_POSE and np.isnan(decision.error)
    assert decision.plan.status is PlanStatus.RAMP_TO_REST
    assert controller.commit(decision, 0.0) is None
    controller.observe(0.0, START)
    decision = controller.decide(0.1)
    assert decision.mode is Kind.NO_GOAL and np.isnan(decision.angle_error)
    np.testing.assert_array_equal(decision.state[POSE], START)
    assert controller.commit(decision, 0.1) is None


def test_stale_pose_ramps_the_rotors_to_rest_at_the_limit_until_a_fresh_one(
    controller: Controller, strategy: Scripted
) -> None:
    away = SETTINGS.pose_timeout + 0.01
    for began in (0.0, 10.0):
        track(controller, began)
        resets, late = strategy.resets, began + away
        in_force = controller.speeds_at(late)
        decision = controller.decide(late)
        assert decision.mode is Kind.NO_FRESH_POSE and decision.state is None
        assert decision.pose_age == pytest.approx(away)
        hold = controller.commit(decision, late)
        assert hold is not None
        ramp_is_safe(hold)
        assert hold.end - late == pytest.approx(np.max(np.abs(in_force)) / 400.0)
        for time in (late + 0.002, late + 1.0):
            assert sample(controller, time) is Kind.NO_FRESH_POSE
        assert strategy.resets == resets + 1, "once: it may take long"
        assert strategy.situations[-1].time == began
        # At rest and still without a pose, nothing more is sent.
        assert controller.commit(controller.decide(late + 1.0), late + 1.0) is None




def test_pose_out_of_order_or_from_the_future_is_dropped(controller: Controller) -> None:
    controller.observe(1e6, START)
    assert sample(controller, 0.0) is Kind.NO_FRESH_POSE
    assert controller.observe(1.01, START)
    assert not controller.observe(0.9, ORIGIN)
    assert not controller.observe(1.01, ORIGIN)
    assert controller.late_poses == 2
    decision = controller.decide(1.0)
    assert decision.mode is Kind.TRACKING
    np.testing.assert_array_equal(decision.state[POSE], START)


UNUSABLE: dict[str, Any] = {
    "error": RuntimeError("no plan"),
    "states": np.full((5, 9), np.nan),
    "plan": lambda situation: None,
}


@pytest.mark.parametrize("kind", UNUSABLE)
def test_strategy_that_fails_leaves_the_hold_in_force_which_ends_at_rest(
    controller: Controller, strategy: Scripted, kind: str
) -> None:
    track(controller)
    times, resets = np.arange(PERIOD, 4.0, 0.1), strategy.resets
    expected = [controller.speeds_at(t).copy() for t in times]
    setattr(strategy, kind, UNUSABLE[kind])
    for k in range(1, 4):
        time = k * PERIOD
        controller.observe(time, START)
        decision = controller.decide(time)
        assert decision.mode is Kind.FALLBACK and not decision.solved
        assert decision.plan.status is PlanStatus.FALLBACK
        assert decision.plan.message == controller.last_failure != ""
        assert controller.commit(decision, time) is not None
    found = [controller.speeds_at(t) for t in times]
    np.testing.assert_array_equal(found[-1], [0.0, 0.0])
    # The rest of the hold in force was sent again; rounding of 60 rad/s.
    np.testing.assert_allclose(found, expected, atol=1e-11)
    assert controller.failures == 3
    assert strategy.resets == resets + 3, "no invalid warm start is kept"
    setattr(strategy, kind, None) if kind != "plan" else delattr(strategy, kind)
    assert sample(controller, 4 * PERIOD - 0.1) is Kind.TRACKING


def test_disabled_controller_ramps_to_rest_and_resumes_when_enabled(
    controller: Controller,
) -> None:
    track(controller)
    controller.enabled = False
    controller.observe(0.4, START)
    decision = controller.decide(0.4)
    assert decision.mode is Kind.DISABLED
    hold = controller.commit(decision, 0.4)
    assert hold is not None
    ramp_is_safe(hold)
    assert controller.commit(controller.decide(0.8), 0.8) is None
    controller.enabled = True
    controller.observe(0.9, START)
    assert controller.awaits_start(1.0) and not controller.awaits_start(0.41)
    assert sample(controller, 1.0) is Kind.TRACKING
    controller.enabled = False
    controller.commit(controller.decide(1.0), 1.0)
    np.testing.assert_array_equal(controller.speeds_at(1.0 + PERIOD), [0.0, 0.0])


def test_forgetting_keeps_the_goal_only(controller: Controller) -> None:
    track(controller, 100.0)
    controller.forget()
    assert controller.decide(100.2).mode is Kind.NO_POSE
    assert controller.observe(0.0, START)  # the clock was set back
    assert sample(controller, 0.0) is Kind.TRACKING
    np.testing.assert_array_equal(controller.goal, ORIGIN)


FAILING = {
    "newest pose": (Estimator, "newest", False),
    "estimate": (Estimator, "estimate", False),
    "pose filter": (PoseFilter, "estimate", False),
    "uncertainty": (Estimate, "uncertainty", False),
    "judgement of the arrival": (ArrivalDetector, "update", False),
    "reset of the strategy": (Scripted, "reset", True),
    "command": (Commands, "joined", False),
    "command in force": (Commands, "in_force", False),
    "stop": (Commands, "stop", True),
}
"""Class, attribute, and whether it is used only where no fresh pose is left."""


@pytest.mark.parametrize("part", FAILING)
@pytest.mark.parametrize("enabled", [True, False])
def test_failure_of_any_part_is_counted_and_does_not_stop_the_loop(
    controller: Controller, strategy: Scripted, monkeypatch: pytest.MonkeyPatch, part: str,
    enabled: bool,
) -> None:
    def fail(*arguments: object) -> None:
        raise ArithmeticError("made to fail")

    track(controller)
    controller.enabled = enabled
    owner, name, late = FAILING[part]
    # Only then the command in force is asked for.
    strategy.error = RuntimeError("no plan") if name == "in_force" else None
    time = SETTINGS.pose_timeout + 1.0 if late else PERIOD
    in_force = controller.speeds_at(time)
    with monkeypatch.context() as patch:
        is_property = isinstance(getattr(owner, name), property | cached_property)
        patch.setattr(owner, name, property(fail) if is_property else fail)
        hold = controller.commit(controller.decide(time), time)
    if hold is None:
        assert owner is Commands, "the hold in force is followed"
    else:
        np.testing.assert_array_equal(hold.speeds[0], in_force)
        np.testing.assert_array_equal(hold.speeds[-1], [0.0, 0.0])
    strategy.error = None
    if enabled:
        assert controller.failures >= 1
        assert controller.last_failure == "ArithmeticError: made to fail"
    controller.enabled = True
    controller.observe(time + 0.1, START)
    assert sample(controller, time + 0.1) is Kind.TRACKING


def test_strategy_that_fails_in_every_call_and_cannot_be_made_again_does_not_stop_the_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Broken:
        def __init__(self, *arguments: object) -> None:
            if Broken.made:
                raise RuntimeError("no second one")
            Broken.made = True

        def fail(self, *arguments: object) -> None:
            raise RuntimeError("broken")

        made = False
        plan = change = reset = fail

    entry = StrategyEntry(0.25, "a module:Broken")
    monkeypatch.setattr(StrategyEntry, "load", lambda self: Broken)
    monkeypatch.setitem(STRATEGIES, "broken", entry)
    settings = ControllerSettings(strategy="broken")
    controller = Controller(settings, ROBOT)
    assert controller.set_goal(ORIGIN)
    assert controller.observe(0.0, START)
    assert sample(controller, 0.0) is Kind.FALLBACK
    controller.change(replace(settings, goal_tolerance=0.02))
    assert controller.failures >= 4 and controller.last_failure == "RuntimeError: no second one"
    assert controller.cancel()


def test_estimated_slope_saturates_the_rotors_and_is_reported() -> None:
    world = DisturbanceSettings(slope=float(np.radians(1.0)), slope_direction=0.5)
    simulator = Simulator(
        SimulatorSettings(initial_state=tuple(ORIGIN)), ROBOT, RollingPlant(ROBOT, ORIGIN, world)
    )
    settings = ControllerSettings(planning_effort=20_000)
    controller = Controller(settings, ROBOT)
    found = run_closed_loop(simulator, controller, ORIGIN, 6.5, settings.period)
    assert controller.failures == 0
    for hold in found.holds:
        within_limits(hold)
    expected = slope_torque(ROBOT, world.slope, world.slope_direction)
    np.testing.assert_allclose(found.decisions[-1].disturbance.slope, expected, atol=0.3)
    # One rotor takes cos 0.5 of 24.4 rad/s^2: it is full after 4.7 s.
    modes = [decision.mode for decision in found.decisions]
    first = modes.index(Kind.SATURATED) * settings.period
    assert 4.5 <= first <= 5.5
    assert set(modes[modes.index(Kind.SATURATED) :]) == {Kind.SATURATED}
    assert np.max(np.abs(found.speeds)) == ROBOT.max_rotor_speed
    # At rest on the goal for the second before.
    away = np.linalg.norm(found.states[360:460] - ORIGIN, axis=1)
    assert np.max(away) < 1e-2

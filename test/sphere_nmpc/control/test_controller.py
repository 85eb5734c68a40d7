# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The control loop without its transport, in regular operation and when something fails."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision, Mode
from sphere_nmpc.control.link import Commands
from sphere_nmpc.control.monitors import ArrivalDetector
from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.estimation.contract import Estimate
from sphere_nmpc.estimation.estimators import ExactPoseEstimator
from sphere_nmpc.model import rotation
from sphere_nmpc.model.drift import Drift, slope_torque
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, as_state, make_state
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import SATURATED
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
EPOCH = 1.7e9


class Scripted:
    """Strategy that returns the knots of the test and records how it was called."""

    def __init__(self) -> None:
        self.knots = np.array([[60.0, -40.0], [20.0, 30.0], [-50.0, 10.0], [30.0, 30.0]])
        self.error: Exception | None = None
        self.states: Vector | None = None
        self.resets = 0
        self.situations: list[Situation] = []
        self.changes: list[ControllerSettings] = []

    def plan(self, situation: Situation) -> Plan:
        self.situations.append(situation)
        if self.error is not None:
            raise self.error
        times = situation.time + PERIOD * np.arange(len(self.knots) + 1)
        hold = FirstOrderHold(times, np.vstack((situation.input_in_force, self.knots)))
        states = np.tile(situation.state, (times.size, 1)) if self.states is None else self.states
        return Plan(PlanStatus.SOLVED, hold, states)

    def change(self, settings: ControllerSettings) -> None:
        self.changes.append(settings)

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


def sample(controller: Controller, time: float, delay: float = 0.0) -> Mode:
    decision = controller.decide(time)
    controller.commit(decision, time + delay)
    return decision.mode


def track(controller: Controller, time: float = 0.0) -> None:
    """Let the controller plan and command its first motion at `time` [s]."""
    controller.observe(time, START)
    assert sample(controller, time) is Mode.TRACKING


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
    assert decision.mode is Mode.NO_POSE and np.isnan(decision.error)
    assert decision.plan.status is PlanStatus.RAMP_TO_REST
    assert controller.commit(decision, 0.0) is None
    controller.observe(0.0, START)
    decision = controller.decide(0.1)
    assert decision.mode is Mode.NO_GOAL and np.isnan(decision.angle_error)
    np.testing.assert_array_equal(decision.state, START)
    assert controller.commit(decision, 0.1) is None


def test_plan_is_sent_from_the_speed_in_force_and_ends_at_rest(controller: Controller) -> None:
    controller.observe(0.0, START)
    decision = controller.decide(0.0)
    hold = controller.commit(decision, 0.0)
    assert hold is not None
    np.testing.assert_array_equal(hold.speeds[0], [0.0, 0.0])
    np.testing.assert_allclose(hold.at(PERIOD), [60.0, -40.0])
    ramp_is_safe(hold)
    # The plan ends at 30 rad/s: the ramp behind it takes 30 / 400 s.
    assert hold.end == pytest.approx(4 * PERIOD + 30.0 / 400.0)


def test_state_is_predicted_to_the_sample_instant_with_what_was_sent(
    controller: Controller, strategy: Scripted
) -> None:
    track(controller)
    controller.decide(PERIOD - 0.1)
    moved = strategy.situations[-1]
    assert np.linalg.norm(moved.state - START) > 1e-2
    np.testing.assert_allclose(moved.input_in_force, 0.8 * np.array([60.0, -40.0]))


def test_stale_pose_ramps_the_rotors_to_rest_at_the_limit_until_a_fresh_one(
    controller: Controller, strategy: Scripted
) -> None:
    away = SETTINGS.pose_timeout + 0.01
    for began in (0.0, 10.0):
        track(controller, began)
        resets, late = strategy.resets, began + away
        in_force = controller.speeds_at(late)
        decision = controller.decide(late)
        assert decision.mode is Mode.NO_FRESH_POSE and decision.state is None
        assert decision.pose_age == pytest.approx(away)
        hold = controller.commit(decision, late)
        assert hold is not None
        ramp_is_safe(hold)
        assert hold.end - late == pytest.approx(np.max(np.abs(in_force)) / 400.0)
        for time in (late + 0.002, late + 1.0):
            assert sample(controller, time) is Mode.NO_FRESH_POSE
        assert strategy.resets == resets + 1, "once: it may take long"
        assert strategy.situations[-1].time == began
        # At rest and still without a pose, nothing more is sent.
        assert controller.commit(controller.decide(late + 1.0), late + 1.0) is None


BAD = [np.full(6, np.nan), np.array([np.inf, 0, 1, 0, 0, 0]), np.zeros(6), np.zeros(3)]


@pytest.mark.parametrize("bad", BAD, ids=str)
def test_invalid_pose_or_goal_is_refused_and_the_last_one_stays(
    controller: Controller, bad: Vector
) -> None:
    controller.observe(0.0, START)
    for time, state in ((0.1, bad), (np.nan, START), (np.inf, START)):
        with pytest.raises(InvalidStateError):
            controller.observe(time, state)
    with pytest.raises(InvalidStateError):
        controller.set_goal(bad)
    np.testing.assert_array_equal(controller.decide(0.0).state, START)
    np.testing.assert_array_equal(controller.goal, ORIGIN)


def test_pose_out_of_order_or_from_the_future_is_dropped(controller: Controller) -> None:
    controller.observe(1e6, START)
    assert sample(controller, 0.0) is Mode.NO_FRESH_POSE
    assert controller.observe(1.01, START)
    assert not controller.observe(0.9, ORIGIN)
    assert not controller.observe(1.01, ORIGIN)
    assert controller.late_poses == 2
    decision = controller.decide(1.0)
    assert decision.mode is Mode.TRACKING
    np.testing.assert_array_equal(decision.state, START)


UNUSABLE = {
    "raises": {"error": RuntimeError("no plan")},
    "not finite": {"states": np.full((5, 6), np.nan)},
    "nothing": {"plan": lambda situation: None},
    "no hold": {"plan": lambda situation: Plan(PlanStatus.SOLVED, None, START[None, :])},
}


@pytest.mark.parametrize("kind", UNUSABLE)
def test_strategy_that_fails_leaves_the_hold_in_force_which_ends_at_rest(
    controller: Controller, strategy: Scripted, kind: str
) -> None:
    track(controller)
    times, resets = np.arange(PERIOD, 4.0, 0.1), strategy.resets
    expected = [controller.speeds_at(t).copy() for t in times]
    for name, value in UNUSABLE[kind].items():
        setattr(strategy, name, value)
    for k in range(1, 4):
        time = k * PERIOD
        controller.observe(time, START)
        decision = controller.decide(time)
        assert decision.mode is Mode.FALLBACK and not decision.solved
        assert decision.plan.status is PlanStatus.FALLBACK
        assert decision.plan.message == controller.last_failure != ""
        hold = controller.commit(decision, time)
        assert hold is not None
        ramp_is_safe(FirstOrderHold(
            np.append(hold.times, hold.end + 1.0), np.vstack((hold.speeds, np.zeros(2)))
        ))
    found = [controller.speeds_at(t) for t in times]
    np.testing.assert_array_equal(found[-1], [0.0, 0.0])
    # The rest of the hold in force was sent again; rounding of 60 rad/s.
    np.testing.assert_allclose(found, expected, atol=1e-11)
    assert controller.failures == 3
    assert strategy.resets == resets + 3, "no invalid warm start is kept"
    for name in UNUSABLE[kind]:
        setattr(strategy, name, None) if name != "plan" else delattr(strategy, name)
    assert sample(controller, 4 * PERIOD - 0.1) is Mode.TRACKING


def test_measured_rotor_speeds_that_cannot_be_used_are_an_error_that_is_counted(
    controller: Controller,
) -> None:
    track(controller)
    speeds = controller.speeds_at(PERIOD)
    controller.observe_rotors(PERIOD, np.array([1.0, 2.0, 3.0]))
    assert controller.failures == 1 and "ValueError" in controller.last_failure
    np.testing.assert_array_equal(controller.speeds_at(PERIOD), speeds)


def test_command_of_a_late_clock_is_not_dated_before_the_last_one(controller: Controller) -> None:
    track(controller)
    newest = controller.commit(controller.decide(0.25), 0.27)
    controller.enabled = False
    stop = controller.commit(controller.decide(0.26), 0.26)
    assert newest is not None and stop is not None
    assert stop.start == newest.start, "an older command would be dropped by the follower"
    np.testing.assert_allclose(stop.speeds[0], newest.speeds[0])


def test_changed_goal_is_tracked_from_the_next_sample_without_a_jump_of_speed(
    controller: Controller, strategy: Scripted
) -> None:
    track(controller)
    goal, resets = as_state([1, 1, 0, 0, 0, 1]), strategy.resets
    assert controller.set_goal(goal) and not controller.set_goal(goal)
    assert strategy.resets == resets + 1
    goal[0] = 99.0
    before = controller.speeds_at(0.25)
    controller.observe(0.25, START)
    hold = controller.commit(controller.decide(0.25), 0.25)
    np.testing.assert_array_equal(strategy.situations[-1].goal, [1, 1, 0, 0, 0, 1])
    assert hold is not None
    np.testing.assert_array_equal(hold.speeds[0], before)


def test_disabled_controller_ramps_to_rest_and_resumes_when_enabled(
    controller: Controller,
) -> None:
    track(controller)
    controller.enabled = False
    controller.observe(0.4, START)
    decision = controller.decide(0.4)
    assert decision.mode is Mode.DISABLED
    hold = controller.commit(decision, 0.4)
    assert hold is not None
    ramp_is_safe(hold)
    assert controller.commit(controller.decide(0.8), 0.8) is None
    controller.enabled = True
    controller.observe(0.9, START)
    assert controller.awaits_start(1.0) and not controller.awaits_start(0.41)
    assert sample(controller, 1.0) is Mode.TRACKING
    controller.enabled = False
    controller.commit(controller.decide(1.0), 1.0)
    np.testing.assert_array_equal(controller.speeds_at(1.0 + PERIOD), [0.0, 0.0])


def test_forgetting_keeps_the_goal_only(controller: Controller) -> None:
    track(controller, 100.0)
    controller.forget()
    assert controller.decide(100.2).mode is Mode.NO_POSE
    assert controller.observe(0.0, START)  # the clock was set back
    assert sample(controller, 0.0) is Mode.TRACKING
    np.testing.assert_array_equal(controller.goal, ORIGIN)


@pytest.mark.parametrize("speed", [1e-12, 1e-7, 1e-4])
def test_plan_that_ends_almost_at_rest_on_a_wall_clock_is_sent(
    controller: Controller, strategy: Scripted, speed: float
) -> None:
    strategy.knots = np.full((4, 2), speed)
    controller.observe(EPOCH, START)
    hold = controller.commit(controller.decide(EPOCH), EPOCH)
    assert hold is not None
    assert np.max(np.abs(hold.at(hold.end))) <= speed


@pytest.mark.parametrize(
    "change",
    [{"goal_tolerance": 0.1}, {"planning_effort": 1000}, {"learning": False}, {"drive_lag": 0.01},
     {"pose_position_noise": 0.01}, {"strategy": "plan_keeping", "sample_period": PERIOD},
     {"sample_period": 2 * PERIOD}],
)
def test_live_change_keeps_the_strategy_unless_it_is_another_one(
    controller: Controller, strategy: Scripted, change: dict[str, Any]
) -> None:
    track(controller)
    changed = replace(SETTINGS, **change)
    controller.change(changed)
    assert sample(controller, PERIOD / 2) is Mode.TRACKING
    kept = (changed.strategy, changed.period) == (SETTINGS.strategy, PERIOD)
    assert strategy.changes == ([changed] if kept else [])
    assert len(strategy.situations) == (2 if kept else 1)
    assert strategy.resets == 1  # at the goal


FAILING = {
    "newest pose": (ExactPoseEstimator, "newest", False),
    "estimate": (ExactPoseEstimator, "estimate", False),
    "plant parameters": (ExactPoseEstimator, "plant", False),
    "uncertainty": (Estimate, "uncertainty", False),
    "judgement of the arrival": (ArrivalDetector, "update", False),
    "reset of the strategy": (Scripted, "reset", True),
}
"""Class, attribute, and whether it is used only where no fresh pose is left."""


def command_while_failing(
    controller: Controller, monkeypatch: pytest.MonkeyPatch, part: str
) -> FirstOrderHold:
    """Return the command of a sampling instant at which a part is used and fails."""
    owner, name, late = FAILING[part]
    calls: list[str] = []

    def record_and_fail(*arguments: object) -> None:
        calls.append(part)
        raise ArithmeticError("made to fail")

    is_property = isinstance(getattr(owner, name), property)
    time = SETTINGS.pose_timeout + 1.0 if late else PERIOD
    in_force = controller.speeds_at(time)
    with monkeypatch.context() as patch:
        patch.setattr(owner, name, property(record_and_fail) if is_property else record_and_fail)
        decision = controller.decide(time)
    assert calls
    hold = controller.commit(decision, time)
    assert hold is not None
    np.testing.assert_array_equal(hold.speeds[0], in_force)
    return hold


@pytest.mark.parametrize(
    ("part", "enabled"),
    # Without a plan the uncertainty is of no use.
    [(part, on) for on in (True, False) for part in FAILING if on or part != "uncertainty"],
)
def test_failure_of_any_part_is_counted_and_does_not_stop_the_loop(
    controller: Controller, monkeypatch: pytest.MonkeyPatch, part: str, enabled: bool
) -> None:
    track(controller)
    controller.enabled = enabled
    hold = command_while_failing(controller, monkeypatch, part)
    assert not np.any(hold.speeds[-1])
    if enabled:
        assert controller.failures == 1
        assert controller.last_failure == "ArithmeticError: made to fail"
    else:
        ramp_is_safe(hold)
        ramp = np.max(np.abs(hold.speeds[0])) / ROBOT.max_rotor_acceleration
        assert hold.end - hold.start == pytest.approx(ramp)
        controller.enabled = True
    controller.observe(hold.start + 0.1, START)
    assert sample(controller, hold.start + 0.1) is Mode.TRACKING


@pytest.mark.parametrize("part", ["in_force", "ramp_to_rest", "earliest", "joined"])
@pytest.mark.parametrize("time", [PERIOD, SETTINGS.pose_timeout + 1.0], ids=["fresh", "stale"])
@pytest.mark.parametrize("enabled", [True, False])
def test_command_that_fails_in_every_attempt_leaves_the_one_in_force_and_never_raises(
    controller: Controller, strategy: Scripted, monkeypatch: pytest.MonkeyPatch, part: str,
    time: float, enabled: bool,
) -> None:
    def fail(*arguments: object) -> FirstOrderHold:
        raise ArithmeticError("made to fail")

    track(controller)
    controller.enabled = enabled
    strategy.error = RuntimeError("no plan")
    times = np.arange(0.0, 4.0, 0.05)
    before = [controller.speeds_at(t) for t in times]
    with monkeypatch.context() as patch:
        patch.setattr(Commands, part, fail)
        hold = controller.commit(controller.decide(time), time)
    if hold is None:
        np.testing.assert_array_equal([controller.speeds_at(t) for t in times], before)
    else:
        ramp_is_safe(hold)
    assert hold is None or part in ("in_force", "ramp_to_rest")
    strategy.error, controller.enabled = None, True
    controller.observe(time + PERIOD, START)
    assert sample(controller, time + PERIOD) is Mode.TRACKING


EFFORT = 20_000
GIVEN = ControllerSettings(learning=False, momentum=False, planning_effort=EFFORT)
"""Settings with an estimator that does not estimate: the drift is given to it."""
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


def test_decision_has_the_drift_and_what_is_given_up_of_the_goal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drift = Drift(np.array([0.0, 30.0, 0.0]), SLOPE)
    give(monkeypatch, drift)
    controller = Controller(GIVEN, ROBOT)
    controller.set_goal(ORIGIN)
    held = decided(controller, 0.0, ORIGIN)
    assert held.drift is drift and held.plan.given_up == ""
    controller.set_goal(TILTED)
    turned = decided(controller, GIVEN.period, ORIGIN)
    assert turned.mode is Mode.TRACKING
    assert turned.plan.given_up.startswith("orientation by ")
    # The error is that of the goal that was given, not of the nearest one.
    assert turned.angle_error == pytest.approx(0.15, rel=1e-9)


def test_momentum_that_cannot_be_held_is_a_mode_of_its_own(monkeypatch) -> None:
    give(monkeypatch, Drift(np.array([40.0, -150.0, 0.0])))
    controller = Controller(GIVEN, ROBOT)
    controller.set_goal(ORIGIN)
    decision = decided(controller, 0.0, ORIGIN)
    assert decision.mode is Mode.SATURATED and decision.solved
    assert decision.plan.status is PlanStatus.SATURATED
    assert decision.plan.given_up == SATURATED
    hold = within_limits(controller.commit(decision, 0.0))
    # From 0 to 100 rad/s at 400 rad/s^2, and then for a second.
    for time in (0.25, 1.25):
        np.testing.assert_allclose(hold.at(time), [40.0, -ROBOT.max_rotor_speed], rtol=1e-12)


def test_failed_plan_leaves_the_rotors_holding_the_momentum_for_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drift = Drift(np.array([20.0, 30.0, 0.0]), SLOPE)
    give(monkeypatch, drift)
    controller = Controller(GIVEN, ROBOT)
    controller.set_goal(ORIGIN)
    first = decided(controller, 0.0, ORIGIN)
    assert first.plan.status in (PlanStatus.HOLDING, PlanStatus.SOLVED)
    hold = within_limits(controller.commit(first, 0.0))
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
        decision = decided(controller, GIVEN.period + late, ORIGIN)
        assert decision.mode is Mode.FALLBACK and decision.drift is drift
        kept = within_limits(controller.commit(decision, GIVEN.period + late))
        for time in np.linspace(GIVEN.period + late, hold.end, 9):
            # Rounding of speeds of up to 100 rad/s.
            np.testing.assert_allclose(kept.at(time), hold.at(time), atol=1e-9)


def test_estimated_slope_saturates_the_rotors_and_is_reported() -> None:
    world = DisturbanceSettings(slope=float(np.radians(1.0)), slope_direction=0.5)
    simulator = Simulator(
        SimulatorSettings(initial_state=tuple(ORIGIN)), ROBOT, RollingPlant(ROBOT, ORIGIN, world)
    )
    controller = Controller(ControllerSettings(planning_effort=EFFORT), ROBOT)
    found = run_closed_loop(simulator, controller, ORIGIN, 6.5, GIVEN.period)
    assert controller.failures == 0
    for hold in found.holds:
        within_limits(hold)
    expected = slope_torque(ROBOT, world.slope, world.slope_direction)
    np.testing.assert_allclose(found.decisions[-1].drift.slope, expected, atol=0.3)
    # One rotor takes cos 0.5 of 24.4 rad/s^2: it is full after 4.7 s.
    modes = [decision.mode for decision in found.decisions]
    first = modes.index(Mode.SATURATED) * GIVEN.period
    assert 4.5 <= first <= 5.5
    assert set(modes[modes.index(Mode.SATURATED) :]) == {Mode.SATURATED}
    assert np.max(np.abs(found.speeds)) == ROBOT.max_rotor_speed
    # At rest on the goal for the second before.
    away = np.linalg.norm(found.states[360:460] - ORIGIN, axis=1)
    assert np.max(away) < 1e-2

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The control loop without its transport: what stops the sphere, failures, any order of events."""

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from given_plans import Given, plan_of
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from motions import largest_slope
from sampled_loop import ROBOT, SampledLoop, check_hold

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.monitors import ArrivalDetector
from sphere_nmpc.control.sending import Commands
from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.estimation.estimator import Estimator
from sphere_nmpc.estimation.pose_filter import Estimate, PoseFilter
from sphere_nmpc.model.disturbance import slope_torque
from sphere_nmpc.model.state import POSE, as_state
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import STRATEGIES, ControllerSettings, StrategyEntry
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_sim.world.disturbances import DisturbanceSettings

SETTINGS = ControllerSettings(strategy="paper")
ORIGIN = as_state([0, 0, 1, 0, 0, 0])
START = as_state([2.0, -3.0, 0.03, 0.454, 0.88, 0.1363])
PERIOD = SETTINGS.period
KNOTS = np.array([[60.0, -40.0], [20.0, 30.0], [-50.0, 10.0], [30.0, 30.0]])


def scripted(situation: Situation) -> Plan:
    return plan_of(situation, [PERIOD] * 4, KNOTS)


@pytest.fixture
def strategy() -> Given:
    return Given(scripted)


@pytest.fixture
def controller(strategy: Given) -> Controller:
    """A controller whose first motion is planned and commanded at 0 s."""
    made = Controller(SETTINGS, ROBOT, strategy)
    made.set_goal(ORIGIN)
    assert sample(made, 0.0, seen=True) is Kind.TRACKING
    return made


def sample(controller: Controller, time: float, seen: bool = False) -> Kind:
    if seen:
        controller.observe(time, START)
    decision = controller.decide(time)
    controller.commit(decision, time)
    return decision.mode


def test_without_pose_or_goal_nothing_is_sent(strategy: Given) -> None:
    controller = Controller(SETTINGS, ROBOT, strategy)
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
    controller: Controller, strategy: Given
) -> None:
    away = SETTINGS.pose_timeout + 0.01
    for began in (0.0, 10.0):
        assert sample(controller, began, seen=True) is Kind.TRACKING
        resets, late = strategy.resets, began + away
        in_force = controller.rotors.at(late)
        decision = controller.decide(late)
        assert decision.mode is Kind.NO_FRESH_POSE and decision.state is None
        assert decision.pose_age == pytest.approx(away)
        hold = controller.commit(decision, late)
        check_hold(hold)
        assert hold.end - late == pytest.approx(np.max(np.abs(in_force)) / 400.0)
        for time in (late + 0.002, late + 1.0):
            assert sample(controller, time) is Kind.NO_FRESH_POSE
        assert strategy.resets == resets + 1, "once: it may take long"
        assert strategy.situations[-1].time == began
        # At rest and still without a pose, nothing more is sent.
        assert controller.commit(controller.decide(late + 1.0), late + 1.0) is None


def test_pose_out_of_order_or_from_the_future_is_dropped(strategy: Given) -> None:
    controller = Controller(SETTINGS, ROBOT, strategy)
    controller.set_goal(ORIGIN)
    controller.observe(1e6, START)
    assert sample(controller, 0.0) is Kind.NO_FRESH_POSE
    assert controller.observe(1.01, START)
    assert not controller.observe(0.9, ORIGIN)
    assert not controller.observe(1.01, ORIGIN)
    assert controller.late_poses == 2
    decision = controller.decide(1.0)
    assert decision.mode is Kind.TRACKING
    np.testing.assert_array_equal(decision.state[POSE], START)


def no_plan(situation: Situation) -> Plan:
    raise RuntimeError("no plan")


@pytest.mark.parametrize("make", [
    no_plan, lambda now: replace(scripted(now), states=np.full((5, 9), np.nan)), lambda now: None,
], ids=["error", "nan", "nothing"])
def test_strategy_that_fails_leaves_the_hold_in_force_which_ends_at_rest(
    controller: Controller, strategy: Given, make: Any
) -> None:
    times, resets = np.arange(PERIOD, 4.0, 0.1), strategy.resets
    expected = [controller.rotors.at(t).copy() for t in times]
    strategy.make = make
    for k in range(1, 4):
        time = k * PERIOD
        controller.observe(time, START)
        decision = controller.decide(time)
        assert decision.mode is Kind.FALLBACK and not decision.solved
        assert decision.plan.status is PlanStatus.FALLBACK
        assert decision.plan.message == controller.last_failure != ""
        assert controller.commit(decision, time) is not None
    found = [controller.rotors.at(t) for t in times]
    np.testing.assert_array_equal(found[-1], [0.0, 0.0])
    # The rest of the hold in force was sent again; rounding of 60 rad/s.
    np.testing.assert_allclose(found, expected, atol=1e-11)
    assert controller.failures == 3
    assert strategy.resets == resets + 3, "no invalid warm start is kept"
    strategy.make = scripted
    assert sample(controller, 4 * PERIOD - 0.1) is Kind.TRACKING


def test_disabled_controller_ramps_to_rest_and_resumes_when_enabled(
    controller: Controller,
) -> None:
    controller.enabled = False
    controller.observe(0.4, START)
    decision = controller.decide(0.4)
    assert decision.mode is Kind.DISABLED
    check_hold(controller.commit(decision, 0.4))
    assert controller.commit(controller.decide(0.8), 0.8) is None
    controller.enabled = True
    controller.observe(0.9, START)
    assert controller.awaits_start(1.0) and not controller.awaits_start(0.41)
    assert sample(controller, 1.0) is Kind.TRACKING
    controller.enabled = False
    assert sample(controller, 1.0) is Kind.DISABLED
    np.testing.assert_array_equal(controller.rotors.at(1.0 + PERIOD), [0.0, 0.0])


def test_forgetting_keeps_the_goal_only(controller: Controller) -> None:
    controller.observe(100.0, START)
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
    "reset of the strategy": (Given, "reset", True),
    "command": (Commands, "joined", False),
    "command in force": (Commands, "in_force", False),
    "stop": (Commands, "stopping", True),
}
"""Class, attribute, and whether it is used only where no fresh pose is left."""


@pytest.mark.parametrize("part", FAILING)
@pytest.mark.parametrize("enabled", [True, False])
def test_failure_of_any_part_is_counted_and_does_not_stop_the_loop(
    controller: Controller, strategy: Given, monkeypatch: pytest.MonkeyPatch, part: str,
    enabled: bool,
) -> None:
    def fail(*arguments: object) -> None:
        raise ArithmeticError("made to fail")

    controller.enabled = enabled
    owner, name, late = FAILING[part]
    if name == "in_force":  # which is asked for only then
        strategy.make = no_plan
    time = SETTINGS.pose_timeout + 1.0 if late else PERIOD
    in_force = controller.rotors.at(time)
    with monkeypatch.context() as patch:
        is_property = isinstance(getattr(owner, name), property | cached_property)
        patch.setattr(owner, name, property(fail) if is_property else fail)
        hold = controller.commit(controller.decide(time), time)
    if hold is None:
        assert owner is Commands, "the hold in force is followed"
    else:
        np.testing.assert_array_equal(hold.speeds[0], in_force)
        np.testing.assert_array_equal(hold.speeds[-1], [0.0, 0.0])
    strategy.make = scripted
    if enabled:
        assert controller.failures >= 1
        assert controller.last_failure == "ArithmeticError: made to fail"
    controller.enabled = True
    assert sample(controller, time + 0.1, seen=True) is Kind.TRACKING


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

    monkeypatch.setitem(globals(), "Broken", Broken)
    monkeypatch.setitem(STRATEGIES, "broken", StrategyEntry(f"{__name__}:Broken"))
    settings = ControllerSettings(strategy="broken")
    controller = Controller(settings, ROBOT)
    assert controller.set_goal(ORIGIN)
    assert sample(controller, 0.0, seen=True) is Kind.FALLBACK
    controller.change(replace(settings, goal_tolerance=0.02))
    assert controller.failures >= 4
    assert controller.last_failure.endswith("one that can be made (RuntimeError 'no second one')")
    assert controller.cancel()


def test_estimated_slope_saturates_the_rotors_and_is_reported() -> None:
    world = DisturbanceSettings(slope=float(np.radians(1.0)), slope_direction=0.5)
    settings = ControllerSettings(planning_effort=20_000)
    loop = SampledLoop(ORIGIN, settings, goal=ORIGIN, world=world)
    loop.run(6.5)
    assert loop.controller.failures == 0
    loop.check_limits()
    expected = slope_torque(ROBOT, world.slope, world.slope_direction)
    np.testing.assert_allclose(loop.decision.disturbance.slope, expected, atol=0.3)
    # One rotor takes cos 0.5 of 24.4 rad/s^2: it is full after 4.7 s.
    modes = [decision.mode for decision in loop.decisions]
    first = modes.index(Kind.SATURATED)
    assert 4.5 <= first * settings.period <= 5.5
    assert set(modes[first:]) == {Kind.SATURATED}
    assert np.max(np.abs(loop.speeds)) == ROBOT.max_rotor_speed
    # At rest on the goal for the second before.
    times = np.array(loop.times)
    assert np.max(loop.errors()[(times >= 3.6) & (times < 4.6)]) < 1e-2


knots = st.lists(
    st.tuples(st.floats(0.01, 0.6), st.floats(-500.0, 500.0), st.floats(-500.0, 500.0)),
    min_size=1, max_size=4,
)


class Events(RuleBasedStateMachine):
    """Time passes between events; the commands are checked after each of them."""

    @initialize(start=st.sampled_from([0.0, 50.0, 1.7e9]))
    def set_up(self, start: float) -> None:
        self.behaviour, self.knots = "sound", []
        self.controller = Controller(ControllerSettings(), ROBOT, Given(self.plan))
        self.now = start

    def plan(self, situation: Situation) -> Plan:
        """Return the given knots, an invalid plan, one for another time, or raise."""
        if self.behaviour == "raises":
            raise RuntimeError("erratic")
        gaps, speeds = zip(*((gap, (a, b)) for gap, a, b in self.knots), strict=True)
        plan = plan_of(situation, gaps, np.array(speeds))
        if self.behaviour == "nan":
            plan.states[-1, 0] = np.nan
        shift = {"early": -10.0, "late": 10.0}.get(self.behaviour, 0.0)
        return replace(plan, hold=plan.hold.delayed(shift))

    @rule(length=st.floats(0.0, 1.5))
    def wait(self, length: float) -> None:
        self.now += length

    @rule(age=st.floats(-1.0, 1.0), state=st.sampled_from([ORIGIN, START]))
    def pose(self, age: float, state: np.ndarray) -> None:
        self.controller.observe(self.now - age, state)

    @rule(bad=st.sampled_from([np.nan, np.inf, 0.0, 3.0]))
    def bad_pose(self, bad: float) -> None:
        with pytest.raises(InvalidStateError):
            self.controller.observe(self.now, np.full(6, bad))

    @rule(goal=st.sampled_from([ORIGIN, START]))
    def goal(self, goal: np.ndarray) -> None:
        self.controller.set_goal(goal)

    @rule(
        learning=st.booleans(), noise=st.sampled_from([0.0, 1e-3, 0.05]),
        lag=st.sampled_from([0.0, 0.01, 0.05]),
    )
    def change_settings(self, learning: bool, noise: float, lag: float) -> None:
        self.controller.change(
            ControllerSettings(learning=learning, pose_position_noise=noise, drive_lag=lag)
        )

    @rule()
    def clock_jump(self) -> None:
        self.controller.forget()

    @rule(enabled=st.booleans())
    def enable(self, enabled: bool) -> None:
        self.controller.enabled = enabled

    @rule(behaviour=st.sampled_from(["sound", "sound", "raises", "nan", "early", "late"]))
    def change_behaviour(self, behaviour: str) -> None:
        self.behaviour = behaviour

    @rule(delay=st.floats(0.0, 0.8), knots=knots)
    def sample(self, delay: float, knots: list[tuple[float, float, float]]) -> None:
        self.knots = knots
        decision = self.controller.decide(self.now)
        self.now += delay
        past = self.now - np.linspace(0.001, 1.0, 20)
        before = [self.controller.rotors.at(t) for t in past]
        in_force = self.controller.rotors.at(self.now)
        hold = self.controller.commit(decision, self.now)
        np.testing.assert_array_equal([self.controller.rotors.at(t) for t in past], before)
        # Rounding of times on a wall clock, 2.4e-7 s, at 400 rad/s^2.
        np.testing.assert_allclose(self.controller.rotors.at(self.now), in_force, atol=2e-4)
        if hold is not None:
            # The end of the ramp to rest is rounded to the clock's 2.4e-7 s.
            shortest = np.min(np.diff(hold.times), initial=np.inf)
            slack = 1e-6 + ROBOT.max_rotor_acceleration * np.spacing(self.now) / shortest
            assert largest_slope(hold) <= ROBOT.max_rotor_acceleration + slack

    @invariant()
    def speed_is_within_its_limit_now_and_ever_after_and_ends_at_rest(self) -> None:
        if not hasattr(self, "controller"):
            return
        ahead = self.now + np.linspace(0.0, 3.0, 31)
        speeds = np.array([self.controller.rotors.at(t) for t in ahead])
        assert np.all(np.abs(speeds) <= ROBOT.max_rotor_speed)
        # A late plan may lie 10 s ahead, each is at most 2.4 s long, and so is the ramp 0.25 s.
        end = self.controller.rotors.at(self.now + 20.0)
        np.testing.assert_allclose(end, 0.0, atol=1e-4)


TestEvents = Events.TestCase
TestEvents.settings = settings(max_examples=25, stateful_step_count=25)

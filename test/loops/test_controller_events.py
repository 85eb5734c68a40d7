# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""No sequence of events makes the control loop raise or exceed a limit."""

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import as_state
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus

ROBOT = RobotParameters()
REST = as_state([0, 0, 1, 0, 0, 0])
AWAY = as_state([2.0, -3.0, 0.03, 0.454, 0.88, 0.1363])


class Erratic:
    """Strategy that returns the given knots, an invalid plan, or raises."""

    def __init__(self) -> None:
        self.behaviour = "sound"
        self.knots: list[tuple[float, float, float]] = []

    def plan(self, situation: Situation) -> Plan:
        if self.behaviour == "raises":
            raise RuntimeError("erratic")
        times = situation.time + np.cumsum([0.0, *(gap for gap, _, _ in self.knots)])
        speeds = np.vstack((situation.input_in_force, [[a, b] for _, a, b in self.knots]))
        states = np.tile(situation.state, (times.size, 1))
        if self.behaviour == "nan":
            states[-1, 0] = np.nan
        # A plan for another time is invalid too.
        shift = {"early": -10.0, "late": 10.0}.get(self.behaviour, 0.0)
        return Plan(PlanStatus.SOLVED, FirstOrderHold(times + shift, speeds), states)

    def change(self, settings: ControllerSettings) -> None:
        pass

    def reset(self) -> None:
        pass


knots = st.lists(
    st.tuples(st.floats(0.01, 0.6), st.floats(-500.0, 500.0), st.floats(-500.0, 500.0)),
    min_size=1, max_size=4,
)


class Events(RuleBasedStateMachine):
    """Time passes between events; the commands are checked after each of them."""

    @initialize(start=st.sampled_from([0.0, 50.0, 1.7e9]))
    def set_up(self, start: float) -> None:
        self.strategy = Erratic()
        self.controller = Controller(ControllerSettings(), ROBOT, self.strategy)
        self.now = start

    @rule(length=st.floats(0.0, 1.5))
    def wait(self, length: float) -> None:
        self.now += length

    @rule(age=st.floats(-1.0, 1.0), state=st.sampled_from([REST, AWAY]))
    def pose(self, age: float, state: np.ndarray) -> None:
        self.controller.observe(self.now - age, state)

    @rule(bad=st.sampled_from([np.nan, np.inf, 0.0, 3.0]))
    def bad_pose(self, bad: float) -> None:
        try:
            self.controller.observe(self.now, np.full(6, bad))
        except InvalidStateError:
            return
        raise AssertionError("accepted")

    @rule(goal=st.sampled_from([REST, AWAY]))
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

    @rule(
        behaviour=st.sampled_from(["sound", "sound", "raises", "nan", "early", "late"]),
        knots=knots,
    )
    def change_behaviour(self, behaviour: str, knots: list[tuple[float, float, float]]) -> None:
        self.strategy.behaviour, self.strategy.knots = behaviour, knots

    @rule(delay=st.floats(0.0, 0.8), knots=knots)
    def sample(self, delay: float, knots: list[tuple[float, float, float]]) -> None:
        self.strategy.knots = knots
        decision = self.controller.decide(self.now)
        self.now += delay
        past = self.now - np.linspace(0.001, 1.0, 20)
        before = [self.controller.speeds_at(t) for t in past]
        in_force = self.controller.speeds_at(self.now)
        hold = self.controller.commit(decision, self.now)
        np.testing.assert_array_equal([self.controller.speeds_at(t) for t in past], before)
        # Rounding of times on a wall clock, 2.4e-7 s, at 400 rad/s^2.
        np.testing.assert_allclose(self.controller.speeds_at(self.now), in_force, atol=2e-4)
        if hold is not None:
            slopes = np.abs(np.diff(hold.speeds, axis=0)) / np.diff(hold.times)[:, None]
            # The end of the ramp to rest is rounded to the clock's 2.4e-7 s.
            shortest = np.min(np.diff(hold.times), initial=np.inf)
            slack = 1e-6 + ROBOT.max_rotor_acceleration * np.spacing(self.now) / shortest
            assert np.max(slopes, initial=0.0) <= ROBOT.max_rotor_acceleration + slack

    @invariant()
    def speed_is_within_its_limit_now_and_ever_after_and_ends_at_rest(self) -> None:
        if not hasattr(self, "controller"):
            return
        ahead = self.now + np.linspace(0.0, 3.0, 31)
        speeds = np.array([self.controller.speeds_at(t) for t in ahead])
        assert np.all(np.abs(speeds) <= ROBOT.max_rotor_speed)
        # A late plan may lie 10 s ahead, each is at most 2.4 s long, and so is the ramp 0.25 s.
        end = self.controller.speeds_at(self.now + 20.0)
        np.testing.assert_allclose(end, 0.0, atol=1e-4)


TestEvents = Events.TestCase
TestEvents.settings = settings(max_examples=25, stateful_step_count=25)

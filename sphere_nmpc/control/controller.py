# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The control loop without its transport: poses and goals in, first-order holds out."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sphere_nmpc.control.arrival import Arrival
from sphere_nmpc.control.decision import Decision, Mode
from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.estimation.belief import Belief, PoseNoise
from sphere_nmpc.estimation.plant_estimator import PlantEstimator
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.state_estimator import StateEstimator
from sphere_nmpc.estimation.unknowns import LONGEST_LAG
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import (
    INPUT_SIZE,
    Vector,
    angle_error,
    as_state,
    position_error,
    state_error,
)
from sphere_nmpc.model.torque import within_torque
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation, Strategy
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.registry import make_strategy

_LEAST_POSE_NOISE = 1e-6
"""Noise [m, rad] that a pose has at the least once the other of the two is noisy."""
_SHORTEST_TRANSITION, _LONGEST_TRANSITION = 0.2, 2.0
"""Spacing of the poses that are learnt from [s]; predictions over longer gaps are poor."""


class Controller:
    """Decide at each sample instant which rotor speeds to send; never raises while running.

    A plan is sent with a ramp to rest behind its last knot, so whatever is in force is safe to be
    followed to its end: if a solve fails, what is in force simply stays.

    Parameters
    ----------
    settings : ControllerSettings
        What is solved and when the controller gives up.
    robot : RobotParameters
        What is believed about the robot, and the limits of its drives.
    strategy : Strategy, optional
        Defaults to the one named in `settings`.
    aside : callable, optional
        Does work that a sample instant need not wait for, learning, when it sees fit, one piece
        after another; by default at once, so that results repeat.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        robot: RobotParameters,
        strategy: Strategy | None = None,
        aside: Callable[[Callable[[], None]], object] | None = None,
    ) -> None:
        self._settings = settings
        robot = self._robot = within_torque(robot)
        self._strategy = make_strategy(settings, robot) if strategy is None else strategy
        self._sent = SentInputs()
        self._pose: tuple[float, Vector] | None = None
        self._goal: Vector | None = None
        self._arrival = Arrival()
        self._aside = aside
        self._time_budget = float("inf")
        self.enabled = True
        """False ramps the rotors to rest and keeps them there."""
        self.estimator = PlantEstimator(robot.lumped, lag=settings.drive_lag)
        """Learns the plant's constants, its lag and its noise."""
        self._learnt_up_to: tuple[float, Vector] | None = None
        self._fusion = self._make_fusion()
        self.late_poses = 0
        """Poses dropped: older than one already known, or than what can still be fused."""
        self.failures = 0
        """Solves that failed since the start."""

    @property
    def constants(self) -> LumpedConstants:
        """What is believed about the plant: learnt, or as built where learning is off."""
        if not self._settings.learning:
            return self._robot.lumped
        return self.estimator.constants if self._fusion is None else self._fusion.constants

    @property
    def lag(self) -> float:
        """How far the motion is believed to lag behind what is sent [s]."""
        if not self._settings.learning:
            return self._settings.drive_lag
        return self.estimator.lag if self._fusion is None else self._fusion.lag

    @property
    def fusion(self) -> StateEstimator | None:
        """What fuses noisy poses; None where they are trusted exactly."""
        return self._fusion

    @property
    def at_goal(self) -> bool:
        """Whether the error has stayed within ``goal_tolerance`` for a sample period."""
        return self._arrival.reached

    @property
    def goal(self) -> Vector | None:
        """The goal in force, shape (6,), or None."""
        return None if self._goal is None else self._goal.copy()

    def set_goal(self, goal: Vector) -> bool:
        """Aim at another state, shape (6,), from the next sample instant on.

        False if it is the goal in force, which changes nothing: the plan in hand goes on.

        Raises
        ------
        InvalidStateError
            If it is not a finite state with a unit quaternion; the old goal then stays in force.
        """
        wanted = as_state(goal)
        if self._goal is not None and np.array_equal(wanted, self._goal):
            return False
        self._goal = wanted
        self._arrival.reset()
        self._strategy.reset()
        return True

    def change(self, settings: ControllerSettings) -> None:
        """Take over settings that may change while running."""
        before, self._settings = self._settings, settings
        self._strategy = make_strategy(settings, self._robot)
        if _fusion_settings(settings) != _fusion_settings(before):
            self._fusion = self._make_fusion()
            if self._fusion is not None and self._pose is not None:
                self._fusion.observe(*self._pose)

    def observe(self, time: float, state: Vector) -> bool:
        """Take a measured state, shape (6,), of control time `time` [s]; False if it is outdated.

        Where poses are noisy, one that comes out of order still counts.

        Raises
        ------
        InvalidStateError
            If it is not a finite state with a unit quaternion, or its time is not finite.
        """
        checked = as_state(state)
        if not np.isfinite(time):
            raise InvalidStateError(f"pose: given time {time}, expected a finite number [s]")
        newest = self._pose is None or time > self._pose[0]
        if newest:
            self._pose = (time, checked)
        accepted = newest if self._fusion is None else self._fusion.observe(time, checked)
        self.late_poses += int(not accepted)
        return accepted

    def forget(self) -> None:
        """Forget poses, commands and plans, as after a jump of the clock; the goal stays."""
        self._lose_sight()
        self._arrival.reset()
        self._learnt_up_to = None
        self._sent.clear()
        self._strategy.reset()

    def speeds_at(self, time: float) -> Vector:
        """Return the rotor speeds commanded for `time` [rad/s], shape (2,)."""
        return self._sent.at(time)

    def awaits_start(self, now: float) -> bool:
        """Return whether there is a goal to leave for and nothing moves at `now` [s] or later."""
        known = self._goal is not None and self._pose is not None
        return known and self.enabled and not self._sent.moves_after(now)

    def decide(self, time: float, time_budget: float = float("inf")) -> Decision:
        """Plan for the sample instant `time` [s]; follow with `commit`.

        The plan may take `time_budget` of wall time [s], and no more than the settings allow.
        """
        self._time_budget = min(time_budget, self._settings.time_budget or float("inf"))
        age = float("inf") if self._pose is None else time - self._pose[0]
        if self._pose is None:
            return self._rest(Mode.NO_POSE, time, age)
        if abs(age) > self._settings.pose_timeout:
            if age < 0.0:
                # A pose from the future would shut out all true ones until then.
                self._lose_sight()
            self._strategy.reset()
            self._arrival.reset()  # nobody knows where the sphere is
            return self._rest(Mode.BLIND, time, age)
        failed: Exception | None = None
        try:
            state, belief = self._estimate(time, *self._pose)
        except Exception as error:
            # As for plans: what is in force is safe to its end, the next pose may do better.
            state, belief, failed = self._pose[1], None, error
        if not self.enabled:
            decision = self._rest(Mode.DISABLED, time, age, state)
        elif self._goal is None:
            decision = self._rest(Mode.NO_GOAL, time, age, state)
        elif failed is not None:
            plan = self._fallback(time, state, failed)
            decision = self._decision(Mode.FALLBACK, plan, state, age)
        else:
            mode, plan = self._plan(time, state, self._goal, belief)
            decision = self._decision(mode, plan, state, age)
        decision = self._judge_arrival(time, decision)
        return decision if belief is None else replace(decision, covariance=belief.covariance)

    def _judge_arrival(self, time: float, decision: Decision) -> Decision:
        """Return the decision with the mode that tells an arrival."""
        settings = self._settings
        reached = self._arrival.update(
            time, decision.error, settings.goal_tolerance, settings.period
        )
        arrived = reached and decision.mode is Mode.TRACKING
        return replace(decision, mode=Mode.AT_GOAL) if arrived else decision

    def commit(self, decision: Decision, now: float) -> FirstOrderHold | None:
        """Return what to send at `now` [s] and count it as sent; None where nothing need be sent.

        The hold starts at `now` from the speeds in force, so a late solve bends no past, keeps
        every limit, and ends at rest.
        """
        if self._sent.newest is not None:
            # Dated a little ahead of a clock that is late, it is in force all the same.
            now = max(now, self._sent.newest.start)
        limits = (self._robot.max_rotor_speed, self._robot.max_rotor_acceleration)
        hold = self._sent.leading_to(decision.plan.hold, now).limited(*limits)
        hold = hold.ending_at_rest(self._robot.max_rotor_acceleration)
        planned = decision.solved or decision.mode is Mode.FALLBACK
        if not planned and not hold.speeds.any() and not self._sent.moves_after(now):
            return None
        self._sent.record(hold)
        return hold

    def _estimate(
        self, time: float, measured: float, pose: Vector
    ) -> tuple[Vector, Belief | None]:
        """Return the state at `time` [s], from the newest pose or from all that were fused."""
        belief = None if self._fusion is None else self._fusion.predict(time)
        if belief is not None:
            return belief.state, belief
        self._learn(measured, pose)
        # What was sent up to the lag before a pose has moved the robot by then: seen from its
        # inputs the pose is that much older.
        state = self._sent.predict(
            pose, measured - self.lag, time, self.constants.as_array(),
            self._settings.integration_step,
        )
        return state, None

    def _learn(self, time: float, state: Vector) -> None:
        """Show the estimator what the robot did since the last pose it was shown."""
        last = self._learnt_up_to
        if last is not None and time - last[0] < _SHORTEST_TRANSITION:
            return
        self._learnt_up_to = (time, state)
        if last is not None and time - last[0] <= _LONGEST_TRANSITION:
            sent, (since, before) = self._sent.copy(), last

            def lesson() -> None:
                pieces = sent.pieces(since - LONGEST_LAG, time)
                self.estimator.observe(before, state, *pieces, lead=LONGEST_LAG)

            if self._aside is None:
                lesson()
            else:
                self._aside(lesson)

    def _lose_sight(self) -> None:
        self._pose = None
        if self._fusion is not None:
            self._fusion.forget()

    def _make_fusion(self) -> StateEstimator | None:
        settings = self._settings
        noise = (settings.pose_position_noise, settings.pose_orientation_noise)
        if not any(noise):
            return None
        return StateEstimator(
            self._sent, self._robot.lumped, PoseNoise(*np.maximum(noise, _LEAST_POSE_NOISE)),
            settings.drive_lag, settings.learning,
        )

    def _plan(
        self, time: float, state: Vector, goal: Vector, belief: Belief | None
    ) -> tuple[Mode, Plan]:
        noise, uncertainty = self.estimator.noise, 0.0
        if belief is not None:
            noise, uncertainty = belief.disturbance(self._settings.period), belief.uncertainty
        situation = Situation(
            time, state, goal, self._sent.at(time), self.constants, noise, uncertainty,
            self._time_budget,
        )
        try:
            plan = self._strategy.plan(situation)
            if np.isfinite(plan.states).all():
                return Mode.TRACKING, plan
            raise ArithmeticError("the predicted states are not finite")
        except Exception as error:
            # Whatever went wrong in there must not take the loop down.
            return Mode.FALLBACK, self._fallback(time, state, error)

    def _fallback(self, time: float, state: Vector, error: Exception) -> Plan:
        self.failures += 1
        self._strategy.reset()
        newest = self._sent.newest
        hold = FirstOrderHold.constant(time, np.zeros(INPUT_SIZE)) if newest is None else newest
        return Plan(
            PlanStatus.FALLBACK, hold.starting_at(time, self._sent.at(time)),
            state[None, :], message=f"{type(error).__name__}: {error}",
        )

    def _rest(
        self, mode: Mode, time: float, age: float, state: Vector | None = None
    ) -> Decision:
        acceleration = self._robot.max_rotor_acceleration
        hold = FirstOrderHold.ramp_to_rest(time, self._sent.at(time), acceleration)
        states = np.empty((0, 6)) if state is None else state[None, :]
        plan = Plan(PlanStatus.RAMP_TO_REST, hold, states, message=mode.value)
        return self._decision(mode, plan, state, age)

    def _decision(
        self, mode: Mode, plan: Plan, state: Vector | None, age: float
    ) -> Decision:
        goal = self._goal
        if state is None or goal is None:
            return Decision(mode, plan, state, pose_age=age)
        return Decision(
            mode, plan, state, state_error(state, goal), position_error(state, goal),
            angle_error(state, goal), age,
        )


def _fusion_settings(settings: ControllerSettings) -> tuple[float, float, float, bool]:
    return (
        settings.pose_position_noise, settings.pose_orientation_noise, settings.drive_lag,
        settings.learning,
    )

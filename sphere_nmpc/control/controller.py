# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Control loop without its transport: poses and goals in, first-order holds out."""


import numpy as np
from numpy.typing import ArrayLike

from sphere_nmpc.control.active_course import ActiveCourse
from sphere_nmpc.control.course_following import CourseFollowing
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.keeping_clear import clear_plan, kept_on_floor, stop_if_refused
from sphere_nmpc.control.link import Link
from sphere_nmpc.control.planner import Planner
from sphere_nmpc.control.pose_stream import PoseGate
from sphere_nmpc.control.sending import REACH, Commands
from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.estimation.estimator import Estimator
from sphere_nmpc.estimation.pose_filter import Estimate
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.disturbance import UNDISTURBED
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import STANDING, Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    MOMENTUM,
    Vector,
    as_state,
    without_momentum,
)
from sphere_nmpc.model.torque import within_torque
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.native.library import library
from sphere_nmpc.strategy.contract import Situation, Strategy
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.worker.contract import Worker

_OVERSPEED = 2.0
"""Largest measured rotor speed that is possible, over the largest one that is commanded [-]."""


class Controller:
    """Control loop of estimation, planning and commands; it never raises while running.

    A plan is kept while nothing is new, see `InForce`. Each command ends at rest, so that the
    hold in force can safely be followed to its end: if an estimate or a solve fails, it stays in
    force. Without a goal, a pose or permission the sphere
    stops on the path of that hold; with momentum the rotors stop, and the sphere rolls on.

    Parameters
    ----------
    settings : ControllerSettings, optional
        Strategy, estimation, and limits such as the age of a pose.
    robot : RobotParameters, optional
        Robot as built, and the limits of its drives; defaults to that of Table 1.
    strategy : Strategy, optional
        Defaults to the one named in `settings`.
    worker : Worker, optional
        Searches for plans and learns the plant beside the control loop, which then only follows;
        by default both are done in line, so that results repeat.
    """

    def __init__(
        self, settings: ControllerSettings | None = None, robot: RobotParameters | None = None,
        strategy: Strategy | None = None, worker: Worker | None = None,
    ) -> None:
        library()  # it is loaded, or its absence reported, here and not at the first instant
        robot = robot or RobotParameters()
        self._settings = settings = (settings or ControllerSettings()).of(robot)
        robot = self._robot = within_torque(robot)
        self.failures = 0
        """Errors since the start in the processing of poses, estimates, plans and commands."""
        self.last_failure = ""
        """Message of the newest of these errors."""
        self.planner = Planner(settings, robot, self._record, strategy, worker)
        """The strategy in use, and the plan in force."""
        self.commands = Commands(robot, self._record)
        """The commands sent."""
        self.rotors = self.commands.rotors
        """History of the commands, as measured rotor speeds correct them."""
        self.link = Link(self.rotors)
        """Delay and loss of commands and poses on their way."""
        self.estimator = Estimator(
            settings, robot.lumped, self.rotors, worker, robot.max_rotor_acceleration
        )
        """The estimator of the state and of the plant's parameters in use."""
        self._floor = Floor.EMPTY
        self.following = CourseFollowing(robot, self.planner, self.estimator)
        """The course in force, and how far it is followed."""
        self._interrupted = False
        """Whether no pose was fresh enough at the last sampling instant with a pose."""
        self._enabled = True
        self.late_poses = 0
        """Poses dropped: not newer than the newest, or too old to be fused."""
        self._is_carried = False
        """Whether the pose has jumped and the rotors have not been stopped since."""
        self.pose_gate = PoseGate(robot)
        """Outliers and jumps of the poses."""
        self.plans = 0
        """Motions planned since the start that are not what is left of the one before."""
        self._followed = 0

    @property
    def period(self) -> float:
        """Time between two sampling instants [s]."""
        return self._settings.control_period

    @property
    def enabled(self) -> bool:
        """Whether the goal is tracked; without, the sphere stops on its path and stays there."""
        return self._enabled

    @enabled.setter
    def enabled(self, enabled: bool) -> None:
        if enabled and not self._enabled:
            # The plan leads on from where the sphere was without the stop.
            self.following.begin_anew()
        self._enabled = enabled

    @property
    def floor(self) -> Floor:
        """What the sphere has to stay clear of; set to None it is `Floor.EMPTY`."""
        return self._floor

    @floor.setter
    def floor(self, floor: Floor | None) -> None:
        self._floor = floor or Floor.EMPTY

    @property
    def faults(self) -> tuple[Condition, ...]:
        """Present faults of what the controller was given: rotor speeds, and the robot."""
        found = self.rotors.condition, self.estimator.condition
        return tuple(one for one in found if one is not None)

    @property
    def at_goal(self) -> bool:
        """Whether the error has been within tolerance for a sample period, at the last goal."""
        return self.following.arrival.reached

    @property
    def active(self) -> ActiveCourse | None:
        """The course in force, or None."""
        return self.following.course.active

    @property
    def goal(self) -> Vector | None:
        """Pose of the goal that is aimed at, shape (6,), or None."""
        active = self.following.course.active
        return None if active is None else active.goal.pose.copy()

    def set_goal(self, goal: ArrayLike | Goal | Course) -> bool:
        """Track one goal, or a goal state, shape (6,), with all of its orientation, or a course.

        Raises
        ------
        InvalidStateError
            If it is not a finite state with a unit quaternion; the old goal then stays in force.
        """
        course = goal if isinstance(goal, Course) else Course.of(goal)
        return self.following.take(ActiveCourse(course))

    def cancel(self) -> bool:
        """Give up the goals, so that the sphere stops on its path; False if there was none."""
        if not self.following.course.clear():
            return False
        self.following.begin_anew()
        return True

    def prepare(self, settings: ControllerSettings) -> None:
        """Make the strategy of settings that `change` is given next, where it is another one.

        `InvalidParameterError` is raised if it cannot be made.
        """
        self.planner.prepare(settings.of(self._robot))

    def change(self, settings: ControllerSettings) -> None:
        """Take over settings that may change while running.

        The plan is kept unless the strategy or the sample period changes, and so are the
        estimates that the change does not concern. `InvalidParameterError` is raised, and nothing
        changes, if there is another strategy and it cannot be made.
        """
        settings = settings.of(self._robot)
        self.planner.change(settings)
        self._settings = settings
        self.estimator.change(settings)

    def observe(self, time: float, state: Vector) -> bool:
        """Take a measured state, shape (6,), of control time `time` [s]; False if it is outdated.

        Where poses are noisy, one that arrives out of order is still used.

        Raises
        ------
        InvalidStateError
            If it is not a finite state with a unit quaternion, or its time is not finite.
        """
        checked = as_state(state)
        if not np.isfinite(time):
            raise InvalidStateError("time of the pose", time, "a finite number [s]")
        try:
            if self._is_held_back(time, checked):
                return True
            accepted = self.estimator.observe(time, checked)
        except Exception as error:
            # As in `decide`; without further poses the sphere is stopped.
            self._record(error)
            return False
        self.late_poses += int(not accepted)
        return accepted

    def _is_held_back(self, time: float, state: Vector) -> bool:
        """Return whether a pose has to wait for the next one; see `PoseGate`.

        Where the sphere has been carried, all begins anew. What the rotors do then is not known: a
        simulator that is reset stops them. So nothing is learnt until they have been stopped.
        """
        newest = self.estimator.newest
        found = None
        if newest is not None and time > newest[0] + REACH:
            # All commands have ended; a prediction over hours would take seconds.
            self.estimator.forget()
        elif newest is None or time > newest[0]:
            found = self.pose_gate.check(time, state, newest, self._settings)
        if found is Kind.POSE_JUMPED:
            self._is_carried = True
            self.following.begin_anew()
        if self._is_carried:
            self.estimator.forget()
        return found is Kind.POSE_LEFT_OUT

    def observe_rotors(self, time: float, speeds: Vector) -> None:
        """Take rotor speeds [rad/s], shape (2,), measured at control time `time` [s].

        Speeds that the drives cannot have are ignored.
        """
        if not (np.abs(speeds) <= _OVERSPEED * self._robot.max_rotor_speed).all():
            return
        try:
            # A negative one is of stamps alone.
            self.rotors.observe(time, speeds, max(0.0, self.estimator.plant.lag))
        except Exception as error:
            # As in `decide`; without measured speeds commands count as followed as they were sent.
            self._record(error)
            self.rotors.reset()

    def forget(self) -> None:
        """Discard poses, commands and plans, as after a jump of the clock; the goal stays."""
        self.estimator.forget()
        self.rotors.clear()
        self.following.begin_anew()

    def is_at_rest(self, now: float) -> bool:
        """Return whether no rotor moves at `now` [s] or later by the commands sent."""
        return not self.rotors.moves_after(now)

    def awaits_start(self, now: float) -> bool:
        """Return whether pose and goal are known and nothing moves at `now` [s] or later."""
        known = self.following.course.active is not None and self.estimator.newest is not None
        return known and self.enabled and self.is_at_rest(now)

    def decide(self, time: float, time_budget: float = float("inf")) -> Decision:
        """Plan for the sampling instant `time` [s]; to be followed by `commit`.

        The plan may take `time_budget` of wall time [s], and no more than the settings allow.
        """
        try:
            return self._decide(time, min(time_budget, self._settings.time_budget or float("inf")))
        except Exception as error:
            # An error anywhere must not stop the loop; the hold in force is safe to its end.
            plan = self._fallback(time, None, error)
            if self.enabled:
                return Decision(Kind.FALLBACK.conditions, plan, None)
            stopped = self.commands.stop(time, Kind.DISABLED)
            return Decision(Kind.DISABLED.conditions, stopped, None)

    def commit(self, decision: Decision, now: float) -> FirstOrderHold | None:
        """Return the hold to send at `now` [s] and record it as sent; None if there is none.

        The hold starts at `now` from the speeds in force, so that a late solve does not change
        the past; it keeps every limit and ends at rest.
        """
        send = self.commands.send
        try:
            return send(decision, decision.plan.hold, now, self.planner, self._settings)
        except Exception as error:
            # As in `decide`.
            self._record(error)
        try:
            hold = self.commands.in_force(now)
            return send(decision, hold, now, self.planner, self._settings)
        except Exception as error:
            # Without a further command the hold in force is followed to its end.
            self._record(error)
            return None

    def _decide(self, time: float, time_budget: float) -> Decision:
        planner = self.planner
        before, planner.in_force = planner.in_force, None
        newest = self.estimator.newest
        if newest is None:
            return self._without_pose(time, Kind.NO_POSE, float("inf"))
        age = time - newest[0]
        if abs(age) > self._settings.pose_timeout:
            if age < 0.0:
                # A pose from the future would make all valid ones outdated until then.
                self.estimator.forget()
            if not self._interrupted:
                # Once: a strategy may take as long to reset as to set up.
                self._interrupted = True
                self.following.begin_anew()
                self.rotors.resume()
            return self._without_pose(time, Kind.NO_FRESH_POSE, age)
        self._interrupted = False
        self._is_carried = self._is_carried and self.rotors.moves_after(time)
        if self._is_carried:
            jumped = Condition(Kind.POSE_JUMPED, self.pose_gate.last_jump)
            return Decision((jumped,), self.commands.stop(time, jumped.kind), None, pose_age=age)
        active, estimate = self.following.course.active, None
        if active is not None and active.goal.rate is not STANDING:
            active = self.following.course.at(time)
        failure: Exception = ArithmeticError("no estimate")
        try:
            estimate = self.estimator.estimate(time)
        except Exception as error:
            failure = error
        if estimate is None:
            state, covariance, disturbance = without_momentum(newest[1]), None, UNDISTURBED
        else:
            state, covariance = estimate.state, estimate.covariance
            disturbance = estimate.disturbance
        if active is not None and not active.is_last and estimate is not None and self._enabled:
            active = self.following.on_its_leg(time, state, before, self._settings)
        if before is not None and before.situation.floor is not self._floor and estimate:
            before = kept_on_floor(before, time, estimate, self._floor, self._robot)
        goal = None if active is None else active.goal.nearest(state, time)
        if active is None or goal is None or not self._enabled:
            mode = Kind.NO_GOAL if self._enabled else Kind.DISABLED
            found, plan = mode.conditions, self.commands.stop(time, mode, state)
        elif estimate is None:
            found, plan = Kind.FALLBACK.conditions, self._fallback(time, state, failure)
        elif before is not None and before.stands(
            time, state, estimate.uncertainty,
            (active.leg, self._floor, estimate.plant, disturbance),
        ) and not planner.is_due(time):
            planner.in_force, plan = before, before.plan
            found = before.conditions
        else:
            found, plan = self._plan(time, estimate, active, time_budget)
        decision = Decision(
            found, plan, state, goal, age, covariance, state[MOMENTUM], disturbance,
            is_new=before is None or plan is not before.plan,
        )
        return self.following.judged(
            time, decision, active, newest[1], self.rotors.at, self._settings
        )

    def _without_pose(self, time: float, mode: Kind, age: float) -> Decision:
        estimator = self.estimator
        return Decision(
            mode.conditions, self.commands.stop(time, mode), None, pose_age=age,
            momentum=estimator.momentum, disturbance=estimator.disturbance,
        )

    def _plan(
        self, time: float, estimate: Estimate, active: ActiveCourse, time_budget: float
    ) -> tuple[tuple[Condition, ...], Plan]:
        try:
            situation = Situation(
                time, estimate.state, active.course, self.commands.in_force(time),
                estimate.plant, estimate.disturbance, self._floor, active.index,
                estimate.covariance, time_budget,
            )
            refused, following = stop_if_refused(situation, self._robot), self.following
            was_refused, following.is_refused = following.is_refused, refused is not None
            if following.is_refused and not was_refused:
                self.planner.reset()  # its plan leads on from where the stop does not
            plan = refused or self.planner.plan(situation)
            plan = clear_plan(situation, plan, self._robot, self._settings.strategy)
            motion = plan.made.motion
            self.plans += int(motion not in (0, self._followed))
            self._followed = motion
            self.planner.in_force = in_force = InForce(plan, situation, self._robot)
            return in_force.conditions, plan
        except Exception as error:
            return Kind.FALLBACK.conditions, self._fallback(time, estimate.state, error)

    def _fallback(self, time: float, state: Vector | None, error: Exception) -> Plan:
        message = self._record(error)
        self.planner.reset()
        return self.commands.fallback(time, state, message, not self.floor.is_empty)

    def _record(self, error: Exception) -> str:
        """Count an error and return its message."""
        self.failures += 1
        self.last_failure = f"{type(error).__name__}: {error}"
        return self.last_failure

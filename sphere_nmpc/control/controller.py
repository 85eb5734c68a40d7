# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Control loop without its transport: poses and goals in, first-order holds out."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np

from sphere_nmpc.control.active_course import ActiveCourse, CourseInForce
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.keeping_clear import clear_command, clear_plan, stop_if_refused
from sphere_nmpc.control.link import NEGLIGIBLE, REACH, Commands, RotorFeedback
from sphere_nmpc.control.monitors import (
    ArrivalDetector,
    Progress,
    relative_error,
)
from sphere_nmpc.control.planner import Planner
from sphere_nmpc.control.pose_stream import PoseGate
from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.estimation.estimator import Estimator
from sphere_nmpc.estimation.pose_filter import Estimate
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.disturbance import UNDISTURBED
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import STANDING, Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.path import Tracking
from sphere_nmpc.model.state import (
    INPUT_SIZE,
    MOMENTUM,
    POSE,
    POSITION,
    STATE_SIZE,
    Vector,
    as_state,
    without_momentum,
)
from sphere_nmpc.model.torque import heat_and_energy, torques, within_torque
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.native.library import library
from sphere_nmpc.strategy.contract import Situation, Strategy
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling
from sphere_nmpc.worker.contract import Worker

_OVERSPEED = 2.0
"""Largest measured rotor speed that is possible, over the largest one that is commanded [-]."""
_INSTANT = 1e-3
"""Time within which a velocity is constant [s]."""


class Controller:
    """Control loop of estimation, planning and commands; it never raises while running.

    A plan is kept while nothing is new, see `InForce`. Each command ends at rest, so that the
    hold in force can safely be followed to its end: if an estimate or a solve fails, it stays in
    force. Without a goal, a pose or permission the sphere
    stops on the path of that hold; with momentum the rotors stop, and the sphere rolls on.

    Parameters
    ----------
    settings : ControllerSettings
        Strategy, estimation, and limits such as the age of a pose.
    robot : RobotParameters
        Robot as built, and the limits of its drives.
    strategy : Strategy, optional
        Defaults to the one named in `settings`.
    worker : Worker, optional
        Searches for plans and learns the plant beside the control loop, which then only follows;
        by default both are done in line, so that results repeat.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        robot: RobotParameters,
        strategy: Strategy | None = None,
        worker: Worker | None = None,
    ) -> None:
        library()  # it is loaded, or its absence told, here and not at the first instant
        self._settings = settings = settings.of(robot)
        robot = self._robot = within_torque(robot)
        self.failures = 0
        """Errors since the start in the processing of poses, estimates, plans and commands."""
        self.last_failure = ""
        """Message of the newest of these errors."""
        self._planner = Planner(settings, robot, self._record, strategy, worker)
        self._commands = Commands(robot)
        self.rotor_feedback = RotorFeedback(self._commands.sent, robot.max_rotor_acceleration)
        """What measured rotor speeds tell about the commands on their way."""
        self._estimator = Estimator(
            settings, robot.lumped, self._commands.sent, worker, robot.max_rotor_acceleration
        )
        self._floor = Floor.EMPTY
        self._course = CourseInForce()
        self._arrival = ArrivalDetector()
        self._progress = Progress(robot)
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
        self._is_refused = False
        """Whether the goal was refused at the last sampling instant with a plan."""

    @property
    def enabled(self) -> bool:
        """Whether the goal is tracked; without, the sphere stops on its path and stays there."""
        return self._enabled

    @enabled.setter
    def enabled(self, enabled: bool) -> None:
        if enabled and not self._enabled:
            self._begin_anew()  # the plan leads on from where the sphere was without the stop
        self._enabled = enabled

    @property
    def floor(self) -> Floor:
        """What the sphere has to stay clear of; set to None it is `Floor.EMPTY`."""
        return self._floor

    @floor.setter
    def floor(self, floor: Floor | None) -> None:
        self._floor = floor or Floor.EMPTY

    @property
    def estimator(self) -> Estimator:
        """The estimator of the state and of the plant's parameters in use."""
        return self._estimator

    @property
    def faults(self) -> tuple[Condition, ...]:
        """Present faults of what the controller was given: rotor speeds, and the robot."""
        found = self.rotor_feedback.condition, self._estimator.condition
        return tuple(one for one in found if one is not None)

    @property
    def at_goal(self) -> bool:
        """Whether the error has been within tolerance for a sample period, at the last goal."""
        return self._arrival.reached

    @property
    def arrival_took(self) -> float:
        """Time that the newest arrival at the goal has taken [s]."""
        return self._arrival.took

    @property
    def active(self) -> ActiveCourse | None:
        """The course in force, or None."""
        return self._course.active

    @property
    def goal(self) -> Vector | None:
        """Pose of the goal that is aimed at, shape (6,), or None."""
        active = self._course.active
        return None if active is None else active.goal.pose.copy()

    def goal_speed(self, time: float) -> float:
        """Return the speed at which the goal is expected to move at `time` on [m/s]."""
        active = self._course.at(time)
        return 0.0 if active is None else float(np.linalg.norm(active.goal.rate[POSITION]))

    def tracking(self) -> Tracking | None:
        """Return how the path is followed, by the newest pose; None where none is."""
        active = self._course.active
        path = None if active is None else active.leg.follows
        newest = None if path is None else self._estimator.newest
        if path is None or newest is None:
            return None
        way, place = self._planner.paths.way, newest[1][POSITION]
        x, y, direction, _ = path.at(way).tolist()
        along, left = math.cos(direction), math.sin(direction)
        speed = turned = math.nan
        in_force = self._planner.in_force
        if in_force is not None:
            since = max(newest[0], in_force.plan.hold.start)
            first, second = (in_force.at(since + step)[POSITION] for step in (0.0, _INSTANT))
            moved = (second - first) / _INSTANT
            speed = math.hypot(*moved)
            turned = math.remainder(math.atan2(moved[1], moved[0]) - direction, math.tau)
        return Tracking(
            way, path.length - way, along * (place[1] - y) - left * (place[0] - x), turned, speed
        )

    def remaining(self, time_left: float, way_left: float) -> tuple[float, float]:
        """Return time [s] and way [m] to the last of the goals; nan without goal or pose.

        To the goal that is aimed at they are those of the plan, where they are known, that is not
        nan; otherwise, and from goal to goal, those of rolling straight from rest to rest.
        """
        active, newest = self._course.active, self._estimator.newest
        if active is None or newest is None:
            return math.nan, math.nan
        rolling = SteadyRolling.of(
            self._estimator.plant.constants, self._robot.max_rotor_speed
        )
        ahead = (leg.goal.pose[POSITION] for leg in active.course.legs[active.index :])
        places = np.array([newest[1][POSITION], *ahead])
        ways: list[float] = np.linalg.norm(np.diff(places, axis=0), axis=1).tolist()
        if not math.isnan(way_left):
            ways[0] = way_left
        times = [rolling.duration(way) for way in ways]
        if way_left == 0.0 or not math.isnan(time_left):  # at rest at the goal, or planned
            times[0] = 0.0 if math.isnan(time_left) else time_left
        return sum(times), sum(ways)

    def set_goal(self, goal: Vector | Goal | Course) -> bool:
        """Track one goal, or a goal state, shape (6,), with all of its orientation, or a course.

        Raises
        ------
        InvalidStateError
            If it is not a finite state with a unit quaternion; the old goal then stays in force.
        """
        if not isinstance(goal, Course):
            goal = Course.of(goal if isinstance(goal, Goal) else Goal(as_state(goal)))
        return self.follow(ActiveCourse(goal))

    def follow(self, course: ActiveCourse, time: float | None = None) -> bool:
        """Follow another course, from the next sampling instant on.

        False if it is the one in force, see `CourseInForce.take`; the present plan and its
        progress are then kept.
        """
        is_other = self._course.take(course, time, self.at_goal)
        if is_other:
            self._aim()
        return is_other

    def cancel(self) -> bool:
        """Give up the goals, so that the sphere stops on its path; False if there was none."""
        if not self._course.clear():
            return False
        self._begin_anew()
        return True

    def _aim(self) -> None:
        """Aim at another goal."""
        self._arrival = ArrivalDetector()
        self._progress.reset()
        if not self._planner.compares_goals:
            self._planner.reset()

    def prepare(self, settings: ControllerSettings) -> None:
        """Make the strategy of settings that `change` is given next, where it is another one.

        `InvalidParameterError` is raised if it cannot be made.
        """
        self._planner.prepare(settings.of(self._robot))

    def change(self, settings: ControllerSettings) -> None:
        """Take over settings that may change while running.

        The plan is kept unless the strategy or the sample period changes, and so are the
        estimates that the change does not concern. `InvalidParameterError` is raised, and nothing
        changes, if there is another strategy and it cannot be made.
        """
        settings = settings.of(self._robot)
        self._planner.change(settings)
        self._settings = settings
        self._estimator.change(settings)

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
            accepted = self._estimator.observe(time, checked)
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
        newest = self._estimator.newest
        found = None
        if newest is not None and time > newest[0] + REACH:
            # All commands have ended; a prediction over hours would take seconds.
            self._estimator.forget()
        elif newest is None or time > newest[0]:
            found = self.pose_gate.check(time, state, newest, self._settings)
        if found is Kind.POSE_JUMPED:
            self._is_carried = True
            self._begin_anew()
        if self._is_carried:
            self._estimator.forget()
        return found is Kind.POSE_LEFT_OUT

    def observe_rotors(self, time: float, speeds: Vector) -> None:
        """Take rotor speeds [rad/s], shape (2,), measured at control time `time` [s].

        Speeds that the drives cannot have are ignored.
        """
        if not (np.abs(speeds) <= _OVERSPEED * self._robot.max_rotor_speed).all():
            return
        try:
            # A negative one is of stamps alone.
            self.rotor_feedback.observe(time, speeds, max(0.0, self._estimator.plant.lag))
        except Exception as error:
            # As in `decide`; without measured speeds commands count as followed as they were sent.
            self._record(error)
            self.rotor_feedback.reset()

    def forget(self) -> None:
        """Discard poses, commands and plans, as after a jump of the clock; the goal stays."""
        self._estimator.forget()
        self._commands.sent.clear()
        self.rotor_feedback.reset()
        self._begin_anew()

    def speeds_at(self, time: float) -> Vector:
        """Return the rotor speeds commanded for `time` [rad/s], shape (2,)."""
        return self._commands.sent.at(time)

    def motor_effort(self, start: float, end: float, pose: Vector) -> Vector:
        """Return what the commands from `start` to `end` [s] took, see `heat_and_energy`.

        It is that at a pose, shape (6,): in half a second the sphere turns by so little that this
        changes the heat by 1 %.
        """
        durations, speeds = self._commands.sent.pieces(start, end)
        states = np.tile(pose, (durations.size + 1, 1))
        hold = FirstOrderHold(np.append(0.0, np.cumsum(durations)), speeds)
        inertia = self._robot.rotor_axial_inertia
        each = torques(states, hold, self._estimator.plant.constants, inertia)
        return heat_and_energy(durations, speeds, *each)

    def is_at_rest(self, now: float) -> bool:
        """Return whether no rotor moves at `now` [s] or later by the commands sent."""
        return not self._commands.sent.moves_after(now)

    def awaits_start(self, now: float) -> bool:
        """Return whether pose and goal are known and nothing moves at `now` [s] or later."""
        known = self._course.active is not None and self._estimator.newest is not None
        return known and self.enabled and self.is_at_rest(now)

    @property
    def searches(self) -> bool:
        """Whether a plan is being searched for beside the loop; `is_due` tells when to use it."""
        return self._planner.searches

    def is_due(self, now: float) -> bool:
        """Return whether there is a plan that begins at `now` [s] or before, to be decided on."""
        return self._planner.is_due(now)

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
                return Decision(Kind.FALLBACK.alone, plan, None)
            return Decision(Kind.DISABLED.alone, self._stop(time, Kind.DISABLED), None)

    def commit(self, decision: Decision, now: float) -> FirstOrderHold | None:
        """Return the hold to send at `now` [s] and record it as sent; None if there is none.

        The hold starts at `now` from the speeds in force, so that a late solve does not change
        the past; it keeps every limit and ends at rest.
        """
        try:
            return self._send(decision, decision.plan.hold, now)
        except Exception as error:
            # As in `decide`.
            self._record(error)
        try:
            return self._send(decision, self._commands.in_force(now), now)
        except Exception as error:
            # Without a further command the hold in force is followed to its end.
            self._record(error)
            return None

    def _send(self, decision: Decision, hold: FirstOrderHold, now: float) -> FirstOrderHold | None:
        """Return what to send at `now` [s] for the plan `hold` of a decision; see `commit`."""
        commands = self._commands
        start = commands.earliest(now)
        sent = commands.rest_of(hold, start)
        if sent is None:
            period, planned = self._settings.control_period, self._planner.in_force
            late = start - decision.plan.hold.start > NEGLIGIBLE * self._settings.units.time
            if late and planned is not None and planned.is_certified:
                sent = clear_command(
                    planned.situation, hold, commands, start, period, self._robot
                )
                self._planner.in_force = None  # it is not what is followed
            else:
                sent = commands.joined(hold, start, period)
            stops = not decision.solved and decision.mode is not Kind.FALLBACK
            if stops and not sent.speeds.any() and not commands.sent.moves_after(start):
                return None
            commands.begin(hold, sent, stops)
        self.rotor_feedback.sent(sent)
        commands.record(sent)
        return sent

    def _decide(self, time: float, time_budget: float) -> Decision:
        planner = self._planner
        before, planner.in_force = planner.in_force, None
        newest = self._estimator.newest
        if newest is None:
            return self._without_pose(time, Kind.NO_POSE, float("inf"))
        age = time - newest[0]
        if abs(age) > self._settings.pose_timeout:
            if age < 0.0:
                # A pose from the future would make all valid ones outdated until then.
                self._estimator.forget()
            if not self._interrupted:
                # Once: a strategy may take as long to reset as to set up.
                self._interrupted = True
                self._begin_anew()
                self.rotor_feedback.resume()
            return self._without_pose(time, Kind.NO_FRESH_POSE, age)
        self._interrupted = False
        self._is_carried = self._is_carried and self._commands.sent.moves_after(time)
        if self._is_carried:
            jumped = Condition(Kind.POSE_JUMPED, self.pose_gate.last_jump)
            return Decision((jumped,), self._stop(time, jumped.kind), None, pose_age=age)
        active, estimate = self._course.active, None
        if active is not None and active.goal.rate is not STANDING:
            active = self._course.at(time)
        failure: Exception = ArithmeticError("no estimate")
        try:
            estimate = self._estimator.estimate(time)
        except Exception as error:
            failure = error
        if estimate is None:
            state, covariance, disturbance = without_momentum(newest[1]), None, UNDISTURBED
        else:
            state, covariance = estimate.state, estimate.covariance
            disturbance = estimate.disturbance
        if active is not None and not active.is_last and estimate is not None and self._enabled:
            active = self._on_its_leg(time, active, estimate, before)
        goal = None if active is None else active.goal.nearest(state, time)
        if active is None or goal is None or not self._enabled:
            mode = Kind.NO_GOAL if self._enabled else Kind.DISABLED
            found, plan = mode.alone, self._stop(time, mode, state)
        elif estimate is None:
            found, plan = Kind.FALLBACK.alone, self._fallback(time, state, failure)
        elif before is not None and before.stands(
            time, state, estimate.uncertainty,
            (active.leg, self._floor, estimate.plant, disturbance),
        ) and not planner.is_due(time):
            planner.in_force, plan = before, before.plan
            found = _mode_of(plan)
        else:
            found, plan = self._plan(time, estimate, active, time_budget)
        decision = Decision(
            found, plan, state, goal, age, covariance, state[MOMENTUM], disturbance,
            is_new=before is None or plan is not before.plan,
        )
        settings = self._settings
        away = relative_error(decision.state, goal, settings)
        if (self._is_refused and decision.solved) or (active and not active.is_last):
            away = float("nan")  # a goal that is refused is not reached, wherever the sphere is
        elif active is not None and active.leg.follows and not self._has_followed(active, time):
            away = float("nan")
        reached = self._arrival.update(time, away, settings.period)
        arrived = reached and found is Kind.TRACKING.alone
        if goal is None or arrived or not decision.solved:
            self._progress.reset()
            return replace(decision, conditions=Kind.AT_GOAL.alone) if arrived else decision
        missing = self._progress.update(
            time, newest[1], goal, self.speeds_at, decision, settings
        )
        if missing is None:
            return decision
        # First, as one that stands does not roll with saturated rotors.
        return replace(decision, conditions=(missing, *found))

    def _on_its_leg(
        self, time: float, active: ActiveCourse, estimate: Estimate, before: InForce | None
    ) -> ActiveCourse:
        """Return the course with the leg that is followed from now on.

        A goal with others after it is reached where the sphere is within the tolerance, or has
        passed it since the last instant: where it is then is compared with what is planned.
        """
        state, settings, goal = estimate.state, self._settings, active.goal
        while not (active.is_last or self._is_refused):
            away = relative_error(state, goal.nearest(state, time), settings)
            if active.leg.follows and not self._has_followed(active, time):
                break
            if not away < 1.0:
                if before is None or not before.has_passed(active.course, active.index, time):
                    break
                if not relative_error(state, before.at(time)[POSE], settings) < 1.0:
                    break
            self._course.advance()
            self._aim()
            active = cast(ActiveCourse, self._course.at(time))
            goal, before = active.goal, None
        return active

    def _has_followed(self, active: ActiveCourse, time: float) -> bool:
        """Return whether the sphere is beyond the path of a leg, by whose end it may lead."""
        return self._planner.paths.has_followed(active.course, active.index, time)

    def _without_pose(self, time: float, mode: Kind, age: float) -> Decision:
        estimator = self._estimator
        return Decision(
            mode.alone, self._stop(time, mode), None, pose_age=age,
            momentum=estimator.momentum, disturbance=estimator.disturbance,
        )

    def _plan(
        self, time: float, estimate: Estimate, active: ActiveCourse, time_budget: float
    ) -> tuple[tuple[Condition, ...], Plan]:
        try:
            situation = Situation(
                time, estimate.state, active.course, self._commands.in_force(time),
                estimate.plant, estimate.disturbance, self._floor, active.index,
                estimate.covariance, time_budget,
            )
            refused, was_refused = stop_if_refused(situation, self._robot), self._is_refused
            self._is_refused = refused is not None
            if self._is_refused and not was_refused:
                self._planner.reset()  # its plan leads on from where the stop does not
            plan = refused or self._planner.plan(situation)
            plan = clear_plan(situation, plan, self._robot, self._settings.strategy)
            motion = plan.made.motion
            self.plans += int(motion not in (0, self._followed))
            self._followed = motion
            self._planner.in_force = InForce(plan, situation, self._robot)
            return _mode_of(plan), plan
        except Exception as error:
            return Kind.FALLBACK.alone, self._fallback(time, estimate.state, error)

    def _fallback(self, time: float, state: Vector | None, error: Exception) -> Plan:
        """Return the rest of the hold in force; on a floor, which may be another one, a stop."""
        message = self._record(error)
        self._planner.reset()
        commands = self._commands
        rest = commands.in_force if self.floor.is_empty else commands.stop
        hold = self._hold_or_rest(rest, time)
        return _unplanned(PlanStatus.FALLBACK, hold, state, message)

    def _record(self, error: Exception) -> str:
        """Count an error and return its message."""
        self.failures += 1
        self.last_failure = f"{type(error).__name__}: {error}"
        return self.last_failure

    def _stop(self, time: float, mode: Kind, state: Vector | None = None) -> Plan:
        hold = self._hold_or_rest(self._commands.stop, time)
        return _unplanned(PlanStatus.RAMP_TO_REST, hold, state, mode.value)

    def _hold_or_rest(
        self, command: Callable[[float], FirstOrderHold], time: float
    ) -> FirstOrderHold:
        """Return the command from `time` [s] on; where it fails rest, which `commit` ramps to."""
        try:
            return command(time)
        except Exception as error:
            self._record(error)
            return FirstOrderHold.constant(time, np.zeros(INPUT_SIZE))

    def _begin_anew(self) -> None:
        """Forget the plan and where the sphere was, as the poses until now lead nowhere."""
        self._arrival.reset()
        self._progress.reset()
        self._planner.reset()


def _mode_of(plan: Plan) -> tuple[Condition, ...]:
    """Return how things stand where a plan of the strategy is followed."""
    saturated = plan.status is PlanStatus.SATURATED
    return (Kind.SATURATED if saturated else Kind.TRACKING).alone


def _unplanned(
    status: PlanStatus, hold: FirstOrderHold, state: Vector | None, message: str
) -> Plan:
    """Return a plan of the loop itself."""
    states = np.empty((0, STATE_SIZE)) if state is None else state[None, :]
    return Plan(status, hold, states, conditions=(Condition(Kind.PLANNED, message),))

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""At rest with momentum: goals that can be held, and plans of a sphere that rests at its goal.

The rotors hold what is perpendicular to the body's z axis. Momentum that comes from pushes, slopes
and imbalance is horizontal, so every upright goal can be held; at another one the component along
that axis would turn the sphere. At rest on a slope or out of balance the momentum grows, so that
its rate must be perpendicular to the axis, too.

A sphere that rests out of balance gains momentum until a rotor saturates. The torque turns with
the sphere, so that an orientation at which it opposes the momentum unloads the rotors. They hold
the momentum there, too, if it is perpendicular to the body's z axis and to the imbalance; the
torque is largest where the imbalance is horizontal.

At the goal small errors are corrected by rolling. With momentum the motion depends on the
difference from the speeds that hold it as it does on the rotor speeds of a sphere without, so that
the same corrections are added. An error of the estimated momentum moves the sphere in the same
way, and is corrected at every sample. Rolling does not correct a turn about the body's z axis, but
the momentum does: its component along that axis turns the sphere, and a small tilt changes it.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    after_slope,
    in_body,
    rest_speeds,
    speeds_at_rest,
)
from sphere_nmpc.model.error_state import error_between
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    POSE,
    QUATERNION,
    Vector,
    angle_error,
    nearer_sign,
    state_error,
    without_momentum,
)
from sphere_nmpc.settings import SHORTEST_PERIOD, ControllerSettings
from sphere_nmpc.strategy.contract import SMALL_MOMENTUM, Situation
from sphere_nmpc.strategy.paper import PaperStrategy
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import come_to_rest, speeds_of_rest
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling

SATURATED = "rest: the rotors cannot hold the momentum, they stay at their limits"
"""What is given up where a rotor would have to exceed its limit."""
TOLERANCE = 0.05
"""Components along the body's z axis that are left, of the momentum [rad/s], which turns the
sphere by 1e-2 in some seconds, and of its rate [rad/s^2]."""
_MIN_REPORTED_CHANGE = 1e-2
"""Change of the orientation [rad] that is reported; one below it is half the error at which a goal
counts as reached."""
_MAX_ITERATIONS = 20
"""Cap on the iterations towards a goal that can be held."""
_STEP = 1e-6
"""Step of the difference quotients [rad]."""
_MAX_TURN = 0.5
"""Largest change of an iteration [rad]."""
_MIN_MOMENTUM = 10.0
"""Momentum [rad/s] below which its direction is no longer followed."""
_MIN_COSINE = 0.5
"""Cosine of the angle from the last direction of the momentum [-] beyond which it is no longer
followed."""
_TRACKING_KNOTS, _TRACKING_PERIOD = 6, 0.2
"""Knots of the problem that tracks a goal, and their spacing [s; for the robot of Table 1]."""
_TRACKING_WEIGHT = 1e-3
"""Weight of the squared rotor speeds over those of the largest ones [-] in that problem."""


class AtRest:
    """Goals that can be held in place of given ones, and plans of a sphere that rests at them.

    Parameters
    ----------
    settings : ControllerSettings
        Input weight and cap on iterations of the corrections.
    robot : RobotParameters
        Limits of the drives.
    tuning : TimeOptimalSettings
        When rotors are unloaded, and for how long; dead band, and weight of the corrections.
    """

    def __init__(
        self, settings: ControllerSettings, robot: RobotParameters, tuning: TimeOptimalSettings
    ) -> None:
        self._robot, self._max_speed = robot, robot.max_rotor_speed
        self._tuning = tuning
        # A turn that rolling does not correct is a stationary point, and is accepted.
        self._corrections = PaperStrategy(
            _for_corrections(settings), robot, tuning.correction_weight, np.inf
        )
        self._tracking = PaperStrategy(_for_tracking(settings), robot, 1.0, np.inf)
        self.reset()

    def change(self, settings: ControllerSettings) -> None:
        """Use other weights and another cap on iterations; the warm starts are kept."""
        self._corrections.change(_for_corrections(settings))
        self._tracking.change(_for_tracking(settings))

    def reset(self) -> None:
        """Forget the goal that unloads the rotors, and the warm starts."""
        self._unloading: Vector | None = None
        self._direction: Vector = np.zeros(3)
        self.limitation = ""
        """What is given up of the goal and why; empty where nothing is."""
        self.forget_corrections()

    def forget_corrections(self) -> None:
        """Forget the warm starts, as a rest begins."""
        self._corrections.reset()
        self._tracking.reset()

    def goal(
        self, situation: Situation, end: Callable[[Situation], Vector] | None, holding: bool,
        found_none: bool = False,
    ) -> Vector:
        """Return the pose to aim at, shape (6,): the given object where that can be held.

        Parameters
        ----------
        situation : Situation
            With the final goal.
        end : callable or None
            Returns the predicted momentum, shape (3,), at the arrival of the plan that is
            followed; None without one.
        holding : bool
            Whether the sphere rests at the goal.
        found_none : bool, optional
            Whether the last search has found no arrival; another orientation that unloads the
            rotors is then aimed at.
        """
        goal = situation.goal.pose
        self.limitation = ""
        unloading = self._unloading_near(situation, holding)
        if unloading is not None:
            self.limitation = "orientation for a while: it unloads the rotors"
            self._follow(situation.momentum if end is None else end(situation))
            self._unloading = _unloading_orientation(
                situation.disturbance.imbalance, self._direction, unloading, found_none
            )
            return np.concatenate((goal[:2], self._unloading))
        if situation.has_small_momentum:
            return goal  # what may be an error of the estimate is no reason to leave
        momentum = end(situation) if end is not None else self._expected(situation, holding)
        found = holdable_goal(goal, momentum, situation.disturbance)
        if found is not goal and situation.goal.orientation is not Orientation.ANY:
            self.limitation = changed_orientation(angle_error(found, goal))
        return found

    def _expected(self, situation: Situation, holding: bool) -> Vector:
        """Return the momentum to be expected at the arrival of a new plan, shape (3,)."""
        if holding:
            return situation.momentum
        if situation.is_out_of_balance:
            # The plan ends without momentum along the body's z axis; the torque has to be held.
            return np.zeros(3)
        way = float(np.linalg.norm(situation.goal.pose[:2] - situation.state[:2]))
        duration = SteadyRolling.of(situation.constants, self._max_speed).duration(way)
        return after_slope(situation.momentum, situation.disturbance, duration)

    def _unloading_near(self, situation: Situation, holding: bool) -> Vector | None:
        """Return the orientation, shape (4,), near which the rotors are being unloaded.

        None while they are not; unloading begins and ends here.
        """
        tuning, momentum = self._tuning, situation.momentum
        if not situation.disturbance.imbalance.any():
            self._unloading = None
        elif self._unloading is not None:
            if float(self._direction @ momentum) <= 0.0:
                self._unloading = None
        elif holding:
            quaternion = situation.goal.pose[QUATERNION]
            speeds = rest_speeds(momentum, quaternion)
            rates = rest_speeds(situation.disturbance.at_rest(quaternion), quaternion)
            nearly = tuning.unloading_share * self._max_speed
            # One that is being unloaded by the torque at the goal itself needs no manoeuvre.
            if np.any((np.abs(speeds) > nearly) & (speeds * rates > 0.0)):
                self._begin(situation, quaternion)
        return self._unloading

    def _begin(self, situation: Situation, quaternion: Vector) -> None:
        """Begin to unload the rotors unless a slope loads them faster than that unloads them."""
        level, disturbance = situation.momentum * (1.0, 1.0, 0.0), situation.disturbance
        self._direction = level / np.linalg.norm(level)
        unload = float(np.linalg.norm(disturbance.imbalance))
        if float(self._direction[:2] @ disturbance.slope) < unload:
            self._unloading = quaternion

    def _follow(self, momentum: Vector) -> None:
        """Follow the direction of the momentum that is unloaded."""
        level = momentum * (1.0, 1.0, 0.0)
        length = float(np.linalg.norm(level))
        # Near zero the direction is not defined, and the momentum then reverses along it.
        if float(level @ self._direction) > _MIN_COSINE * length and length > _MIN_MOMENTUM:
            self._direction = level / length

    def plan(self, situation: Situation) -> Plan:
        """Return a ramp to rest, a correction of what rolling corrects, or a way with the goal."""
        aimed = situation.goal
        error = state_error(situation.state, aimed.pose)
        tuning, moves = self._tuning, bool(aimed.rate.any())
        noisy = tuning.dead_band(situation.plant.noise, 0.0) > tuning.leaving_error
        small = error <= tuning.least_dead_band and not noisy and situation.has_small_momentum
        if small and not moves:
            return come_to_rest(situation, self._robot, f"at the goal, {error:.1e} off")
        goal = situation.aim(nearer_sign(aimed.pose, situation.state))
        situation = situation.aimed_at(goal)
        plan = self._tracking.plan(situation) if moves else self._corrected(situation)
        return replace(plan, status=PlanStatus.HOLDING)

    def _corrected(self, situation: Situation) -> Plan:
        """Return the solution of the problem of the corrections, added to the speeds of rest."""
        momentum, turn, now = situation.momentum, situation.state[QUATERNION], situation.time
        disturbance = situation.disturbance
        in_force = FirstOrderHold.constant(now, situation.speeds - rest_speeds(momentum, turn))
        situation = situation.aimed_at(situation.aim(self._tilted(situation)))
        plan = self._corrections.plan(
            replace(
                situation, state=without_momentum(situation.state), in_force=in_force,
                disturbance=UNDISTURBED,
            )
        )
        times = plan.hold.times
        held = speeds_at_rest(momentum, disturbance, turn, times - now)
        hold = FirstOrderHold(times, plan.hold.speeds + held)
        return replace(plan, hold=hold)

    def _tilted(self, situation: Situation) -> Vector:
        """Return the goal, shape (6,), tilted so that the momentum corrects the turn about z.

        Where the sphere rests but for the component h3 of the momentum along the body's z axis it
        turns about that axis at c1 r3 / r1 (1 + r3 k3^2 / (1 - r1 (k1^2 + k2^2) - r3 k3^2)) h3.
        """
        goal, tuning = situation.goal.pose, self._tuning
        h1, h2, h3 = in_body(situation.momentum, goal[QUATERNION])
        level = float(np.hypot(h1, h2))
        if level < SMALL_MOMENTUM:
            return goal
        _, c1, r1, r3 = situation.constants.as_array()
        square = rotation.vertical(goal[QUATERNION])[2] ** 2
        gain = c1 * r3 / r1 * (1.0 + r3 * square / (1.0 - r1 * (1.0 - square) - r3 * square))
        turned = float(error_between(goal, situation.state[POSE])[4])
        wanted = -turned / (tuning.turning_time * gain)
        largest = 2.0 * tuning.dead_band(0.0, situation.uncertainty)
        tilt = min(max((h3 - wanted) / level, -largest), largest)
        # About the axis h x e3, which lies in the body's x-y plane.
        step = rotation.exponential(tilt / level * np.array([h2, -h1, 0.0]))
        return np.concatenate((goal[:2], rotation.product(goal[QUATERNION], step)))


def _unloading_orientation(
    imbalance: Vector, direction: Vector, near: Vector, other: bool
) -> Vector:
    """Return the orientation whose torque opposes a momentum along `direction` the most.

    The torque e3 x (R a) is largest where R a is horizontal. The momentum lies along the body
    axis that is perpendicular to z and the imbalance, in either sense: the one nearer to `near`,
    or the `other` one.
    """
    unit = imbalance / np.linalg.norm(imbalance)
    axis = np.cross([0.0, 0.0, 1.0], unit)
    length = float(np.linalg.norm(axis))
    axis = np.array([1.0, 0.0, 0.0]) if length < 1e-6 else axis / length
    body = np.column_stack((axis, unit, np.cross(axis, unit)))
    out = np.cross([0.0, 0.0, 1.0], direction)
    found = []
    for along in (direction, -direction):
        world = np.column_stack((along, out, np.cross(along, out)))
        found.append(rotation.from_matrix(world @ body.T))
    nearer, farther = sorted(found, key=lambda q: float(rotation.angle_between(q, near)))
    return farther if other else nearer


def _for_corrections(settings: ControllerSettings) -> ControllerSettings:
    """Return settings with the paper's horizon, whatever that of the strategy `paper`."""
    return replace(settings, horizon=ControllerSettings.horizon)


def _for_tracking(settings: ControllerSettings) -> ControllerSettings:
    """Return settings that keep the sphere near a goal that moves, at each of the knots."""
    period = max(_TRACKING_PERIOD * settings.units.time, SHORTEST_PERIOD)
    return replace(
        settings, horizon=_TRACKING_KNOTS, sample_period=period, terminal_weight=1.0,
        input_weight=_TRACKING_WEIGHT / settings.units.max_speed**2,
    )


def is_at_rest(situation: Situation, max_speed: float) -> bool:
    """Return whether the rotors turn at the speeds at which the sphere rests."""
    held = speeds_of_rest(situation.momentum, situation.state[QUATERNION], max_speed)
    return bool(np.all(np.abs(situation.speeds - held) < SMALL_MOMENTUM))


def is_saturated(momentum: Vector, quaternion: Vector, max_speed: float) -> bool:
    """Return whether a rotor would have to exceed its limit to hold the momentum."""
    return bool(np.max(np.abs(rest_speeds(momentum, quaternion))) > max_speed)


def holdable_goal(goal: Vector, momentum: Vector, disturbance: Disturbance) -> Vector:
    """Return the goal, shape (6,), with the nearest orientation that can be held.

    It is the same object where the momentum at the arrival can be held there.
    """
    q = goal[QUATERNION]
    found = _excess(q, momentum, disturbance)
    if not found.any():
        return goal
    violated = found != 0.0
    for _ in range(_MAX_ITERATIONS):
        # A condition that has been violated once is kept from then on: corrected one at a time,
        # in turn, two that are nearly parallel would take hundreds of iterations.
        violated |= found != 0.0
        here, _ = _components(q, momentum, disturbance)
        near = (_components(_turned(q, s), momentum, disturbance)[0] for s in _STEP * np.eye(3))
        columns = [(there - here) / _STEP for there in near]
        jacobian = violated[:, None] * np.column_stack(columns)
        turn = -np.linalg.pinv(jacobian, rcond=1e-6) @ found
        angle = float(np.linalg.norm(turn))
        q = _turned(q, turn * min(1.0, _MAX_TURN / max(angle, _STEP)))
        found = _excess(q, momentum, disturbance)
        if not found.any():
            break
    held: Vector = goal.copy()
    held[QUATERNION] = q
    return held


def changed_orientation(angle: float) -> str:
    """Return what is given up by a change of the goal's orientation [rad], empty if little."""
    if angle < _MIN_REPORTED_CHANGE:
        return ""
    return f"orientation by {np.degrees(angle):.1f} deg: the rotors cannot hold the momentum there"


def _components(q: Vector, momentum: Vector, disturbance: Disturbance) -> tuple[Vector, Vector]:
    """Return the shares of h and dh/dt along the body's z axis, and their lengths, (2,) each."""
    vectors = np.array((momentum, disturbance.at_rest(q)))
    lengths = np.maximum(np.sqrt(np.sum(vectors * vectors, axis=1)), 1e-12)
    return vectors @ rotation.matrix(q)[:, 2] / lengths, lengths


def _excess(q: Vector, momentum: Vector, disturbance: Disturbance) -> Vector:
    """Return what the shares of h and dh/dt exceed their tolerances by, shape (2,)."""
    along, lengths = _components(q, momentum, disturbance)
    allowed = TOLERANCE / lengths
    excess: Vector = np.copysign(np.maximum(0.0, np.abs(along) - allowed), along)
    return excess


def _turned(q: Vector, turn: Vector) -> Vector:
    turned = rotation.product(q, rotation.exponential(turn))
    normalised: Vector = turned / np.linalg.norm(turned)
    return normalised

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rest at the goal, with corrections of small errors by rolling.

Where the sphere has momentum the rotors follow the speeds that hold it. The motion then depends on
the difference from these speeds as it does on the rotor speeds of a sphere without momentum, so
that the same corrections are added. An error of the estimated momentum moves the sphere in the
same way, and is corrected at every sample. Rolling does not correct a turn about the body's z
axis, but the momentum does: its component along that axis turns the sphere, and a small tilt
changes it.
"""

import dataclasses

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import UNDISTURBED, in_body, rest_speeds, speeds_at_rest
from sphere_nmpc.model.error_state import error_between
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    POSE,
    QUATERNION,
    Vector,
    nearer_sign,
    state_error,
    without_momentum,
)
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import SMALL_MOMENTUM, Situation
from sphere_nmpc.strategy.paper import PaperStrategy
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import come_to_rest
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

_TRACKED, _TRACKING_PERIOD = 6, 0.2
"""Knots of the problem that tracks a goal, and their spacing [s; for the robot of Table 1]."""
_TRACKING_WEIGHT = 1e-3
"""Weight of the squared rotor speeds over those of the largest ones [-] in it."""
_ITERATIONS = 30
"""Cap on its iterations."""


class RestAtGoal:
    """Plans of a sphere that rests at the goal.

    Parameters
    ----------
    settings : ControllerSettings
        Input weight and cap on iterations of the corrections.
    robot : RobotParameters
        Limits of the drives.
    tuning : TimeOptimalSettings
        Dead band, and weight of the corrections.
    """

    def __init__(
        self, settings: ControllerSettings, robot: RobotParameters, tuning: TimeOptimalSettings
    ) -> None:
        self._robot = robot
        self._tuning = tuning
        # A turn that rolling does not correct is a stationary point, and is accepted.
        self._corrections = PaperStrategy(
            _for_corrections(settings), robot, tuning.correction_weight, np.inf
        )
        self._tracking = PaperStrategy(_for_tracking(settings), robot, 1.0, np.inf)

    def change(self, settings: ControllerSettings) -> None:
        """Use other weights and another cap on iterations; the warm start is kept."""
        self._corrections.change(_for_corrections(settings))
        self._tracking.change(_for_tracking(settings))

    def reset(self) -> None:
        """Forget the warm start."""
        self._corrections.reset()
        self._tracking.reset()

    def plan(self, situation: Situation) -> Plan:
        """Return a ramp to rest, a correction of what rolling corrects, or a way with the goal."""
        error = state_error(situation.state, situation.goal)
        tuning, moves = self._tuning, bool(situation.goal_rate.any())
        noisy = tuning.dead_band(situation.noise, 0.0) > tuning.leaving_error
        small = error <= tuning.least_dead_band and not noisy and situation.has_small_momentum
        if small and not moves:
            return come_to_rest(situation, self._robot, f"at the goal, {error:.1e} off")
        goal = nearer_sign(situation.goal, situation.state)
        situation = dataclasses.replace(situation, goal=goal)
        plan = self._tracking.plan(situation) if moves else self._corrected(situation)
        return dataclasses.replace(plan, status=PlanStatus.HOLDING)

    def _corrected(self, situation: Situation) -> Plan:
        """Return the solution of the problem of the corrections, added to the speeds of rest."""
        momentum, turn, now = situation.momentum, situation.state[QUATERNION], situation.time
        in_force = situation.input_in_force - rest_speeds(momentum, turn)
        goal = self._tilted(situation)
        plan = self._corrections.plan(
            dataclasses.replace(
                situation, state=without_momentum(situation.state), goal=goal,
                input_in_force=in_force, disturbance=UNDISTURBED,
            )
        )
        times = plan.hold.times
        held = speeds_at_rest(momentum, situation.disturbance, turn, times - now)
        hold = FirstOrderHold(times, plan.hold.speeds + held)
        return dataclasses.replace(plan, hold=hold)

    def _tilted(self, situation: Situation) -> Vector:
        """Return the goal, shape (6,), tilted so that the momentum corrects the turn about z.

        Where the sphere rests but for the component h3 of the momentum along the body's z axis it
        turns about that axis at c1 r3 / r1 (1 + r3 k3^2 / (1 - r1 (k1^2 + k2^2) - r3 k3^2)) h3.
        """
        goal, tuning = situation.goal, self._tuning
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


def _for_corrections(settings: ControllerSettings) -> ControllerSettings:
    """Return settings with the paper's horizon, whatever that of the strategy `paper`."""
    return dataclasses.replace(settings, horizon=ControllerSettings.horizon)


def _for_tracking(settings: ControllerSettings) -> ControllerSettings:
    """Return settings that keep the sphere near a goal that moves, at each of the knots."""
    time = settings.units.time
    return dataclasses.replace(
        settings, horizon=_TRACKED, sample_period=_TRACKING_PERIOD * time, terminal_weight=1.0,
        input_weight=_TRACKING_WEIGHT / settings.units.max_speed**2, max_iterations=_ITERATIONS,
    )

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Values of the controller's status: decision, goals, plant, momentum and its monitors."""

import math
from typing import Any

import numpy as np

from sphere_nmpc.control.active_course import ActiveCourse
from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.stability import Sample, StabilityMonitor, StabilityReport
from sphere_nmpc.model.controllability import Controllability, controllability
from sphere_nmpc.model.disturbance import (
    Disturbance,
    angle_of_slope,
    offset_of_imbalance,
    rest_speeds,
    time_to_saturation,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.path import Tracking
from sphere_nmpc.model.state import POSE, QUATERNION, Vector
from sphere_nmpc.quantities import stamp_text
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import ControllerSettings

_EVALUATED_EVERY = 0.5
"""Control time between two evaluations of controllability and effort [s]; each takes 0.3 ms."""
_NOT_FOLLOWED = Tracking(*[math.nan] * 5)
_CONSTANTS = ("shell_radius_m", "c1", "r1", "r3")


class ControllerStatus:
    """Source of the status values of a sampling instant."""

    def __init__(
        self,
        controller: Controller,
        robot: RobotParameters,
        settings: ControllerSettings,
    ) -> None:
        self._controller = controller
        self._robot = robot
        self._settings = settings
        self._effort: Vector = np.zeros(2)
        self._counted: object = None
        """Origin of the course whose effort that is."""
        self._monitor = StabilityMonitor()
        self._stability: StabilityReport | None = None
        self._stability_at = self._evaluated_at = float("-inf")
        start = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        self._controllability: Controllability = controllability(start, robot.lumped)

    def change(self, settings: ControllerSettings) -> None:
        """Take over settings that may change while running."""
        if settings.strategy != self._settings.strategy:
            # The value functions of two strategies cannot be compared.
            self._monitor, self._stability = StabilityMonitor(), None
        self._settings = settings

    def update(self, decision: Decision, time: float) -> None:
        """Update the monitor of Eq. (42), which is the paper's strategy's; call it every tick."""
        settings, state = self._settings, decision.state
        if settings.strategy != "paper":
            return
        goal = self._controller.goal
        if goal is None or state is None or not decision.solved:
            return
        # The value function falls from one knot to the next, not within an interval.
        if 0.0 <= time - self._stability_at < 0.99 * settings.period:
            return
        self._stability_at = time
        self._stability = self._monitor.update(
            Sample(
                time, settings.units.scaled(state[POSE]), settings.units.scaled(goal),
                decision.plan.made.cost,
                decision.plan.hold.at(time + settings.period),
                (settings.alpha, settings.terminal_weight, self._robot.max_rotor_speed),
            )
        )

    def _evaluate(self, decision: Decision, time: float) -> None:
        """Evaluate what takes longer: controllability, and the effort since the last time."""
        last, controller = self._evaluated_at, self._controller
        if decision.state is None or 0.0 <= time - last < _EVALUATED_EVERY:
            return
        active, pose = controller.active, decision.state[POSE]
        if active is not None and active.course.origin is not self._counted:
            self._counted, self._effort = active.course.origin, np.zeros(2)
        if -math.inf < last < time:
            plant = controller.estimator.plant.constants
            self._effort += controller.commands.effort(last, time, pose, plant)
        self._evaluated_at = time
        self._controllability = controllability(pose, controller.estimator.plant.constants)

    def values(self, decision: Decision, time: float, duration: float, missed: int) -> dict[
        str, Any
    ]:
        """Return the values of the instant `time` [s], decided within `duration` [s]."""
        self._evaluate(decision, time)
        plan, controller, stability = decision.plan, self._controller, self._stability
        return {
            "time_s": f"{time:.9g}",
            "mode": decision.mode.value,
            "strategy": self._settings.strategy,
            **self.goal_values(decision, time),
            "at_rest": controller.is_at_rest(time),
            "plan": plan.status.value,
            "arrival_s": plan.arrival,
            "error": decision.error,
            "position_error_m": decision.position_error,
            "angle_error_rad": decision.angle_error,
            "position_deviation_m": decision.position_deviation,
            "angle_deviation_rad": decision.angle_deviation,
            "pose_age_s": decision.pose_age,
            "solve_time_s": decision.solve_time,
            "tick_time_s": duration,
            "iterations": plan.made.iterations,
            "cost": plan.made.cost,
            "kkt_residual": plan.made.kkt_residual,
            "heat": float(self._effort[0]),
            "energy_j": float(self._effort[1]),
            "failures": controller.failures,
            "missed_ticks": missed,
            "late_poses": controller.late_poses,
            "commitment_window_s": controller.link.window,
            "command_delay_s": controller.rotors.delay,
            "command_loss": controller.link.loss,
            **self._plant_values(),
            **momentum_values(
                decision.momentum, decision.disturbance, self._robot,
                controller.goal if decision.goal is None else decision.goal,
            ),
            "giving_up": plan.given_up,
            "unreachable": "" if plan.unreachable is None else plan.unreachable.value,
            "no_progress": next(
                (text for kind, text, _ in decision.conditions if kind is Kind.NO_PROGRESS), ""
            ),
            **({} if stability is None else {
                "value_change": stability.value_change,
                "value_change_allowed": stability.allowed_change,
                "stability_steps": stability.judged,
                "stability_violations": stability.violations,
            }),
            "distance_to_gamma_rad": self._controllability.distance_to_circle,
            "smallest_singular_value": self._controllability.smallest_singular_value,
            "pose_delay_s": controller.link.pose_delay,
            "pose_loss": controller.link.pose_loss,
            **({} if controller.floor.is_empty else {"clearance_m": plan.clearance}),
        }

    def goal_values(self, decision: Decision | None, time: float) -> dict[str, Any]:
        """Return the values of the way to the goals, before a decision on them without one."""
        controller, left, way = self._controller, math.nan, math.nan
        if decision is not None and decision.mode is Kind.AT_GOAL:
            left = 0.0
        elif decision is not None and decision.mode is Kind.TRACKING:
            left = float(np.maximum(0.0, decision.plan.arrival - time))  # nan if it is not known
        if decision is not None and decision.solved:
            way = decision.plan.way_left(time)
        total_left, total_way = controller.following.remaining(left, way)
        tracking = controller.following.tracking() or _NOT_FOLLOWED
        return {
            "goal_speed": controller.following.goal_speed(time),
            "time_left_s": left,
            "distance_left_m": way,
            "total_time_left_s": total_left,
            "total_distance_left_m": total_way,
            "path_length_m": tracking.way + tracking.way_left,
            "path_left_m": tracking.way_left,
            "path_deviation_m": tracking.deviation,
            "path_heading_error_rad": tracking.heading_error,
            "path_speed_m_s": tracking.speed,
            "plans": controller.plans,
        }

    def _plant_values(self) -> dict[str, float]:
        plant = self._controller.estimator.plant
        names = [f"learnt_{name}" for name in _CONSTANTS]
        values = dict(zip(names, plant.constants.as_array().tolist(), strict=True))
        for name, deviation in zip(names, plant.deviations.tolist(), strict=True):
            values[f"{name}_deviation"] = deviation
        return {**values, "learnt_noise": plant.noise, "learnt_lag_s": plant.lag}


def goals_in_force(active: ActiveCourse | None, active_goal: int) -> dict[str, Any]:
    """Return the status values that name the goals, and what the one aimed at demands.

    `active_goal` is the stamp [ns] of the message that was published for that one.
    """
    if active is None:
        return {
            "goal_stamp": "", "goal_index": 0, "goal_count": 0, "goal_orientation": "",
            "active_goal_stamp": "",
        }
    return {
        "goal_stamp": stamp_text(active.stamp), "goal_index": active.index,
        "goal_count": len(active.course.legs), "goal_orientation": active.goal.orientation.value,
        "active_goal_stamp": stamp_text(active_goal),
    }


def momentum_values(
    momentum: Vector, disturbance: Disturbance, robot: RobotParameters, goal: Vector | None
) -> dict[str, float]:
    """Return the status values of the estimated momentum and of what changes it.

    Speeds and saturation of the resting rotors are those at the goal, shape (6,); nan without one.
    """
    offset = 1e3 * offset_of_imbalance(robot, disturbance.imbalance)
    speeds, saturation = (math.nan, math.nan), math.nan
    if goal is not None:
        first, second = rest_speeds(momentum, goal[QUATERNION]).tolist()
        speeds = first, second
        saturation = time_to_saturation(
            momentum, disturbance, goal[QUATERNION], robot.max_rotor_speed
        )
    slope_x, slope_y = disturbance.slope.tolist()
    in_newton = robot.rotor_axial_inertia * momentum
    return {
        **{f"momentum_{axis}": value
           for axis, value in zip("xyz", in_newton.tolist(), strict=True)},
        "slope_deg": math.degrees(angle_of_slope(robot, disturbance.slope)),
        # Downhill is perpendicular to the torque. Subtracted from 0, as -0.0 gives an angle of -0.
        "slope_direction_deg": math.degrees(math.atan2(0.0 - slope_x, slope_y)),
        **{f"mass_offset_{axis}_mm": value
           for axis, value in zip("xyz", offset.tolist(), strict=True)},
        "rest_speed_1": speeds[0],
        "rest_speed_2": speeds[1],
        "saturation_s": saturation,
    }

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The values of the controller's status: what it decided, what it learnt, how steadily it goes."""

from typing import Any

import numpy as np

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.stability import Sample, StabilityMonitor, StabilityReport
from sphere_nmpc.model.controllability import Controllability, controllability
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings

_CONTROLLABILITY_EVERY = 0.5
"""Control time between two looks at the controllability [s]; each costs a tenth of a ms."""
_CONSTANTS = ("shell_radius_m", "c1", "r1", "r3")


class ControllerStatus:
    """Collect what is worth telling about a sample instant.

    Parameters
    ----------
    controller : Controller
        Who is told about.
    robot : RobotParameters
        What is believed about the robot.
    settings : ControllerSettings
        Strategy and weights.
    """

    def __init__(
        self, controller: Controller, robot: RobotParameters, settings: ControllerSettings
    ) -> None:
        self._controller = controller
        self._robot = robot
        self._settings = settings
        self._monitor = StabilityMonitor()
        self._stability: StabilityReport | None = None
        self._judged_at = float("-inf")
        self._looked_at = float("-inf")
        # The first call builds the brackets, which takes longer than a sample.
        start = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        self._controllability: Controllability = controllability(start, robot.lumped)

    def change(self, settings: ControllerSettings) -> None:
        """Take over settings that may change while running."""
        if settings.strategy != self._settings.strategy:
            # What one strategy's values did says nothing about the next one's.
            self._monitor, self._stability = StabilityMonitor(), None
        self._settings = settings

    def judge(self, decision: Decision, time: float) -> None:
        """Let the monitors see what was decided for `time` [s]; cheap enough for every tick."""
        period = self._settings.period
        if time < self._judged_at:
            self._judged_at = self._looked_at = float("-inf")
        # The value function falls from one knot to the next, not within an interval.
        if decision.solved and time >= self._judged_at + 0.99 * period:
            self._judged_at = time
            self._judge(decision, time)
        if decision.state is not None and time >= self._looked_at + _CONTROLLABILITY_EVERY:
            self._looked_at = time
            self._controllability = controllability(decision.state, self._controller.constants)

    def values(self, decision: Decision, time: float, duration: float, missed: int) -> dict[
        str, Any
    ]:
        """Return what is told about the instant `time` [s], decided within `duration` [s]."""
        plan, controller = decision.plan, self._controller
        return {
            "time_s": f"{time:.9g}",
            "mode": decision.mode.value,
            "strategy": self._settings.strategy,
            "plan": plan.status.value,
            "arrival_s": plan.arrival,
            "error": decision.error,
            "position_error_m": decision.position_error,
            "angle_error_rad": decision.angle_error,
            "position_deviation_m": decision.position_deviation,
            "angle_deviation_rad": decision.angle_deviation,
            "pose_age_s": decision.pose_age,
            "solve_time_s": plan.solve_time,
            "tick_time_s": duration,
            "iterations": plan.iterations,
            "cost": plan.cost,
            "kkt_residual": plan.kkt_residual,
            "failures": controller.failures,
            "missed_ticks": missed,
            "late_poses": controller.late_poses,
            **self._learnt(),
            **self._stability_values(),
            "distance_to_gamma_rad": self._controllability.distance_to_circle,
            "smallest_singular_value": self._controllability.smallest_singular_value,
        }

    def _learnt(self) -> dict[str, float]:
        controller = self._controller
        deviations = controller.estimator.standard_deviation.tolist()
        values = controller.constants.as_array().tolist()
        learnt = {f"learnt_{name}": value for name, value in zip(_CONSTANTS, values, strict=True)}
        if controller.fusion is None:
            learnt |= {
                f"learnt_{name}_deviation": value
                for name, value in zip(_CONSTANTS, deviations, strict=True)
            }
            learnt["learnt_noise"] = controller.estimator.noise
        return {**learnt, "learnt_lag_s": controller.lag}

    def _stability_values(self) -> dict[str, Any]:
        report = self._stability
        if report is None:
            return {}
        return {
            "value_change": report.value_change,
            "value_change_allowed": report.allowed_change,
            "beta_bound": report.beta_bound,
            "stability_steps": report.judged,
            "stability_violations": report.decrease_violations,
        }

    def _judge(self, decision: Decision, time: float) -> None:
        """Show the monitor of Theorem 3 a step of the strategy that it is about."""
        goal, settings, state = self._controller.goal, self._settings, decision.state
        if settings.strategy != "paper" or goal is None or state is None:
            return
        self._stability = self._monitor.update(
            Sample(
                time, state, goal, decision.plan.cost,
                decision.plan.hold.at(time + settings.period),
                settings.input_weight, settings.terminal_weight, self._robot.max_rotor_speed,
            )
        )

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Strategies by name."""

from collections.abc import Callable

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Strategy
from sphere_nmpc.strategy.paper import PaperStrategy
from sphere_nmpc.strategy.plan_keeping import PlanKeepingStrategy
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy

_STRATEGIES: dict[str, Callable[[ControllerSettings, RobotParameters], Strategy]] = {
    "time_optimal": TimeOptimalStrategy,
    "plan_keeping": PlanKeepingStrategy,
    "paper": PaperStrategy,
}
"""The names are those of `sphere_nmpc.settings.SAMPLE_PERIODS`."""


def make_strategy(settings: ControllerSettings, robot: RobotParameters) -> Strategy:
    """Return the strategy named in `settings`, which has checked the name."""
    return _STRATEGIES[settings.strategy](settings, robot)

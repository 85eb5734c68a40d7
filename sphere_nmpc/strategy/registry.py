# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Strategies by name."""

from sphere_nmpc.control.settings import ControllerSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.strategy.contract import Strategy
from sphere_nmpc.strategy.paper import PaperStrategy
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy


def make_strategy(settings: ControllerSettings, robot: RobotParameters) -> Strategy:
    """Return the strategy named in `settings`, which has checked the name."""
    if settings.strategy == "paper":
        return PaperStrategy(settings, robot)
    return TimeOptimalStrategy(settings, robot)

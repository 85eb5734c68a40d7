# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Construction of strategies by name."""

from importlib import import_module

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.contract import Strategy


def make_strategy(settings: ControllerSettings, robot: RobotParameters) -> Strategy:
    """Return a new strategy of the kind that is named in `settings`, which has checked the name.

    Parameters
    ----------
    settings : ControllerSettings
        Name of the strategy, and its settings.
    robot : RobotParameters
        Parameters of the robot and limits of its drives.
    """
    module, _, name = STRATEGIES[settings.strategy].path.partition(":")
    strategy: Strategy = getattr(import_module(module), name)(settings, robot)
    return strategy

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``python -m sphere_sim.ros.faults.controller PARENT FILE ...``: a controller whose solver fails.

It is the controller node itself, with every strategy wrapped before the node starts, so that the
controller needs no hook for it. FILE holds the failure mode, see `BadStrategy`.
"""

from collections.abc import Sequence
from pathlib import Path

from sphere_nmpc.control import controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros.controller.node import main as run_controller
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Strategy
from sphere_nmpc.strategy.registry import make_strategy
from sphere_sim.faults.bad_strategy import failing_on_demand
from sphere_sim.ros.session.parent import end_with_parent


def main(arguments: Sequence[str]) -> int:
    """Run the controller node with every strategy wrapped in a `BadStrategy`."""
    parent, mode_file, *rest = arguments
    end_with_parent(int(parent))

    def make(settings: ControllerSettings, robot: RobotParameters) -> Strategy:
        return failing_on_demand(make_strategy(settings, robot), Path(mode_file))

    controller.make_strategy = make
    return run_controller(rest)

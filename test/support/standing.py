# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A strategy that makes no progress."""

from typing import Any

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus


class Standing:
    """`Strategy` that plans rest from 2.5 s on at each sample, with a status and other values."""

    def __init__(self, status: PlanStatus = PlanStatus.SOLVED, **values: Any) -> None:
        self._status = status
        self._values = values

    def plan(self, situation: Situation) -> Plan:
        """Return the plan from the speeds in force on."""
        times = situation.time + np.array([0.0, 2.5, 5.0])
        hold = FirstOrderHold(times, np.vstack((situation.input_in_force, np.zeros((2, 2)))))
        states = np.tile(situation.state, (times.size, 1))
        return Plan(self._status, hold, states, **self._values)

    def change(self, settings: ControllerSettings) -> None:
        """Plan as before, whatever the settings."""

    def reset(self) -> None:
        """Plan as before."""

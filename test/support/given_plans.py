# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Strategies whose plans a test gives."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan


class Given:
    """`Strategy` that plans by a function, which may be replaced at any time."""

    def __init__(self, make: Callable[[Situation], Any]) -> None:
        self.make = make
        self.situations: list[Situation] = []
        self.resets = 0

    def plan(self, situation: Situation) -> Plan:
        self.situations.append(situation)
        return self.make(situation)

    def change(self, settings: ControllerSettings) -> None:
        """Plan as before, whatever the settings."""

    def reset(self) -> None:
        self.resets += 1


def plan_of(situation: Situation, gaps: Vector, speeds: Vector, **values: Any) -> Plan:
    """Return a plan from the speeds in force on to others, (K, 2), each after a gap, (K,) [s]."""
    times = situation.time + np.cumsum([0.0, *gaps])
    hold = FirstOrderHold(times, np.vstack((situation.speeds, speeds)))
    states = np.tile(situation.state, (times.size, 1))
    return Plan(**{"hold": hold, "states": states, **values})


class Standing(Given):
    """`Strategy` that makes no progress: the same speed of both rotors [rad/s] from 2.5 s on."""

    def __init__(self, speed: float = 0.0, **values: Any) -> None:
        speeds = np.full((2, 2), speed)
        super().__init__(lambda situation: plan_of(situation, [2.5, 2.5], speeds, **values))

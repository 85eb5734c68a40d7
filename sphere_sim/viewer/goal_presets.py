# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals that users can choose from a list."""

import math
from collections.abc import Callable

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, make_state
from sphere_sim.scenario.scenarios import PAPER_CASES

_HALF = math.sqrt(0.5)


def _rotated(state: Vector, wxyz: tuple[float, float, float, float]) -> Vector:
    """Return a state at the same position, rotated in the world frame."""
    return make_state(state[POSITION], rotation.product(np.array(wxyz), state[QUATERNION]))


def _fixed(goal: Vector) -> Callable[[Vector], Vector]:
    return lambda state: goal.copy()


GOAL_PRESETS: dict[str, Callable[[Vector], Vector]] = {
    "origin, upright": _fixed(make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))),
    **{
        f"goal of the paper's case {number}": _fixed(case.goal)
        for number, case in PAPER_CASES.items()
    },
    **{
        f"start of the paper's case {number}": _fixed(case.start)
        for number, case in PAPER_CASES.items()
    },
    "half turn about the vertical, here": lambda state: _rotated(state, (0.0, 0.0, 0.0, 1.0)),
    "upside down, here": lambda state: _rotated(state, (0.0, 1.0, 0.0, 0.0)),
    "upright, here": lambda state: make_state(state[POSITION], (1.0, 0.0, 0.0, 0.0)),
    "on circle Γ, here": lambda state: make_state(state[POSITION], (_HALF, 0.0, _HALF, 0.0)),
    "1 m ahead in x": lambda state: state + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
}
"""Goal of each name, shape (6,), as a function of the present state, shape (6,)."""

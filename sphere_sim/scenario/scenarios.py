# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scenarios of runs: the paper's cases and random ones."""

from dataclasses import dataclass, field, fields

import numpy as np

from sphere_nmpc.model.state import Vector, as_state
from sphere_sim.scenario.draws import DRAWS
from sphere_sim.world.disturbances import DisturbanceSettings, Push

PUSH_COLUMNS = ("push_x", "push_y", "push_time")
"""Columns of scenario files for a push: impulse [N s; world], time [s]."""
DISTURBANCE_COLUMNS = tuple(setting.name for setting in fields(DisturbanceSettings))
"""Columns of scenario files with settings of this name."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """Start and goal of a run.

    Attributes
    ----------
    start, goal : ndarray, shape (6,)
        Initial and desired state; the sphere starts at rest.
    seed : int
        Seed of all random numbers of the run.
    extra : dict of str to str
        Further columns of the scenario file, copied to the results.
    given : dict of str to str
        Text of the columns of both states in the file, before normalisation; empty without a
        file.
    push : Push, optional
        Push during the run.
    disturbances : dict of str to float
        Settings of `sphere_sim.world.disturbances.DisturbanceSettings` of this run.
    """

    start: Vector
    goal: Vector
    seed: int = 0
    extra: dict[str, str] = field(default_factory=dict)
    given: dict[str, str] = field(default_factory=dict)
    push: Push | None = None
    disturbances: dict[str, float] = field(default_factory=dict)

    @property
    def optional(self) -> dict[str, float]:
        """Content of the optional columns with numbers, by name, in the order of the columns."""
        push: dict[str, float] = {}
        if self.push is not None:
            values = (*self.push.impulse, self.push.time)
            push = dict(zip(PUSH_COLUMNS, values, strict=True))
        kept = {n: self.disturbances[n] for n in DISTURBANCE_COLUMNS if n in self.disturbances}
        return push | kept


def _paper_case(start: list[float], goal: list[float]) -> Scenario:
    return Scenario(as_state(start), as_state(goal))


_ORIGIN = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
_ON_THE_CIRCLE = [0.0, 0.0, 0.7071, 0.0, 0.7071, 0.0]

PAPER_CASES: dict[int, Scenario] = {
    1: _paper_case([2.0, -3.0, 0.03, 0.454, 0.88, 0.1363], _ORIGIN),
    2: _paper_case([1.0, 2.0, 0.5, 0.5, 0.5, 0.5], _ON_THE_CIRCLE),
    3: _paper_case([0.0, 0.0, 0.6521, 0.1132, 0.1115, 0.7413], _ORIGIN),
    4: _paper_case([0.0, 0.0, 0.2734, 0.5628, 0.4281, 0.6521], _ON_THE_CIRCLE),
}
"""The four cases of section 4 of the paper, where case 4 has noise and parameter errors."""


def draw_scenarios(number: int, seed: int, kind: str = "anywhere") -> list[Scenario]:
    """Return random scenarios of one of the kinds in `sphere_sim.scenario.draws.DRAWS`.

    Scenario i depends on the seed alone, not on `number`.
    """
    scenarios = []
    for i in range(number):
        rng = np.random.default_rng([seed, i])
        start, goal = DRAWS[kind](rng)
        scenarios.append(Scenario(start, goal, seed=int(rng.integers(2**31))))
    return scenarios

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Strategy `time_optimal` with momentum that is estimated from noisy poses."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest
from momentum_loop import ROBOT, MomentumLoop, statuses

from sphere_nmpc.model import rotation
from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.error_state import error_between
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import QUATERNION, make_state
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_nmpc.strategy.registry import make_strategy
from sphere_nmpc.strategy.time_optimal.grid import KnotGrid
from sphere_nmpc.strategy.time_optimal.planner import ArrivalPlanner
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

UNCERTAINTY = 5e-3
"""Of poses of 5 mm and 1 degree at 20 Hz, fused for some seconds."""
ORIGIN = make_state(np.zeros(2), np.array([1.0, 0.0, 0.0, 0.0]))
HELD = np.array([0.0, 60.0])


@dataclass
class UncertainLoop(MomentumLoop):
    """Loop whose strategy is told that its state is uncertain, although it is exact.

    Attributes
    ----------
    wrong : float
        Error of the estimated momentum along the vertical [rad/s].
    """

    wrong: float = 0.0

    def situation(self) -> Situation:
        known = super().situation()
        momentum = known.drift.momentum + np.array([0.0, 0.0, self.wrong])
        drift = replace(known.drift, momentum=momentum)
        return replace(known, uncertainty=UNCERTAINTY, drift=drift)


@pytest.mark.parametrize(
    ("uncertainty", "rests"), [(UNCERTAINTY, True), (0.0, False)], ids=["noisy", "exact"]
)
def test_sphere_rests_where_the_speeds_are_those_of_rest_but_for_noise(
    uncertainty: float, rests: bool
) -> None:
    drift = Drift(np.append(HELD, 0.0))
    off_by = HELD + np.array([2.0, -2.5])
    situation = Situation(
        0.0, ORIGIN, ORIGIN, off_by, ROBOT.lumped, uncertainty=uncertainty, drift=drift
    )
    plan = make_strategy(ControllerSettings(planning_effort=2000), ROBOT).plan(situation)
    assert (plan.status is PlanStatus.HOLDING) == rests


def test_goal_is_not_tilted_by_the_noise_of_little_momentum() -> None:
    loop = UncertainLoop(ORIGIN, ORIGIN)
    loop.run(0.5)
    loop.push_momentum(np.array([0.8, 0.7, 0.0]))
    # Errors at the goal are up to 0.1 to 0.2 rad/s.
    loop.wrong = 0.15
    assert statuses(loop.run(1.0)) == {PlanStatus.HOLDING}
    assert not any(plan.given_up for plan in loop.plans)


def test_turn_is_corrected_faster_among_noise() -> None:
    start = make_state(np.zeros(2), rotation.exponential(np.array([0.0, 0.0, 0.02])))
    loop = UncertainLoop(start, ORIGIN)
    loop.push_momentum(np.append(HELD, 0.0))
    speeds = loop.drift.rest_speeds(start[QUATERNION])
    loop.commands.sent.record(FirstOrderHold.constant(0.0, speeds))
    loop.plant.advance(speeds, 1e-9)
    loop.plant.displace(start)
    assert statuses(loop.run(3.0)) == {PlanStatus.HOLDING}
    turned = abs(float(error_between(ORIGIN, loop.plant.state)[4]))
    # exp(-3 / 1.2) is 0.08, and the tilt takes a few samples; the time constant of exact poses
    # leaves half of it.
    assert turned < 0.2 * 0.02


@pytest.mark.parametrize("uncertainty", [UNCERTAINTY, 0.0], ids=["noisy", "exact"])
def test_plan_aims_at_no_momentum_along_z_only_where_it_is_known(uncertainty: float) -> None:
    drift = Drift(np.array([20.0, -10.0, 0.3]), imbalance=np.array([2.0, -1.0, 1.0]))
    start = make_state(np.array([0.7, -0.4]), rotation.exponential(np.array([0.4, -0.5, 0.6])))
    situation = Situation(
        0.0, start, ORIGIN, np.zeros(2), ROBOT.lumped, uncertainty=uncertainty, drift=drift
    )
    tuning = TimeOptimalSettings()
    grid = KnotGrid(0.25, tuning)
    grid.begin(0.0)
    planner = ArrivalPlanner(ROBOT, 0.25, grid, itertools.count(1), tuning)
    found = planner.search(situation, new_plan=True).improve(40_000)
    assert found is not None
    arrival = planner.solve(situation, found.goal, 1.1 * found.duration, found.hold, new_plan=True)
    along = abs(arrival.drift.in_body(arrival.goal[QUATERNION])[2])
    # An error of 1e-4 counts as much as 0.005 rad/s.
    assert (along < 0.05) == (uncertainty == 0.0)

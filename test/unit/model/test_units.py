# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Units of a robot: those of Table 1 are one, and equivalent robots have equal plans."""

from dataclasses import replace

import numpy as np
import pytest
from robots import SIZES
from sampled_loop import settling_time

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, without_momentum
from sphere_nmpc.model.units import RobotUnits
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation, make_strategy
from sphere_sim.scenario.scenarios import PAPER_CASES

TABLE_1 = RobotParameters()


def scaled_robot(length: float, speed: float) -> RobotParameters:
    """Return a robot with the ratios of Table 1's at other lengths and rotor speeds."""
    robot = RobotParameters()
    inertias = {
        name: getattr(robot, name) * length**2
        for name in RobotParameters.__dataclass_fields__ if name.endswith("_inertia")
    }
    return replace(
        robot, **inertias,
        shell_radius=robot.shell_radius * length,
        rotor_offset=robot.rotor_offset * length,
        max_rotor_speed=robot.max_rotor_speed * speed,
        max_rotor_acceleration=robot.max_rotor_acceleration * speed**2,
    )


def test_units_of_table_1_are_one_and_what_a_user_sets_is_used_as_set() -> None:
    assert RobotUnits.of(TABLE_1) == RobotUnits(1.0, 1.0, 1.0)
    assert RobotUnits.of(TABLE_1).max_speed == 100.0
    for name, period in (("paper", 0.5), ("plan_keeping", 0.5), ("time_optimal", 0.25)):
        settings = ControllerSettings(strategy=name).of(TABLE_1)
        assert (settings.period, settings.alpha, settings.longest_step) == (period, 0.5, 0.1)
    given = ControllerSettings(sample_period=0.3, input_weight=2.0, integration_step=0.05)
    settings = given.of(scaled_robot(length=0.1, speed=10.0))
    assert (settings.period, settings.alpha, settings.longest_step) == (0.3, 2.0, 0.05)


@pytest.mark.parametrize("name", ["paper", "plan_keeping"])
def test_equivalent_robots_have_the_same_plan_in_their_units(name) -> None:
    other = scaled_robot(length=0.1, speed=8.0)
    case, plans = PAPER_CASES[1], []
    for robot in (TABLE_1, other):
        settings = ControllerSettings(strategy=name).of(robot)
        units = settings.units
        # The own period is rounded to two digits; here the ratio has to be exact.
        settings = replace(settings, sample_period=0.5 * units.time)
        start, goal = case.start.copy(), case.goal.copy()
        start[POSITION] *= units.length
        goal[POSITION] *= units.length
        situation = Situation(0.0, without_momentum(start), goal, np.zeros(2), robot.lumped)
        plan = make_strategy(settings, robot).plan(situation)
        plans.append((plan.hold.speeds / units.speed, plan.cost))
    # Rounding of the products, which depends on the processor, carried through ten iterations.
    # Near its minimum the cost is flat: the inputs agree to the root of what the costs do.
    assert plans[1][1] == pytest.approx(plans[0][1], rel=1e-9)
    np.testing.assert_allclose(plans[1][0], plans[0][0], atol=100.0 * 1e-9**0.5)


@pytest.mark.parametrize("robot", SIZES)
def test_robot_of_another_size_reaches_a_goal_metres_away(robot) -> None:
    case, units = PAPER_CASES[1], RobotUnits.of(SIZES[robot])
    settled = settling_time(
        "plan_keeping", case.start, case.goal, 150.0 * units.time, SIZES[robot]
    )
    assert settled < 120.0 * units.time

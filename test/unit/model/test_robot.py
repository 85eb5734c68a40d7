# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What follows from a robot's parameters: lumped constants, units, limits, disturbances."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robots import SIZES
from sampled_loop import settling_time

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    angle_of_slope,
    imbalance_of_offset,
    momentum_of_push,
    offset_of_imbalance,
    push_against,
    slope_torque,
    time_to_saturation,
)
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion, vertical
from sphere_nmpc.model.state import POSITION, make_state, without_momentum
from sphere_nmpc.model.torque import (
    largest_acceleration,
    rotor_acceleration,
    torques,
    within_torque,
)
from sphere_nmpc.model.units import RobotUnits
from sphere_nmpc.quantities import quantities
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation, make_strategy
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
INERTIA = ROBOT.rotor_axial_inertia


def test_inertias_and_lumped_constants_of_table_1_agree_with_hand_calculation() -> None:
    assert (ROBOT.shell_radius, INERTIA, ROBOT.max_rotor_speed) == (0.3, 0.008, 100.0)
    assert ROBOT.total_mass == pytest.approx(3.8)  # 1 + 2 * 0.7 + 2 * 0.7 kg
    # 0.008 + 0.008 + 2 * (0.004 + 0.7 * 0.0225) + 0.06 kg m^2
    assert ROBOT.transverse_inertia == pytest.approx(0.1155)
    assert ROBOT.axial_inertia == pytest.approx(0.139)  # 4 * (0.004 + 0.01575) + 0.06
    assert ROBOT.rolling_inertia == pytest.approx(0.342)  # 3.8 * 0.09
    np.testing.assert_allclose(
        ROBOT.lumped.as_array(), [0.3, 0.008 / 0.4575, 0.342 / 0.4575, 0.342 / 0.481], rtol=1e-14
    )


@pytest.mark.parametrize("name", quantities(RobotParameters))
def test_parameter_that_is_negative_or_too_large_is_refused_by_name(name: str) -> None:
    number = quantities(RobotParameters)[name]
    for bad in (-1e-12, 1.001 * number.maximum, math.nan):
        with pytest.raises(InvalidParameterError) as caught:
            RobotParameters(**{name: bad})
        assert str(caught.value).startswith(f"{name}: given {bad!r}, expected ")
        assert number.unit in str(caught.value)


def test_rotors_have_to_be_inside_the_shell() -> None:
    with pytest.raises(InvalidParameterError, match=r"rotor_offset.*less than shell_radius"):
        RobotParameters(rotor_offset=0.3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"shell_mass": 0.15, "shell_radius": 0.2, "rotor_offset": 0.1},
         "shell_inertia: given 0.06, expected at most 0.006 kg m^2, shell_mass times"),
        ({"rotor_axial_inertia": 0.064, "rotor_transverse_inertia": 0.04},
         "rotor_axial_inertia: given 0.064, expected at most 0.063 kg m^2, rotor_mass times"),
        ({"counterweight_mass": 0.0}, "counterweight_axial_inertia: given 0.008, expected at"),
        ({"rotor_transverse_inertia": 0.002},
         "rotor_axial_inertia: given 0.008, expected at most twice rotor_transverse_inertia"),
    ],
)
def test_inertias_that_no_part_within_the_shell_can_have_are_refused(given, message) -> None:
    with pytest.raises(InvalidParameterError) as caught:
        RobotParameters(**given)
    assert str(caught.value).startswith(message)


def scaled_robot(length: float, speed: float) -> RobotParameters:
    """Return a robot with the ratios of Table 1's at other lengths and rotor speeds."""
    powers = dict.fromkeys(
        (name for name in quantities(RobotParameters) if name.endswith("_inertia")), length**2
    ) | {
        "shell_radius": length, "rotor_offset": length, "max_rotor_speed": speed,
        "max_rotor_acceleration": speed**2,
    }
    return replace(ROBOT, **{name: getattr(ROBOT, name) * by for name, by in powers.items()})


def test_units_of_table_1_are_one_and_what_a_user_sets_is_used_as_set() -> None:
    assert RobotUnits.of(ROBOT) == RobotUnits(1.0, 1.0, 1.0)
    assert RobotUnits.of(ROBOT).max_speed == 100.0
    for name, period in (("paper", 0.5), ("plan_keeping", 0.5), ("time_optimal", 0.25)):
        settings = ControllerSettings(strategy=name).of(ROBOT)
        assert (settings.period, settings.alpha, settings.longest_step) == (period, 0.5, 0.1)
    given = ControllerSettings(sample_period=0.3, input_weight=2.0, integration_step=0.05)
    settings = given.of(scaled_robot(length=0.1, speed=10.0))
    assert (settings.period, settings.alpha, settings.longest_step) == (0.3, 2.0, 0.05)


@pytest.mark.parametrize("name", ["paper", "plan_keeping"])
def test_equivalent_robots_have_the_same_plan_in_their_units(name) -> None:
    case, plans = PAPER_CASES[1], []
    for robot in (ROBOT, scaled_robot(length=0.1, speed=8.0)):
        settings = ControllerSettings(strategy=name).of(robot)
        units = settings.units
        # The own period is rounded to two digits; here the ratio has to be exact.
        settings = replace(settings, sample_period=0.5 * units.time)
        start, goal = case.start.copy(), case.goal.copy()
        start[POSITION] *= units.length
        goal[POSITION] *= units.length
        situation = Situation.of(0.0, without_momentum(start), goal, np.zeros(2), robot.lumped)
        plan = make_strategy(settings, robot).plan(situation)
        plans.append((plan.hold.speeds / units.speed, plan.made.cost))
    # Rounding of the products, which depends on the processor, carried through ten iterations.
    # Near its minimum the cost is flat: the inputs agree to the root of what the costs do.
    assert plans[1][1] == pytest.approx(plans[0][1], rel=1e-9)
    np.testing.assert_allclose(plans[1][0], plans[0][0], atol=100.0 * 1e-9**0.5)


@pytest.mark.parametrize("robot", SIZES)
def test_robot_of_another_size_reaches_a_goal_metres_away(robot) -> None:
    case, time = PAPER_CASES[1], RobotUnits.of(SIZES[robot]).time
    found = settling_time("plan_keeping", case.start, case.goal, 150.0 * time, SIZES[robot])
    assert found < 120.0 * time


def test_units_of_disturbances_and_their_inverses_agree_with_hand_calculation() -> None:
    push = momentum_of_push(ROBOT, np.array([0.5, -0.2]))
    np.testing.assert_allclose(push, [0.2 * 0.3 / 0.008, 0.5 * 0.3 / 0.008, 0.0])
    np.testing.assert_allclose(push_against(ROBOT, push), [-0.5, 0.2])
    slope = slope_torque(ROBOT, 0.02, 0.7)
    assert np.linalg.norm(slope) == pytest.approx(3.8 * 9.81 * math.sin(0.02) * 0.3 / 0.008)
    assert slope @ [math.cos(0.7), math.sin(0.7)] == pytest.approx(0.0, abs=1e-12)
    assert angle_of_slope(ROBOT, slope) == pytest.approx(0.02)
    offset = np.array([1e-3, -2e-3, 3e-3])
    imbalance = imbalance_of_offset(ROBOT, offset)
    np.testing.assert_allclose(imbalance, 3.8 * 9.81 / 0.008 * offset)
    np.testing.assert_allclose(offset_of_imbalance(ROBOT, imbalance), offset)


UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
ON_SIDE = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])
"""Body z level and along -y."""


@pytest.mark.parametrize(
    ("momentum", "slope", "quaternion", "expected"),
    [
        ([0.0, 0.0, 0.0], UNDISTURBED.slope, UPRIGHT, math.inf),
        ([50.0, 0.0, 0.0], UNDISTURBED.slope, UPRIGHT, math.inf),
        # At its limit or beyond, even where the torque takes from it.
        ([0.0, 100.0, 0.0], [0.0, -10.0], UPRIGHT, 0.0),
        ([0.0, -130.0, 0.0], [0.0, 10.0], UPRIGHT, 0.0),
        ([0.0, -50.0, 0.0], [0.0, 10.0], UPRIGHT, 15.0),
        ([0.0, 50.0, 0.0], [0.0, 10.0], UPRIGHT, 5.0),
        ([0.0, 0.0, 0.0], [10.0, 0.0], ON_SIDE, 10.0),
    ],
)
def test_time_to_saturation_agrees_with_hand_calculation(
    momentum, slope, quaternion, expected
) -> None:
    disturbance = Disturbance(np.array(slope))
    found = time_to_saturation(np.array(momentum), disturbance, quaternion, 100.0)
    assert found == pytest.approx(expected, rel=1e-12)


def test_torques_of_a_plan_are_those_of_the_plant() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(6) * 0.25
    hold = FirstOrderHold(times, np.vstack((np.zeros(2), rng.uniform(-90.0, 90.0, (5, 2)))))
    plant = RollingPlant(ROBOT, make_state((0.0, 0.0), (0.5, 0.5, 0.5, 0.5)))
    states, seen = [plant.state], []
    for speeds in hold.speeds[1:]:
        plant.advance(speeds, 0.25)
        states.append(plant.state)
        seen.append(plant.rotor_torques)
    after, before = torques(np.array(states), hold, ROBOT.lumped, INERTIA)
    np.testing.assert_allclose(before, seen, atol=1e-9)
    # At rest the shell does not turn: what is left is the reaction of its inertia.
    np.testing.assert_allclose(after[0], INERTIA * hold.speeds[1] / 0.25, rtol=0.08)
    one = FirstOrderHold.constant(0.0, np.zeros(2))
    for part in torques(states[0][None], one, ROBOT.lumped, INERTIA):
        assert part.shape == (0, 2)


@pytest.mark.parametrize("seed", range(6))
def test_slew_within_a_torque_limit_keeps_it_everywhere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot, limit = perturbed(ROBOT, 0.5, rng), rng.uniform(0.5, 3.2)
    robot = replace(robot, max_rotor_torque=limit, max_rotor_acceleration=1e6)
    slew = largest_acceleration(robot)
    verticals = vertical(np.array([random_quaternion(rng) for _ in range(20_000)]))
    u, du = rng.choice([-1.0, 0.0, 1.0], (2, 20_000, 2)) * [[[robot.max_rotor_speed]], [[slew]]]
    found = np.max(np.abs(rotor_acceleration(verticals, u, du, robot.lumped.as_array())))
    assert 0.9 * limit < robot.rotor_axial_inertia * found <= limit * (1.0 + 1e-12)


def test_without_a_limit_or_with_a_generous_one_the_slew_stays_and_too_low_a_one_is_refused():
    assert largest_acceleration(ROBOT) == ROBOT.max_rotor_acceleration
    assert within_torque(replace(ROBOT, max_rotor_torque=10.0)).max_rotor_acceleration == 400.0
    # The turning shell alone exceeds it.
    with pytest.raises(InvalidParameterError, match="max_rotor_torque"):
        largest_acceleration(replace(ROBOT, max_rotor_torque=0.05))

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Loops with inexact times, outliers, lost commands or other constants arrive all the same."""

import functools
import math
from dataclasses import replace

import inexact_times
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

pytestmark = pytest.mark.slow

SCENARIOS = inexact_times.scenarios([1, 2, 3])


@functools.cache
def run(scenario: int, poses: str, commands: str, rate: int) -> tuple[float, ...]:
    return inexact_times.run(SCENARIOS[scenario], poses, commands, rate, False, 14.0)


@pytest.mark.parametrize(
    ("poses", "commands", "rate", "scenario"),
    [
        ("late 20", "in time", 50, 1),  # never arrived, with 12 rad/s on a plant that has none
        ("steps 16", "in time", 50, 0),  # took nine times as long
        ("bunches", "in time", 50, 2),  # never arrived
        ("early 20", "in time", 200, 0),
        ("outliers", "in time", 50, 2),  # never arrived
        ("exact", "lost", 50, 2),  # took twice as long; the first command is lost
    ],
)
def test_loop_with_inexact_times_arrives_within_twice_the_exact_time(
    poses: str, commands: str, rate: int, scenario: int
) -> None:
    exact, found = run(scenario, "exact", "in time", rate), run(scenario, poses, commands, rate)
    assert found[0] <= 2.0 * exact[0]
    assert found[1] < exact[1] + 0.1, "not farther from the goal than at the start"
    if commands == "in time":
        assert found[2] < 1.0, "no momentum is believed [rad/s]"


@pytest.mark.parametrize("factor", [0.45, 1.75])
def test_robot_whose_rotors_have_another_inertia_by_far_arrives(factor: float) -> None:
    nominal, scenario = RobotParameters(), SCENARIOS[2]
    robot = replace(
        nominal, rotor_axial_inertia=factor * nominal.rotor_axial_inertia,
        rotor_transverse_inertia=factor * nominal.rotor_transverse_inertia,
    )
    assert abs(math.log(robot.lumped.input_gain / nominal.lumped.input_gain)) > 0.5
    simulator = Simulator(
        SimulatorSettings(initial_state=tuple(scenario.start)), robot,
        make_plant("rolling", robot, scenario.start),
    )
    controller = Controller(ControllerSettings(), nominal)
    found = run_closed_loop(simulator, controller, scenario.goal, 20.0)
    assert found.errors[-1] < 1e-2
    learnt = controller.estimator.plant.constants.input_gain
    assert learnt == pytest.approx(robot.lumped.input_gain, rel=1e-2)

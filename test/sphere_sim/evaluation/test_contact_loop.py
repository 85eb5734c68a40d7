# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop on the plant with contact: drives that lag, a slippery floor, weak drives."""


import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.metrics import state_errors, stay_below
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

pytest.importorskip("mujoco")

ROBOT = RobotParameters()
CASE = PAPER_CASES[3]
LAG = 1.0 / RigidBodySettings().for_robot(ROBOT).drive_bandwidth
FINAL_ERROR = 1e-3
"""Error at the end; on the ideal plant it is a thousand times less."""


def run(
    controller: Controller, settings: ControllerSettings, world: RigidBodySettings | None = None
) -> Trajectory:
    plant = RigidBodyPlant(ROBOT, CASE.start, world)
    simulator = Simulator(SimulatorSettings(initial_state=tuple(CASE.start)), ROBOT, plant)
    return run_closed_loop(simulator, controller, CASE.goal, 5.0, settings.control_period)


def settling_time(found: Trajectory) -> float:
    stay = stay_below(found.times, state_errors(found.states, CASE.goal))
    return float("inf") if stay is None else stay.since


@pytest.mark.parametrize("learning", [True, False])
def test_known_lag_of_the_drives_costs_no_time(learning: bool) -> None:
    # 1.57 s was seen on the ideal plant.
    settings = ControllerSettings(learning=learning, drive_lag=0.0 if learning else LAG)
    controller = Controller(settings, ROBOT)
    found = run(controller, settings)
    assert settling_time(found) < 2.0
    assert state_errors(found.states, CASE.goal)[-1] < FINAL_ERROR
    assert controller.estimator.plant.lag == pytest.approx(LAG, abs=5e-4)


def test_unknown_slippery_floor_costs_little_time() -> None:
    # 3.3 s were seen; with the full acceleration of the drives it does not arrive.
    settings = ControllerSettings()
    found = run(Controller(settings, ROBOT), settings, RigidBodySettings(friction=0.2))
    assert settling_time(found) < 4.5


@pytest.mark.parametrize("torque", [1.6, 2.4])
def test_unknown_weak_drives_cost_little_time(torque: float) -> None:
    # 2.9 and 2.1 s were seen; 11.1 and 5.1 s where their delay was taken for wrong constants,
    # for a lag or for momentum.
    settings = ControllerSettings()
    controller = Controller(settings, ROBOT)
    found = run(controller, settings, RigidBodySettings(torque_limit=torque))
    assert settling_time(found) < 3.5
    attained = torque / ROBOT.rotor_axial_inertia
    # The shell turns against its rotors, which attain a few per cent more relative to it.
    assert attained < controller.estimator.plant.acceleration < 1.1 * attained

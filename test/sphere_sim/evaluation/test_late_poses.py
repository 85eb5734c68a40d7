# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Poses that reach the controller late, with the time at which they were measured."""

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

CASE = PAPER_CASES[3]
PREDICTED_WITHIN = 1e-3
"""Error of the controller's prediction over the latency [mixed units]."""


def run(latency: float, duration: float = 3.0) -> Trajectory:
    robot = RobotParameters()
    simulator = Simulator(SimulatorSettings(initial_state=tuple(CASE.start)), robot)
    controller = Controller(ControllerSettings(pose_timeout=2.0), robot)
    return run_closed_loop(simulator, controller, CASE.goal, duration, 0.5, latency=latency)


@pytest.mark.parametrize("latency", [0.0, 0.05, 0.7])
def test_pose_age_is_the_latency_and_the_state_is_predicted(latency) -> None:
    trajectory = run(latency)
    for k, decision in enumerate(trajectory.decisions):
        assert decision.solved
        # Before the run the sphere is at rest, so that the first poses have the stamp 0.
        assert decision.pose_age == pytest.approx(min(latency, 0.5 * k), abs=1e-9)
        truth = trajectory.states[50 * k]
        assert np.linalg.norm(decision.state - truth) < PREDICTED_WITHIN

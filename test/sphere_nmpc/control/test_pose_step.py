# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A sphere that is carried, or whose simulator is reset, has not been pushed."""

import math

import numpy as np
import pytest

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Mode
from sphere_nmpc.control.pose_step import impossible_step
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import state_error
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
UPRIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
TICK = NANOSECONDS // 100


def shifted(way: float, turn: float = 0.0) -> np.ndarray:
    return np.array([way, 0.0, math.cos(turn / 2), math.sin(turn / 2), 0.0, 0.0])


@pytest.mark.parametrize(
    ("way", "turn", "elapsed", "noise"),
    [
        (0.02, 0.0, 0.001, 0.0),  # noise that was not told
        (0.0074, 0.0247, 0.01, 0.0),  # as fast as the rotors can
        (0.1, 0.33, 0.01, 0.0),  # ten times as fast, after a push
        (3.0, 1.0, 0.5, 0.0),  # poses were lost
        (0.6, 0.0, 0.01, 0.1),
    ],
)
def test_what_rolling_or_noise_explains_is_no_jump(way, turn, elapsed, noise) -> None:
    settings = ControllerSettings(pose_position_noise=noise)
    assert impossible_step(UPRIGHT, shifted(way, turn), elapsed, ROBOT, settings) == ""


def test_jump_is_described() -> None:
    text = impossible_step(UPRIGHT, shifted(2.0), 0.01, ROBOT, ControllerSettings())
    assert text.startswith("given a step of 2 m and 0 deg within 0.01 s, expected at most 0.1 m")
    assert "90 deg" in impossible_step(
        UPRIGHT, shifted(0.0, math.pi / 2), 0.01, ROBOT, ControllerSettings()
    )


@pytest.mark.parametrize("strategy", ["plan_keeping", "time_optimal"])
@pytest.mark.parametrize("after", [0.8, 2.0, 2.9])
def test_simulator_that_is_reset_on_the_way_is_taken_for_no_momentum(strategy, after) -> None:
    simulator = Simulator(SimulatorSettings(initial_state=tuple(UPRIGHT)), ROBOT)
    controller = Controller(ControllerSettings(strategy=strategy), ROBOT)
    period = round(controller._settings.control_period * NANOSECONDS)
    controller.set_goal(np.array([2.0, -1.0, 1.0, 0.0, 0.0, 0.0]))
    modes, largest = set(), 0.0
    for now in range(0, round((after + 8.0) * 100) * TICK, TICK):
        simulator.advance_to(now)
        if now == round(after * 100) * TICK:
            simulator.reset()
            controller.set_goal(UPRIGHT)
            modes.clear()
        controller.observe(simulator.time, simulator.plant.state)
        if now % period == 0:
            decision = controller.decide(simulator.time)
            hold = controller.commit(decision, simulator.time)
            if hold is not None:
                simulator.follower.follow_trajectory(hold)
            modes.add(decision.mode)
            largest = max(largest, float(np.max(np.abs(decision.drift.momentum))))
    assert controller.pose_jumps == 1
    assert modes == {Mode.POSE_JUMPED, Mode.TRACKING, Mode.AT_GOAL}
    assert largest < 1.0, "no momentum was ever there [rad/s]"
    assert state_error(simulator.plant.state, UPRIGHT) < 1e-2

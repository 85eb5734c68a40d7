# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops in which settings change on the way, or parameters are fitted by a worker."""

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from patience import PATIENCE

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.worker import process
from sphere_nmpc.worker.contract import Reply, Result, Task
from sphere_nmpc.worker.process import WorkerProcess
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.metrics import state_errors
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
CASE = PAPER_CASES[3]
DURATION, CHANGED_AT = 8.0, 1.0
TIME_OPTIMAL = ControllerSettings(strategy="time_optimal", planning_effort=60_000)
UNRELATED: dict[str, Any] = {"goal_tolerance": 0.009, "pose_timeout": 0.7}


class ChangedOnTheWay(Controller):
    """Controller whose settings change once on the way."""

    def __init__(self, settings: ControllerSettings, change: dict[str, Any]) -> None:
        super().__init__(settings, ROBOT)
        self._pending: ControllerSettings | None = replace(settings, **change)

    def decide(self, time: float, time_budget: float = float("inf")) -> Decision:
        if self._pending is not None and time >= CHANGED_AT:
            self.change(self._pending)
            self._pending = None
        return super().decide(time, time_budget)


class InStep:
    """Worker for simulated time, which passes faster than the process works: waits for it."""

    available = True

    def __init__(self, process: WorkerProcess) -> None:
        self._process = process

    def submit(self, task: Task[Result]) -> Reply[Result]:
        reply = self._process.submit(task)
        while reply.pending:
            time.sleep(1e-3)
            self._process.poll()
        assert not reply.error
        return reply

    def poll(self) -> None:
        """Do nothing: nothing is pending."""


def run(controller: Controller, settings: ControllerSettings, robot=ROBOT) -> Trajectory:
    world = SimulatorSettings(
        initial_state=tuple(CASE.start)
    )
    return run_closed_loop(
        Simulator(world, robot), controller, CASE.goal, DURATION, settings.control_period
    )


@pytest.mark.parametrize("strategy", ["time_optimal", "plan_keeping", "paper"])
def test_change_of_an_unrelated_setting_changes_no_plan(strategy: str) -> None:
    settings = replace(TIME_OPTIMAL, strategy=strategy)
    undisturbed = run(Controller(settings, ROBOT), settings)
    found = run(ChangedOnTheWay(settings, UNRELATED), settings)
    assert len(found.decisions) == len(undisturbed.decisions)
    for changed, kept in zip(found.decisions, undisturbed.decisions, strict=True):
        np.testing.assert_array_equal(changed.plan.hold.times, kept.plan.hold.times)
        np.testing.assert_array_equal(changed.plan.hold.speeds, kept.plan.hold.speeds)
    np.testing.assert_array_equal(found.states, undisturbed.states)


@pytest.mark.parametrize(
    "change",
    [{"planning_effort": 20_000, "learning": False}, {"drive_lag": 0.005},
     {"pose_position_noise": 1e-3, "pose_orientation_noise": 1e-3}],
    ids=lambda change: next(iter(change)),
)
def test_goal_is_reached_in_the_planned_time_though_a_setting_changes_on_the_way(
    change: dict[str, Any],
) -> None:
    found = run(ChangedOnTheWay(TIME_OPTIMAL, change), TIME_OPTIMAL)
    planned = found.decisions[0].plan.arrival
    assert planned < DURATION - 1.0
    assert np.max(state_errors(found.states, CASE.goal)[found.times > planned + 1.0]) < 1e-2
    assert all(decision.solved for decision in found.decisions)


def test_learning_and_searching_beside_the_loop_settles_as_well(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Results that are late by the clock of a busy machine are in time by the simulated one.
    monkeypatch.setattr(process, "_PATIENCE", PATIENCE)
    robot = perturbed(ROBOT, 0.05, np.random.default_rng(2))
    worker = WorkerProcess(print)
    try:
        controller = Controller(TIME_OPTIMAL, ROBOT, worker=InStep(worker))
        found = run(controller, TIME_OPTIMAL, robot)
    finally:
        worker.close()
    assert np.max(state_errors(found.states, CASE.goal)[found.times > 6.0]) < 1e-2
    learnt = controller.estimator.plant.constants.as_array()
    nominal, true = ROBOT.lumped.as_array(), robot.lumped.as_array()
    assert np.all(np.abs(learnt - true) < 0.2 * np.abs(nominal - true))

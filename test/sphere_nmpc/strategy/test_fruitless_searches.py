# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Searches that follow searches without an arrival."""

from dataclasses import replace

import numpy as np
import pytest
from robots import GIANT

from sphere_nmpc.model.state import Vector, as_state
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_nmpc.strategy.time_optimal.search_task import SearchResult, SearchTask
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
from sphere_nmpc.worker import process
from sphere_nmpc.worker.contract import Reply

# Short for this robot, whose turn of the shell takes 25 s: a plan has forty knots.
SETTINGS = ControllerSettings(sample_period=0.25).of(GIANT)
START: Vector = as_state(
    [0.84790488, 0.29017925, 0.19692412, -0.27732079, -0.44550596, -0.82815368]
)
GOAL: Vector = as_state(
    [1.47793416, -2.61861649, 0.02288625, 0.35419605, 0.7080808, -0.61044489]
)


def situation(time: float) -> Situation:
    return Situation(time, START, GOAL, np.zeros(2), GIANT.lumped)


def test_robot_with_many_knots_gets_a_plan_after_searches_without_an_arrival() -> None:
    strategy = TimeOptimalStrategy(SETTINGS, GIANT)
    statuses = [strategy.plan(situation(0.25 * k)).status for k in range(5)]
    assert statuses[0] is PlanStatus.RAMP_TO_REST
    assert statuses[-1] is PlanStatus.SOLVED


class FruitlessWorker:
    """Worker that keeps its tasks and finds no arrival."""

    available = True

    def __init__(self) -> None:
        self.tasks: list[SearchTask] = []

    def submit(self, task):
        self.tasks.append(task)
        return Reply(result=SearchResult(found_none=True), ready=True)

    def poll(self) -> None:
        pass


@pytest.mark.parametrize("speed", [0.0, 30.0])
def test_effort_and_longest_time_double_at_rest_up_to_a_limit(speed: float) -> None:
    worker = FruitlessWorker()
    strategy = TimeOptimalStrategy(SETTINGS, GIANT)
    strategy.search_beside(worker)
    for k in range(40):
        strategy.plan(replace(situation(0.25 * k), input_in_force=np.full(2, speed)))
    tasks = worker.tasks[:6]
    expected = (1, 2, 4, 8, 8, 8) if speed == 0.0 else (1, 1, 1, 1, 1, 1)
    assert tuple(task.effort // tasks[0].effort for task in tasks) == expected
    assert [task.longest / tasks[0].longest for task in tasks] == [*expected]


def test_longest_search_ends_before_the_worker_is_replaced() -> None:
    tuning = TimeOptimalSettings()
    assert tuning.largest_growth * tuning.longest_search < 0.6 * process._PATIENCE

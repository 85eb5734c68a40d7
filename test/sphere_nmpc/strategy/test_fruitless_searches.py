# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Searches that follow searches without an arrival."""

import dataclasses

import numpy as np
from robots import GIANT

from sphere_nmpc.model.state import Vector, as_state
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_nmpc.strategy.time_optimal.searches_beside import Purpose, SearchesBeside
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
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


class RecordingWorker:
    """Worker that keeps its tasks and never answers."""

    available = True

    def __init__(self) -> None:
        self.tasks = []

    def submit(self, task):
        self.tasks.append(task)
        return Reply()

    def poll(self) -> None:
        pass


def test_effort_and_longest_time_double_up_to_a_limit() -> None:
    tuning = dataclasses.replace(TimeOptimalSettings(), largest_growth=4.0)
    assert [tuning.growth(n) for n in (0, 1, 2, 3, 10_000)] == [1.0, 2.0, 4.0, 4.0, 4.0]
    worker, strategy = RecordingWorker(), TimeOptimalStrategy(SETTINGS, GIANT)
    beside = SearchesBeside(worker, tuning)
    for growth in (1.0, 2.0):
        beside.begin(Purpose.NEW, strategy._full, situation(0.0), 1000, growth)
    first, second = worker.tasks
    assert (second.effort, second.longest) == (2 * first.effort, 2.0 * first.longest)

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Delay and loss of poses follow from their stamps."""

import math

import numpy as np
import pytest

from sphere_nmpc.control.pose_link import PoseLink


def test_nothing_is_known_before_the_first_poses() -> None:
    assert math.isnan(PoseLink().delay) and math.isnan(PoseLink().loss)


def test_delay_is_the_mean_age_where_it_is_known() -> None:
    link = PoseLink()
    for time, age in ((0.0, 0.02), (0.1, math.nan), (0.2, 0.04)):
        link.received(time, age)
    assert link.delay == pytest.approx(0.03)


def test_gaps_between_stamps_are_lost_poses() -> None:
    link = PoseLink()
    for i in range(101):
        if i % 5 != 3:
            link.received(0.02 * i, 0.0)
    assert link.loss == pytest.approx(20 / 100)


def test_additional_poses_and_overtaken_ones_are_no_loss() -> None:
    link = PoseLink()
    for time in np.sort(np.concatenate((np.arange(0.0, 2.0, 0.02), np.arange(0.25, 2.0, 0.5)))):
        link.received(float(time), 0.0)
        link.received(float(time) - 0.01, 0.0)
    assert link.loss == 0.0


def test_jump_back_of_the_clock_begins_anew() -> None:
    link = PoseLink()
    for time in (7.0, 7.1, 7.2, 0.0, 0.1, 0.2):
        link.received(time, 0.0)
    assert link.loss == 0.0

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitors of measured poses: outliers, jumps, inexact stamps."""

import math

import numpy as np
import pytest

from sphere_nmpc.control.pose_stream import PoseGate
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.reporting.stamps import StampWatch
from sphere_nmpc.settings import ControllerSettings

ROBOT = RobotParameters()
START = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def shifted(way: float, turn: float = 0.0) -> np.ndarray:
    return np.array([way, 0.0, math.cos(turn / 2), math.sin(turn / 2), 0.0, 0.0])


@pytest.mark.parametrize(
    ("way", "turn", "elapsed", "noise"),
    [
        (0.02, 0.0, 0.001, 0.0),  # noise that was not told
        (0.07, 0.24, 0.0003, 0.0),  # at full speed for 0.1 s, but stamped in a bunch
        (0.1, 0.33, 0.01, 0.0),  # ten times as fast as the rotors can, after a push
        (3.0, 1.0, 0.5, 0.0),  # poses were lost
        (0.6, 0.0, 0.01, 0.1),
    ],
)
def test_what_rolling_or_noise_explains_is_no_jump(way, turn, elapsed, noise) -> None:
    settings, gate = ControllerSettings(pose_position_noise=noise), PoseGate(ROBOT)
    before = (0.0, START)
    assert gate.impossible_step(before, elapsed, shifted(way, turn), settings) == ""
    assert "given a step of " in gate.impossible_step(before, elapsed, shifted(9.0), settings)
    turned = shifted(0.0, math.pi / 2)
    assert " 90 deg " in gate.impossible_step(before, 0.01, turned, settings)


@pytest.mark.parametrize(
    ("poses", "found", "outliers", "jumps"),
    [
        ([shifted(5.0), shifted(0.005)], [Kind.POSE_LEFT_OUT, None], 1, 0),
        ([shifted(0.0, math.pi), shifted(0.005)], [Kind.POSE_LEFT_OUT, None], 1, 0),
        ([shifted(0.5, 0.2), shifted(0.005)], [Kind.POSE_LEFT_OUT, None], 1, 0),
        ([shifted(3.0), shifted(-4.0), shifted(7.0), START], [*3 * [Kind.POSE_LEFT_OUT], None],
         3, 0),
        ([shifted(2.0), shifted(2.0)], [Kind.POSE_LEFT_OUT, Kind.POSE_JUMPED], 0, 1),
    ],
    ids=["place", "turn", "both", "several in other places", "carried"],
)
def test_pose_elsewhere_is_left_out_until_a_second_one_is_there(
    poses, found, outliers, jumps
) -> None:
    gate, newest = PoseGate(ROBOT), (1.0, START)
    for k, (pose, kind) in enumerate(zip(poses, found, strict=True)):
        assert gate.check(1.01 + 0.01 * k, pose, newest, ControllerSettings()) is kind
    assert (gate.outliers, gate.jumps) == (outliers, jumps)
    assert ("it is left out" in gate.last_outlier) == bool(outliers)
    assert ("given a step of 2 m" in gate.last_jump) == bool(jumps)


@pytest.mark.parametrize(
    ("stamps", "deviation", "moves", "told"),
    [
        (np.arange(0.0, 2.0, 0.02), 0.0, True, ""),
        (np.arange(0.0, 0.1, 0.02), 0.0, True, ""),
        (5.0 + 0.05 * np.floor(np.arange(0.0, 2.0, 0.01) / 0.05), 0.0, True,
         "clock that stamps them coarse"),
        ((0.1 * np.arange(1, 20)[:, None] + 3e-4 * np.arange(5)).ravel(), 0.0, True,
         "not where bunches of them are passed on"),
        ([*np.arange(0.0, 1.0, 0.02), *np.full(50, 1.0)], 0.0, False, ""),
        (np.arange(0.0, 2.0, 0.02), 1e-3, True, ""),
        (np.arange(0.0, 2.0, 0.02), 0.01, True, "off by about 10 ms"),
    ],
    ids=["exact", "few", "coarse", "bunches", "paused simulator", "within tolerance", "by motion"],
)
def test_stamps_are_told_for_what_they_are(stamps, deviation, moves, told) -> None:
    watch = StampWatch()
    for time in (0.0, 3.5):
        watch.moved(time, deviation)
    for k, stamp in enumerate(stamps):
        watch.received(stamp, shifted(0.01 * k * moves))
    found = watch.fault()
    assert (found is not None) == bool(told)
    assert found is None or told in found.text


def test_stamps_that_look_late_for_a_moment_are_not_told() -> None:
    watch = StampWatch()
    for time, deviation in ((1.0, 0.03), (1.8, 0.03), (2.0, 0.0), (4.9, 0.03), (0.5, 0.03)):
        watch.moved(time, deviation)
        assert watch.fault() is None, time
    watch.moved(3.6, 0.03)
    assert watch.fault() is not None

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the monitors of measured poses: outliers, jumps, inexact stamps."""

import math

import numpy as np
import pytest

from sphere_nmpc.conditions import Kind
from sphere_nmpc.control.pose_stream import PoseGate, StampWatch
from sphere_nmpc.model.parameters import RobotParameters
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


@pytest.mark.parametrize("outlier", [shifted(5.0), shifted(0.0, math.pi), shifted(0.5, 0.2)])
def test_single_pose_elsewhere_is_left_out_and_told(outlier) -> None:
    gate, settings = PoseGate(ROBOT), ControllerSettings()
    newest = (1.0, START)
    assert gate.check(1.01, outlier, newest, settings) is Kind.POSE_LEFT_OUT
    assert gate.check(1.02, shifted(0.005), newest, settings) is None
    assert gate.check(1.03, shifted(0.01), (1.02, shifted(0.005)), settings) is None
    assert (gate.outliers, gate.jumps) == (1, 0)
    assert "it is left out" in gate.last_outlier


def test_several_poses_in_other_places_are_left_out() -> None:
    gate, settings = PoseGate(ROBOT), ControllerSettings()
    newest = (1.0, START)
    for k, away in enumerate((3.0, -4.0, 7.0)):
        assert gate.check(1.01 + 0.01 * k, shifted(away), newest, settings) is Kind.POSE_LEFT_OUT
    assert gate.check(1.05, START, newest, settings) is None
    assert (gate.outliers, gate.jumps) == (3, 0)


def test_sphere_that_was_carried_is_noticed_by_the_second_pose_there() -> None:
    gate, settings = PoseGate(ROBOT), ControllerSettings()
    newest = (1.0, START)
    assert gate.check(1.01, shifted(2.0), newest, settings) is Kind.POSE_LEFT_OUT
    assert gate.check(1.02, shifted(2.0), newest, settings) is Kind.POSE_JUMPED
    assert (gate.outliers, gate.jumps) == (0, 1)
    assert "given a step of 2 m" in gate.last_jump


def stamps_of(stamps, deviation: float = 0.0, moves: bool = True) -> str:
    watch = StampWatch()
    watch.deviation = deviation
    for k, stamp in enumerate(stamps):
        watch.received(stamp, shifted(0.01 * k * moves))
    found = watch.fault()
    return "" if found is None else found.text


@pytest.mark.parametrize(
    ("stamps", "told"),
    [
        (np.arange(0.0, 2.0, 0.02), ""),
        (np.arange(0.0, 0.1, 0.02), ""),
        (5.0 + 0.05 * np.floor(np.arange(0.0, 2.0, 0.01) / 0.05), "clock that stamps them coarse"),
        (
            (0.1 * np.arange(1, 20)[:, None] + 3e-4 * np.arange(5)).ravel(),
            "not where bunches of them are passed on",
        ),
    ],
)
def test_stamps_are_told_for_what_they_are(stamps, told) -> None:
    found = stamps_of(stamps)
    assert told in found if told else found == ""


def test_repeated_pose_of_a_simulator_that_is_paused_is_no_coarse_stamp() -> None:
    assert stamps_of([*np.arange(0.0, 1.0, 0.02), *np.full(50, 1.0)], moves=False) == ""


def test_stamps_that_only_the_motion_shows_to_be_wrong_are_told() -> None:
    assert "off by about 10 ms" in stamps_of(np.arange(0.0, 2.0, 0.02), 0.01)
    assert stamps_of(np.arange(0.0, 2.0, 0.02), 1e-3) == ""

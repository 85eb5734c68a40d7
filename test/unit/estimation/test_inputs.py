# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""History of the rotor speeds sent, and rotors that fall behind them, late or weak."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.estimation.motion import Interval
from sphere_nmpc.estimation.rotor_history import RotorHistory
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import Vector, make_state
from sphere_nmpc.model.torque import torques
from sphere_nmpc.solver.roll_out import roll_out

LIMIT, STEP = 300.0, 0.05
CONSTANTS = RobotParameters().lumped.as_array()


def ramp(start: float, first: list[float], last: list[float], length: float) -> FirstOrderHold:
    return FirstOrderHold(np.array([start, start + length]), np.array([first, last], dtype=float))


def at(times: Vector, durations: Vector, speeds: Vector, start: float = 0.0) -> Vector:
    """Return the speeds, (n, 2), at times of straight pieces of given durations."""
    ends = start + np.concatenate(([0.0], np.cumsum(durations)))
    return np.column_stack([np.interp(times, ends, column) for column in speeds.T])


def test_each_hold_lasts_until_the_next_takes_effect_and_an_earlier_one_replaces_later_ones():
    sent = RotorHistory()
    sent.record(ramp(1.0, [0, 0], [10, 20], 1.0))
    sent.record(ramp(1.5, [5, 10], [0, 0], 0.5))
    np.testing.assert_allclose([sent.at(t)[0] for t in (0.5, 1.25, 1.75, 9.0)], [0, 2.5, 2.5, 0])
    sent.record(FirstOrderHold.constant(1.2, np.array([1.0, 1.0])))
    np.testing.assert_array_equal(sent.at(3.0), [1.0, 1.0])
    sent.record(ramp(4.0, [1, 1], [0, 0], 1.0))
    assert sent.moves_after(4.9) and not sent.moves_after(5.0)
    sent.clear()
    assert not sent.moves_after(0.0)


def test_corrections_are_believed_once_speeds_followed_a_command_or_poses_show_them() -> None:
    sent, limit = RotorHistory(), 25.0

    def measure(time: float, commanded: float, measured: float) -> None:
        sent.record(FirstOrderHold.constant(time, np.full(2, commanded)))
        sent.observe(time + 0.1, np.full(2, measured))

    def belief() -> tuple[float, bool]:
        return float(sent.at(1.15)[0]), sent.contradicted

    measure(1.0, 3.0, 0.0)
    assert belief() == (3.0, False), "not yet"
    measure(1.2, 5.0, 5.0)
    assert belief() == (0.0, False)
    sent.judge(1.0, 1e6, limit)
    assert belief() == (3.0, True)
    measure(1.4, 7.0, 7.0)
    assert belief() == (3.0, True), "poses count for more"
    sent.judge(100.0, 1.0, limit)
    assert belief() == (3.0, True), "less likely, but not excluded"
    sent.judge(100.0, 1.0, limit)
    assert belief() == (3.0, False), "as likely as not"
    sent.judge(1e6, 1.0, limit)
    assert belief() == (0.0, False)
    for _ in range(40):
        sent.judge(1e3, 1e3, limit)  # pushed: neither explains it
    assert belief() == (0.0, False)


def test_contradiction_ends_after_motions_for_which_both_are_the_same() -> None:
    sent = RotorHistory()
    sent.judge(0.0, 1e6, 25.0)
    for _ in range(17):
        sent.judge(0.0, 0.0, 25.0)
    assert sent.contradicted
    for _ in range(2):
        sent.judge(0.0, 0.0, 25.0)
    assert not sent.contradicted


def test_pieces_are_the_speeds_in_force() -> None:
    rng, sent, now = np.random.default_rng(5), RotorHistory(), 0.0
    for _ in range(40):
        now += float(rng.choice([0.002, 0.01, 0.25]))
        # Some holds have knots before the next one begins.
        times = now + np.concatenate(([0.0], np.cumsum(rng.uniform(1e-3, 0.02, 3))))
        speeds = np.vstack((sent.at(now), rng.uniform(-100.0, 100.0, (3, 2))))
        sent.record(FirstOrderHold(times, speeds))
    for start, end in ((-0.5, 0.0), (-0.5, now), (0.3 * now, 0.31 * now), (0.5 * now, now + 1.0)):
        durations, speeds = sent.pieces(start, end)
        assert start + np.sum(durations) == pytest.approx(end) and np.all(durations > 0.0)
        times = rng.uniform(start, end, 50)
        expected = [sent.at(t) for t in times.tolist()]
        np.testing.assert_allclose(at(times, durations, speeds, start), expected, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_rotors_that_fall_behind_catch_up_with_all_of_the_torque(seed: int) -> None:
    rng, lead = np.random.default_rng(seed), 0.4
    start = make_state([0, 0], random_quaternion(rng))
    durations, inputs = rng.uniform(0.2, 0.3, 8), rng.uniform(-70.0, 70.0, (9, 2))
    raw = Interval(np.array([1.0]), np.zeros((1, 6)), durations, inputs, lead)
    before, sent, _ = replace(raw, after=np.array([lead]), lead=0.0).window(0.0)
    there = roll_out(start, sent, before, CONSTANTS)[-1]
    driven = raw.driven(LIMIT, there, CONSTANTS, STEP)
    hold = FirstOrderHold(np.append(0.0, np.cumsum(driven.durations)), driven.inputs)
    states = roll_out(start, hold.speeds, hold.durations, CONSTANTS)
    found = np.abs(np.mean(torques(states, hold, RobotParameters().lumped, 1.0), axis=0))
    behind = np.abs(at(hold.times, durations, inputs) - hold.speeds) > 1e-6
    assert behind.any() and not behind.all()
    is_behind = behind[1:] & behind[:-1]
    # The orientations are those of the speeds that were sent.
    np.testing.assert_allclose(found[is_behind], LIMIT, rtol=0.02)
    assert np.max(found) < 1.02 * LIMIT
    assert raw.driven(1.2 * raw.steepest, there, CONSTANTS, STEP) is raw


@pytest.mark.parametrize("lag", [0.0, 0.04])
def test_window_is_shifted_by_the_lag_and_ends_at_the_poses(lag: float) -> None:
    durations, inputs = np.array([0.2, 0.3, 0.5]), np.array([[0.0, 1], [2, 3], [8, 0], [3, 5.0]])
    after = np.array([0.1, 0.35, 0.6])
    pieces, speeds, poses = Interval(after, np.zeros((3, 6)), durations, inputs, 0.4).window(lag)
    times = np.concatenate(([0.0], np.cumsum(pieces)))
    np.testing.assert_allclose(times[poses], after)
    np.testing.assert_allclose(speeds, at(0.4 - lag + times, durations, inputs), atol=1e-12)
    assert 0.1 + lag in np.round(times, 12), "the knot within"

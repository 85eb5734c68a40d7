# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulated time passes with the real-time factor that is set, or slower where it must."""

import math

import pytest

from sphere_sim.world.clock import SimulatedClock

MS = 1_000_000
POSE, SAMPLE = 10 * MS, 500 * MS


def keeper(**settings) -> SimulatedClock:
    made = SimulatedClock(POSE, SAMPLE, **settings)
    made.restart(0, 0.0)
    return made


def run(made: SimulatedClock, until: int, wall: float, cost: float = 0.0) -> float:
    """Advance as a node would, each instant at a price of `cost` [s]; return the wall time."""
    now = 0
    while now < until:
        wall += made.wait(now, wall)
        now = made.upcoming(now)
        made.advanced(now, wall)
        wall += cost
    return wall


def test_instants_are_those_of_poses_and_samples() -> None:
    made = SimulatedClock(3 * MS, SAMPLE)
    assert made.upcoming(0) == 3 * MS
    assert made.upcoming(498 * MS) == SAMPLE
    assert made.upcoming(SAMPLE) == 501 * MS


@pytest.mark.parametrize("factor", [0.5, 1.0, 20.0])
def test_pace_is_kept(factor) -> None:
    wall = run(keeper(real_time_factor=factor), 2000 * MS, 0.0)
    assert wall == pytest.approx(2.0 / factor)


def test_factor_zero_never_waits() -> None:
    assert run(keeper(real_time_factor=0.0), 2000 * MS, 5.0) == 5.0


def test_small_lateness_is_made_up_without_a_burst() -> None:
    made = keeper()
    made.advanced(POSE, 0.050)
    assert made.wait(POSE, 0.050) == pytest.approx(0.005)
    now, wall = POSE, 0.050
    while now < 20 * POSE:
        wall += made.wait(now, wall)
        now += POSE
        made.advanced(now, wall)
    assert wall == pytest.approx(0.200)
    assert made.lost == 0.0


def test_time_lost_to_a_slow_machine_is_given_up() -> None:
    made = keeper()
    wall = run(made, 1000 * MS, 0.0, cost=0.020)
    assert wall == pytest.approx(2.0, rel=0.05)
    assert made.lost == pytest.approx(1.0, abs=0.15)
    assert made.achieved(1000 * MS, wall) == pytest.approx(0.5, rel=0.05)


def test_pause_stops_time_and_leaves_no_lateness() -> None:
    made = keeper()
    made.pause()
    assert made.wait(0, 100.0) == math.inf
    made.resume(0, 100.0)
    assert made.wait(0, 100.0) == pytest.approx(0.01)


def test_step_runs_to_the_next_sample_and_pauses() -> None:
    made = keeper(paused=True, real_time_factor=0.0)
    assert made.step(0, 0.0) == SAMPLE
    now = 0
    while made.wait(now, 1.0) == 0.0:
        now = made.upcoming(now)
        made.advanced(now, 1.0)
    assert now == SAMPLE
    assert made.paused


def test_lockstep_waits_for_the_answer_to_its_instant() -> None:
    made = keeper(lockstep=True, real_time_factor=0.0)
    made.resume(0, 0.0)
    assert made.wait(0, 1.0) == pytest.approx(4.0)
    made.command_received(SAMPLE, 1.0)
    assert made.wait(0, 1.0) > 0.0
    made.command_received(0, 1.0)
    assert made.wait(0, 1.0) == 0.0
    made.advanced(POSE, 1.0)
    assert made.wait(POSE, 1.0) == 0.0
    made.advanced(SAMPLE, 1.0)
    assert made.awaited == SAMPLE


def test_lockstep_gives_up_after_its_timeout() -> None:
    made = keeper(lockstep=True, lockstep_timeout=2.0, real_time_factor=0.0)
    made.resume(0, 0.0)
    assert made.wait(0, 2.0) == 0.0
    assert made.timeouts == 1


def test_lockstep_without_partner_waits_for_ever() -> None:
    made = keeper(lockstep=True, lockstep_timeout=2.0)
    made.resume(0, 0.0)
    assert made.wait(0, 100.0, controller_found=False) == math.inf
    assert made.wait(0, 200.0) == pytest.approx(2.0)
    assert made.timeouts == 0


def test_lockstep_asks_again_after_a_pause() -> None:
    made = keeper(lockstep=True, paused=True)
    made.command_received(0, 0.0)
    made.resume(0, 5.0)
    assert made.awaited == 0


def test_world_on_the_system_clock_keeps_up_after_a_standstill() -> None:
    keeper = SimulatedClock(10 * MS, 250 * MS, keeps_up=True)
    keeper.restart(0, 100.0)
    assert keeper.due(0, 100.0) == 10 * MS
    assert keeper.due(10 * MS, 103.456) == 3450 * MS, "the newest instant that has passed"
    keeper.advanced(3450 * MS, 103.457)
    assert keeper.lost == 0.0
    assert keeper.wait(3450 * MS, 103.457) == pytest.approx(0.003)


def test_simulated_time_is_advanced_one_instant_at_a_time() -> None:
    keeper = SimulatedClock(10 * MS, 250 * MS)
    keeper.restart(0, 100.0)
    assert keeper.due(10 * MS, 103.456) == 20 * MS

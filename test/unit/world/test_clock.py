# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulated time passes with the real-time factor that is set, or slower where it must."""

import math

import pytest

from sphere_sim.world.clock import SimulatedClock

MS = 1_000_000
POSE, SAMPLE = 10 * MS, 500 * MS


def clock_at_zero(**settings) -> SimulatedClock:
    clock = SimulatedClock(POSE, SAMPLE, **settings)
    clock.restart(0, 0.0)
    return clock


def run(clock: SimulatedClock, until: int, wall: float, cost: float = 0.0) -> float:
    """Advance as a node would, each instant at a price of `cost` [s]; return the wall time."""
    now = 0
    while now < until:
        wall += clock.wait(now, wall)
        now = clock.upcoming(now)
        clock.advanced(now, wall)
        wall += cost
    return wall


@pytest.mark.parametrize(("factor", "wall"), [(0.5, 4.0), (1.0, 2.0), (20.0, 0.1), (0.0, 0.0)])
def test_pace_is_kept(factor, wall) -> None:
    assert run(clock_at_zero(real_time_factor=factor), 2000 * MS, 0.0) == pytest.approx(wall)
    changed = clock_at_zero()
    changed.set_pace(factor, 0, 0.0)
    assert run(changed, 2000 * MS, 0.0) == pytest.approx(wall)


def test_time_lost_to_a_slow_machine_is_given_up() -> None:
    clock = clock_at_zero()
    wall = run(clock, 1000 * MS, 0.0, cost=0.020)
    assert wall == pytest.approx(2.0, rel=0.05)
    assert clock.lost == pytest.approx(1.0, abs=0.15)
    assert clock.achieved(1000 * MS, wall) == pytest.approx(0.5, rel=0.05)


def test_lockstep_steps_to_a_sample_and_waits_for_the_command_of_its_instant() -> None:
    stepped, clock = (
        clock_at_zero(lockstep=True, real_time_factor=0.0, paused=True) for _ in range(2)
    )
    assert stepped.step(0, 0.0) == SAMPLE
    stepped.command_received(0, 0.0)
    stepped.set_sample_period(400 * MS, 0.0)
    now = 0
    while stepped.wait(now, 1.0) == 0.0:
        now = stepped.upcoming(now)
        stepped.advanced(now, 1.0)
    assert now == 400 * MS and stepped.paused
    clock.command_received(0, 0.0)
    clock.resume(0, 0.0)
    assert clock.wait(0, 1.0) == pytest.approx(4.0), "for one sent after the pause"
    clock.command_received(SAMPLE, 1.0)
    assert clock.wait(0, 1.0) > 0.0
    clock.command_received(0, 1.0)
    assert clock.wait(0, 1.0) == 0.0
    clock.advanced(POSE, 1.0)
    assert clock.wait(POSE, 1.0) == 0.0
    clock.advanced(SAMPLE, 1.0)
    assert clock.awaited == SAMPLE


def test_wait_in_lockstep_ends_after_its_timeout_but_never_without_a_controller() -> None:
    clock = clock_at_zero(lockstep=True, lockstep_timeout=2.0)
    clock.resume(0, 0.0)
    assert clock.wait(0, 100.0, controller_found=False) == math.inf
    assert clock.wait(0, 200.0) == pytest.approx(2.0) and clock.timeouts == 0
    clock.wait(0, 202.0)
    assert clock.timeouts == 1 and clock.awaited is None


def test_simulation_on_the_system_clock_catches_up_after_a_standstill() -> None:
    clocks = [SimulatedClock(10 * MS, 250 * MS, keeps_up=keeps_up) for keeps_up in (True, False)]
    for clock in clocks:
        clock.restart(0, 100.0)
        assert clock.due(0, 100.0) == 10 * MS
    assert clocks[1].due(10 * MS, 103.456) == 20 * MS, "one instant at a time"
    clock = clocks[0]
    assert clock.due(10 * MS, 103.456) == 3450 * MS, "the newest instant that has passed"
    clock.advanced(3450 * MS, 103.457)
    assert clock.lost == 0.0
    assert clock.wait(3450 * MS, 103.457) == pytest.approx(0.003)

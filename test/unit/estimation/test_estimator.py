# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The estimator behind the contract: live changes, learning by a worker, also by a slow one."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from delayed_worker import DelayedWorker
from motions import LUMPED, START, predicted, random_ramps

from sphere_nmpc.estimation.estimator import Estimator
from sphere_nmpc.estimation.motion import Interval
from sphere_nmpc.estimation.moving_horizon import MovingHorizon
from sphere_nmpc.estimation.posterior import Posterior
from sphere_nmpc.estimation.rotor_history import RotorHistory
from sphere_nmpc.model.plant import PlantEstimate
from sphere_nmpc.model.state import POSE, Vector, without_momentum
from sphere_nmpc.settings import ControllerSettings

EXACT = ControllerSettings()
NOISY = ControllerSettings(pose_position_noise=1e-4, pose_orientation_noise=2e-4)
BOTH = pytest.mark.parametrize("settings", [EXACT, NOISY], ids=["exact", "noisy"])
PERIOD, DURATION, LATER = 0.25, 4.0, 6.0
GAIN, LAG = 1.1, 0.01
SENT = random_ramps(np.random.default_rng(1), LATER + 1.0)


class Clock:
    """A clock that is set by hand."""

    time = 0.0

    def __call__(self) -> float:
        return self.time


@cache
def poses(spacing: float) -> list[tuple[float, Vector]]:
    """Return times and poses of a robot with a larger input gain and a lag."""
    constants = LUMPED.as_array() * np.array([1.0, GAIN, 1.0, 1.0])
    found, state = [], without_momentum(START)
    for time in np.arange(0.0, LATER + 1e-9, spacing).tolist():
        state = predicted(SENT, state, time - spacing - LAG, time - LAG, constants)
        found.append((time, state[POSE]))
    return found


def track(
    estimator: Estimator, until: float = DURATION, clock: Clock | None = None,
    poses_per_tick: int = 1,
) -> None:
    """Pass the poses that are newer than the newest, and estimate in each period."""
    newest = estimator.newest
    for number, (time, pose) in enumerate(poses(PERIOD / poses_per_tick)):
        if time > until + 1e-9:
            break
        if clock is not None:
            clock.time = time
        if newest is None or time > newest[0]:
            assert estimator.observe(time, pose)
            assert number % poses_per_tick or estimator.estimate(time) is not None


def tracked(settings: ControllerSettings, **options: DelayedWorker) -> Estimator:
    estimator = Estimator(settings, LUMPED, SENT, **options)
    track(estimator)
    return estimator


def gain(estimator: Estimator) -> float:
    return estimator.plant.constants.input_gain / LUMPED.input_gain


def state_at(estimator: Estimator, time: float) -> Vector:
    estimate = estimator.estimate(time)
    assert estimate is not None
    return estimate.state


@BOTH
def test_parameters_are_estimated_and_kept_whatever_changes(settings: ControllerSettings) -> None:
    found = Estimator(settings, LUMPED, SENT)
    assert found.newest is None and found.estimate(0.0) is None
    assert found.plant.constants == LUMPED and found.plant.lag == 0.0
    track(found)
    assert gain(found) == pytest.approx(GAIN, rel=1e-3)
    assert found.plant.lag == pytest.approx(LAG, rel=0.1)
    before, state = found.plant, state_at(found, DURATION + 0.1)

    def is_kept() -> bool:
        return (found.plant.constants, found.plant.lag) == (before.constants, before.lag)

    found.change(replace(settings, learning=False))
    assert found.plant.constants == LUMPED and found.plant.lag == 0.0
    found.change(settings)
    assert is_kept()
    newest = found.newest
    found.change(NOISY if settings is EXACT else EXACT)
    assert is_kept() and found.newest == newest
    np.testing.assert_allclose(state_at(found, DURATION + 0.1), state, atol=5e-4)
    found.forget()
    assert found.newest is None and found.estimate(DURATION) is None and is_kept()


@BOTH
def test_changed_drive_lag_restarts_the_lag_and_keeps_the_constants(
    settings: ControllerSettings,
) -> None:
    found = tracked(settings)
    constants = found.plant.constants
    found.change(replace(settings, drive_lag=0.03))
    assert found.plant.lag == pytest.approx(0.03)
    assert found.plant.constants == constants
    known = Estimator(replace(settings, learning=False), LUMPED, SENT)
    known.change(replace(settings, learning=False, drive_lag=0.03))
    assert known.plant.constants == LUMPED and known.plant.lag == 0.03
    track(found, LATER)
    assert found.plant.lag == pytest.approx(LAG, rel=0.1), "estimated again from the new prior"


def same(first: PlantEstimate, second: PlantEstimate) -> bool:
    assert first.deviations is not None and second.deviations is not None
    return (first.constants, first.lag, first.noise) == (
        second.constants, second.lag, second.noise
    ) and np.array_equal(first.deviations, second.deviations)


@BOTH
@pytest.mark.parametrize("delay", [0.0, 0.3], ids=["at once", "one transition later"])
def test_learning_by_a_worker_gives_the_estimate_of_learning_in_line(
    settings: ControllerSettings, delay: float
) -> None:
    in_line, clock = tracked(settings), Clock()
    found = Estimator(settings, LUMPED, SENT, worker=DelayedWorker(clock, delay))
    track(found, clock=clock)
    clock.time += delay
    assert same(found.plant, in_line.plant)
    first, again = (found.estimate(DURATION + ahead) for ahead in (0.1, 0.2))
    second = in_line.estimate(DURATION + 0.1)
    np.testing.assert_array_equal(first.state, second.state)
    # Until there is another result, what it tells is the same object.
    assert again.plant is first.plant and again.disturbance is first.disturbance


def test_newest_pose_of_a_bunch_takes_the_place_of_the_others() -> None:
    bunched, single = (Estimator(NOISY, LUMPED, RotorHistory()) for _ in range(2))
    for time in np.arange(0.0, 2.0, 0.05).tolist():
        for delay in (0.0, 0.002, 0.003) if time > 0.1 else (0.003,):
            assert bunched.observe(time + delay, START)
        assert single.observe(time + 0.003, START)
    first, second = bunched.estimate(2.0), single.estimate(2.0)
    np.testing.assert_array_equal(first.covariance, second.covariance)


def test_worker_that_has_lost_what_was_learnt_goes_on_from_the_constants_known() -> None:
    worker = DelayedWorker(Clock(), 0.0)
    found = tracked(EXACT, worker=worker)
    before = found.plant
    worker.lose()
    track(found, DURATION + PERIOD)
    assert found.plant.constants.as_array() == pytest.approx(before.constants.as_array(), rel=1e-4)
    track(found, LATER)
    assert not same(found.plant, before)
    assert gain(found) == pytest.approx(GAIN, rel=1e-3)


@BOTH
def test_intervals_keep_up_with_poses_that_are_faster_than_the_control_loop(
    settings: ControllerSettings,
) -> None:
    clock = Clock()
    worker = DelayedWorker(clock, 0.0)
    track(Estimator(settings, LUMPED, SENT, worker=worker), clock=clock, poses_per_tick=5)
    spacing = PERIOD / 5
    # Ends of intervals of 0.2 s, of which the last tick leaves less than one.
    assert DURATION - worker.tasks[-1].time < 0.2 + spacing
    spacings = np.diff([task.time for task in worker.tasks])
    # Of exact poses they are shorter as long as the constants are not known.
    known = np.flatnonzero(spacings > 0.15)[0]
    assert spacings[:known] == pytest.approx(0.1) and spacings[known:] == pytest.approx(0.2)
    assert (known > 0) == (settings is EXACT)


@BOTH
def test_worker_that_is_busy_for_long_gets_few_tasks_and_then_longer_intervals(
    settings: ControllerSettings,
) -> None:
    clock = Clock()
    worker = DelayedWorker(clock, DURATION + 0.1)
    found = Estimator(settings, LUMPED, SENT, worker=worker)
    track(found, clock=clock, poses_per_tick=5)
    assert len(worker.tasks) == 4
    worker.delay, worker.busy = 0.0, True
    track(found, DURATION + 1.0, clock, poses_per_tick=5)
    worker.busy = False
    track(found, LATER, clock, poses_per_tick=5)
    assert len(worker.tasks) > 8
    assert max(np.diff([task.time for task in worker.tasks])) < 1.5
    assert gain(found) == pytest.approx(GAIN, rel=1e-3)


def test_worker_that_refuses_the_beginning_is_asked_again() -> None:
    worker = DelayedWorker(Clock(), 0.0)
    worker.busy = True
    found = Estimator(EXACT, LUMPED, SENT, worker=worker)
    track(found, 1.0)
    assert worker.tasks == []
    worker.busy = False
    track(found)
    assert gain(found) == pytest.approx(GAIN, rel=1e-3)


def not_finite(result: Posterior) -> Posterior:
    return replace(result, common=np.full(9, np.nan))


def not_positive(result: Posterior) -> Posterior:
    return replace(result, covariance=result.covariance - np.diag(np.full(19, 1e-3)))


@BOTH
@pytest.mark.parametrize("spoiled", [not_finite, not_positive])
def test_estimate_that_is_not_a_distribution_is_told_once_and_begins_anew(
    settings: ControllerSettings, spoiled: Callable[[Posterior], Posterior],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = tracked(settings)
    observe, spoilt = MovingHorizon.observe, list[float]()

    def spoil(horizon: MovingHorizon, interval: Interval, time: float) -> None:
        observe(horizon, interval, time)
        if not spoilt:
            spoilt.append(time)
            horizon.result = spoiled(horizon.result)

    monkeypatch.setattr(MovingHorizon, "observe", spoil)
    with pytest.raises(ArithmeticError, match="not a distribution, and begins anew"):
        track(made, LATER)
    assert spoilt and gain(made) == 1.0
    track(made, LATER)
    assert gain(made) == pytest.approx(GAIN, abs=0.02)


@pytest.mark.parametrize("learning", [True, False])
@pytest.mark.parametrize("radius", [0.5, 0.9, 1.15, 2.0])
def test_robot_that_the_motion_shows_to_be_another_is_told(radius: float, learning: bool) -> None:
    given = replace(LUMPED, shell_radius=LUMPED.shell_radius / radius)
    estimator = Estimator(replace(EXACT, learning=learning), given, SENT)
    track(estimator)
    condition = estimator.condition
    if 0.8 < radius < 1.2:
        assert condition is None
    else:
        assert condition is not None and condition.text.startswith(
            f"given shell_radius = {given.shell_radius:.3g} m, and the motion shows 0.3 m, "
        )

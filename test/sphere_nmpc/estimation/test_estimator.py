# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Both estimators behind the contract: live changes, learning by a worker."""

from dataclasses import replace

import numpy as np
import pytest
from delayed_worker import DelayedWorker

from sphere_nmpc.estimation.estimate import PlantEstimate
from sphere_nmpc.estimation.estimator import Estimator
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, Vector, as_state, without_momentum
from sphere_nmpc.settings import ControllerSettings

LUMPED = RobotParameters().lumped
START = as_state([0.3, -0.2, 0.5, 0.5, 0.5, 0.5])
EXACT = ControllerSettings()
NOISY = ControllerSettings(pose_position_noise=1e-4, pose_orientation_noise=2e-4)
BOTH = pytest.mark.parametrize("settings", [EXACT, NOISY], ids=["exact", "noisy"])
PERIOD, DURATION, LATER = 0.25, 4.0, 6.0
GAIN, LAG = 1.1, 0.01


@pytest.fixture
def sent() -> SentInputs:
    times = np.arange(0.0, LATER + 1.0, 0.5)
    speeds = np.random.default_rng(1).uniform(-100.0, 100.0, (times.size, 2))
    speeds[0] = 0.0
    made = SentInputs()
    made.record(FirstOrderHold(times, speeds))
    return made


def track(estimator: Estimator, sent: SentInputs, until: float = DURATION) -> None:
    """Pass the poses of a robot with a larger input gain and a lag; estimate at each of them."""
    constants = LUMPED.as_array() * np.array([1.0, GAIN, 1.0, 1.0])
    state, newest = without_momentum(START), estimator.newest
    for time in np.arange(0.0, until + 1e-9, PERIOD).tolist():
        state = sent.predict(state, time - PERIOD - LAG, time - LAG, constants, 0.02)
        if newest is None or time > newest[0]:
            assert estimator.observe(time, state[POSE])
            assert estimator.estimate(time) is not None


def tracked(settings: ControllerSettings, sent: SentInputs) -> Estimator:
    estimator = Estimator(settings, LUMPED, sent)
    track(estimator, sent)
    return estimator


def gain(estimator: Estimator) -> float:
    return estimator.plant.constants.input_gain / LUMPED.input_gain


def state_at(estimator: Estimator, time: float) -> Vector:
    estimate = estimator.estimate(time)
    assert estimate is not None
    return estimate.state


@BOTH
def test_constants_and_lag_are_estimated_and_kept(
    settings: ControllerSettings, sent: SentInputs
) -> None:
    found = Estimator(settings, LUMPED, sent)
    assert found.newest is None and found.estimate(0.0) is None
    assert found.plant.constants == LUMPED and found.plant.lag == 0.0
    track(found, sent)
    assert gain(found) == pytest.approx(GAIN, rel=1e-3)
    assert found.plant.lag == pytest.approx(LAG, rel=0.1)
    before, state = found.plant, state_at(found, DURATION)
    # Settings of no concern change nothing.
    found.change(replace(settings, goal_tolerance=0.1, planning_effort=1000, pose_timeout=1.0))
    assert found.plant.noise == before.noise
    np.testing.assert_array_equal(state_at(found, DURATION), state)
    found.change(replace(settings, learning=False))
    assert found.plant.constants == LUMPED and found.plant.lag == 0.0
    found.change(settings)
    assert (found.plant.constants, found.plant.lag) == (before.constants, before.lag)
    found.forget()
    assert found.newest is None and found.estimate(DURATION) is None
    assert (found.plant.constants, found.plant.lag) == (before.constants, before.lag)


@BOTH
def test_changed_drive_lag_restarts_the_lag_and_keeps_the_constants(
    settings: ControllerSettings, sent: SentInputs
) -> None:
    found = tracked(settings, sent)
    constants = found.plant.constants
    found.change(replace(settings, drive_lag=0.03))
    assert found.plant.lag == pytest.approx(0.03)
    assert found.plant.constants == constants
    known = Estimator(replace(settings, learning=False), LUMPED, sent)
    known.change(replace(settings, learning=False, drive_lag=0.03))
    assert known.plant.constants == LUMPED and known.plant.lag == 0.03
    track(found, sent, LATER)
    assert found.plant.lag == pytest.approx(LAG, rel=0.1), "estimated again from the new prior"


@pytest.mark.parametrize(
    ("before", "after"), [(EXACT, NOISY), (NOISY, EXACT)], ids=["to noisy", "to exact"]
)
def test_other_noise_of_the_poses_keeps_parameters_and_pose(
    sent: SentInputs, before: ControllerSettings, after: ControllerSettings
) -> None:
    found = tracked(before, sent)
    plant, state, newest = found.plant, state_at(found, DURATION + 0.1), found.newest
    found.change(after)
    assert (found.plant.constants, found.plant.lag) == (plant.constants, plant.lag)
    assert found.newest == newest
    np.testing.assert_allclose(state_at(found, DURATION + 0.1), state, atol=5e-4)


@pytest.mark.parametrize("delay", [0.0, 0.3], ids=["at once", "one transition later"])
def test_learning_by_a_worker_gives_the_constants_of_learning_in_line(
    sent: SentInputs, delay: float
) -> None:
    in_line, clock = tracked(EXACT, sent), Clock()
    worker = DelayedWorker(clock, delay)
    found = Estimator(EXACT, LUMPED, sent, worker=worker)
    track(found, sent)
    clock.time = 1.0
    assert same(found.plant, in_line.plant)


class Clock:
    """A clock that is set by hand."""

    time = 0.0

    def __call__(self) -> float:
        return self.time


def same(first: PlantEstimate, second: PlantEstimate) -> bool:
    assert first.deviations is not None and second.deviations is not None
    return (first.constants, first.lag, first.noise) == (
        second.constants, second.lag, second.noise
    ) and np.array_equal(first.deviations, second.deviations)


def test_worker_that_has_lost_what_was_learnt_goes_on_from_the_constants_known(
    sent: SentInputs,
) -> None:
    worker = DelayedWorker(Clock(), 0.0)
    found = Estimator(EXACT, LUMPED, sent, worker=worker)
    track(found, sent)
    before = found.plant
    worker.lose()
    track(found, sent, DURATION + PERIOD)
    assert found.plant.constants == before.constants
    track(found, sent, LATER)
    assert not same(found.plant, before)
    assert gain(found) == pytest.approx(GAIN, rel=1e-3)

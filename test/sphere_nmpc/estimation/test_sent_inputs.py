# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""History of the rotor speeds sent, also by the motion that they cause."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import predicted

from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, as_state, without_momentum
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
P = ROBOT.lumped.as_array()
START = as_state([1.0, -2.0, 0.1, 0.7, -0.1, 0.7])
STATE = without_momentum(START)


def ramp(start: float, first: list[float], last: list[float], length: float) -> FirstOrderHold:
    return FirstOrderHold(np.array([start, start + length]), np.array([first, last], dtype=float))


def replaced(holds: list[FirstOrderHold]) -> SentInputs:
    sent = SentInputs()
    for hold in holds:
        sent.record(hold.starting_at(hold.start, sent.at(hold.start)))
    return sent


def test_each_hold_lasts_until_the_next_takes_effect_and_an_earlier_one_replaces_later_ones():
    sent = SentInputs()
    sent.record(ramp(1.0, [0, 0], [10, 20], 1.0))
    sent.record(ramp(1.5, [5, 10], [0, 0], 0.5))
    np.testing.assert_allclose([sent.at(t)[0] for t in (0.5, 1.25, 1.75, 9.0)], [0, 2.5, 2.5, 0])
    sent.record(FirstOrderHold.constant(1.2, np.array([1.0, 1.0])))
    np.testing.assert_array_equal(sent.at(3.0), [1.0, 1.0])
    late = ramp(2.0, [1, 1], [3, 3], 0.5)
    sent.record(late)
    sent.withdraw(late)
    np.testing.assert_array_equal(sent.at(3.0), [1.0, 1.0])
    sent.record(ramp(4.0, [1, 1], [0, 0], 1.0))
    assert sent.moves_after(4.9) and not sent.moves_after(5.0)
    sent.clear()
    assert not sent.moves_after(0.0)


speeds = st.lists(st.floats(-100.0, 100.0), min_size=2, max_size=2)


@settings(max_examples=40)
@given(
    gaps=st.lists(st.tuples(st.floats(0.01, 0.6), speeds, st.floats(0.05, 0.8)), min_size=1,
                  max_size=4),
    lead=st.floats(-0.2, 0.3),
    length=st.floats(0.0, 1.0),
)
def test_prediction_agrees_with_the_plant_driven_by_the_same_speeds(
    gaps: list[tuple[float, list[float], float]], lead: float, length: float
) -> None:
    begin, holds = 0.0, []
    for gap, target, duration in gaps:
        begin += gap
        holds.append(ramp(begin, [0, 0], target, duration))
    sent = replaced(holds)
    start = holds[0].start + lead
    end = start + length
    plant = RollingPlant(ROBOT, START)
    plant._speeds = sent.at(start)
    knots = {t for hold in holds for t in (hold.start, hold.end) if start < t < end}
    here = start
    for there in sorted(knots | {end}):
        if there > here:
            plant.advance(sent.at(there), there - here)
        here = there
    found = predicted(sent, STATE, start, end, P, max_step=0.0125)
    # The error of each method is below 1e-6 in a second at full speed.
    np.testing.assert_allclose(found[POSE], plant.state, atol=2e-6)
    middle = predicted(sent, STATE, start, 0.5 * (start + end), P, max_step=0.0125)
    in_two = predicted(sent, middle, 0.5 * (start + end), end, P, max_step=0.0125)
    np.testing.assert_allclose(in_two[POSE], plant.state, atol=2e-6)


def test_prediction_with_momentum_also_covers_the_time_before_the_first_hold() -> None:
    sent = SentInputs()
    sent.record(FirstOrderHold(np.array([1.0, 2.0]), np.array([[0.0, 0.0], [40.0, -20.0]])))
    disturbance = Disturbance(np.array([2.0, 1.0]), np.array([0.5, -1.0, 2.0]))
    start = np.array([0.3, -0.2, 0.5, 0.5, 0.5, 0.5, 5.0, -3.0, 0.5])
    found = predicted(sent, start, 0.5, 2.0, P, 0.05, disturbance)
    speeds = np.array([[0.0, 0.0], [0.0, 0.0], [40.0, -20.0]])
    expected = roll_out(start, speeds, np.array([0.5, 1.0]), P, 0.05, disturbance)[-1]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_pieces_are_the_speeds_in_force() -> None:
    rng, sent, now = np.random.default_rng(5), SentInputs(), 0.0
    for _ in range(40):
        now += float(rng.choice([0.002, 0.01, 0.25]))
        # Some holds have knots before the next one begins.
        times = now + np.concatenate(([0.0], np.cumsum(rng.uniform(1e-3, 0.02, 3))))
        speeds = np.vstack((sent.at(now), rng.uniform(-100.0, 100.0, (3, 2))))
        sent.record(FirstOrderHold(times, speeds))
    for start, end in ((-0.5, 0.0), (-0.5, now), (0.3 * now, 0.31 * now), (0.5 * now, now + 1.0)):
        durations, speeds = sent.pieces(start, end)
        ends = start + np.concatenate(([0.0], np.cumsum(durations)))
        assert ends[-1] == pytest.approx(end) and np.all(durations > 0.0)
        times = rng.uniform(start, end, 50)
        found = np.column_stack([np.interp(times, ends, column) for column in speeds.T])
        np.testing.assert_allclose(found, [sent.at(t) for t in times.tolist()], atol=1e-6)

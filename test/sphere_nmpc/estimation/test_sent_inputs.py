# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""History of the rotor speeds sent, and prediction of the motion that they cause."""


import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

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
    predicted = sent.predict(STATE, start, end, P, max_step=0.0125)
    # The error of each method is below 1e-6 in a second at full speed.
    np.testing.assert_allclose(predicted[POSE], plant.state, atol=2e-6)
    middle = sent.predict(STATE, start, 0.5 * (start + end), P, max_step=0.0125)
    in_two = sent.predict(middle, 0.5 * (start + end), end, P, max_step=0.0125)
    np.testing.assert_allclose(in_two[POSE], plant.state, atol=2e-6)


def test_prediction_with_momentum_also_covers_the_time_before_the_first_hold() -> None:
    sent = SentInputs()
    sent.record(FirstOrderHold(np.array([1.0, 2.0]), np.array([[0.0, 0.0], [40.0, -20.0]])))
    disturbance = Disturbance(np.array([2.0, 1.0]), np.array([0.5, -1.0, 2.0]))
    start = np.array([0.3, -0.2, 0.5, 0.5, 0.5, 0.5, 5.0, -3.0, 0.5])
    found = sent.predict(start, 0.5, 2.0, P, 0.05, disturbance)
    speeds = np.array([[0.0, 0.0], [0.0, 0.0], [40.0, -20.0]])
    expected = roll_out(start, speeds, np.array([0.5, 1.0]), P, 0.05, disturbance)[-1]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_pieces_are_the_same_however_often_they_were_asked_for() -> None:
    rng = np.random.default_rng(5)
    asked, fresh, now = SentInputs(), list[FirstOrderHold](), 0.0
    for _ in range(300):
        now += float(rng.choice([0.002, 0.01, 0.25]))
        # Some holds have knots before the next one, some are as late as the last question.
        times = now + np.cumsum(rng.uniform(1e-3, 0.02, 4)) - 1e-3
        fresh.append(FirstOrderHold(times, rng.uniform(-100.0, 100.0, (4, 2))))
        asked.record(fresh[-1])
        if rng.random() < 0.5:
            asked.collect(now - rng.uniform(0.0, 0.1))
        if rng.random() < 0.3:
            start, end = now - rng.uniform(0.0, 1.0), now + rng.choice([0.0, 1e-3])
            expected = SentInputs()
            for hold in fresh:
                expected.record(hold)
            for found, known in zip(
                asked.pieces(start, end), expected.pieces(start, end), strict=True
            ):
                np.testing.assert_array_equal(found, known)

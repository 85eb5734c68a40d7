# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time at the goal with momentum: a short run is judged against the true limit of the rotors."""

import math

import pytest

pytest.importorskip("mujoco")

from momentum_holding import Case, Outcome, _row, run


def test_sphere_on_a_slope_stays_for_the_time_that_it_could() -> None:
    found = next(
        outcome for outcome in (run(Case(slope=1.0, duration=7.0), i) for i in range(4))
        if not math.isnan(outcome.arrived)
    )
    assert 0.0 < found.arrived < found.limit < 6.0
    # It stays within 1e-2 a little longer, while it begins to roll.
    assert found.left > found.arrived + 0.8 * (found.limit - found.arrived)
    assert found.predicted == pytest.approx(found.limit - found.arrived, abs=0.3)


def test_share_of_the_time_and_of_the_prediction_are_shown() -> None:
    kept = Outcome(arrived=2.0, left=10.0, limit=10.0, predicted=8.4)
    lost = Outcome(arrived=2.0, left=4.0, limit=10.0, predicted=8.0)
    never = Outcome(math.nan, math.nan, math.inf, math.nan)
    row = _row(Case(slope=0.5, duration=20.0), [kept, lost, never])
    shown = "| slope 0.5° | 2 of 3 | 2.0 (2.0) | 1 of 2 | 0.62 (0.25) | 2.5 % (5.0 %) |"
    assert row == shown

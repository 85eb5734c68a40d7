# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time at the goal with momentum: a short run is judged against the true limit of the rotors."""

import math

import pytest

pytest.importorskip("mujoco")

from momentum_holding import Case, run


def test_sphere_on_a_slope_stays_for_the_time_that_it_could() -> None:
    found = next(
        outcome for outcome in (run(Case(slope=1.0, duration=7.0), i) for i in range(4))
        if not math.isnan(outcome.arrived)
    )
    assert 0.0 < found.arrived < found.limit < 6.0
    # It stays within 1e-2 a little longer, while it begins to roll.
    assert found.left > found.arrived + 0.8 * (found.limit - found.arrived)
    assert found.predicted == pytest.approx(found.limit - found.arrived, abs=0.3)

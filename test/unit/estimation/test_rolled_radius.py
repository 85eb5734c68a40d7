# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Radius of the shell from a measured way, and the command for it."""

import numpy as np
import pytest
from recorded_bags import POSE, START, STEP, pose, write_own

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.estimation.rolled_radius import rolled_radius
from sphere_sim.cli.main import main

TIMES = np.arange(0.0, 5.0, 0.01)
WAY = 3.1 * np.clip((TIMES - 1.0) / 3.0, 0.0, 1.0)
STRAIGHT = np.column_stack((0.6 * WAY + 1.0, 0.8 * WAY - 2.0))


def test_radius_makes_the_estimated_way_as_long_as_the_measured_one() -> None:
    radius, rolled = rolled_radius(TIMES, STRAIGHT, 0.3, 3.0)
    assert (radius, rolled) == pytest.approx((0.3 * 3.0 / 3.1, 3.1))


@pytest.mark.parametrize(("places", "times", "told"), [
    (STRAIGHT[101:], TIMES[101:], "start of the way"),
    (STRAIGHT[:-102], TIMES[:-102], "end of the way"),
    (STRAIGHT[:50], TIMES[:50], "start of the way"),
    (0.3 * STRAIGHT, TIMES, "estimated way: given 0.9300 m"),
    (np.column_stack((WAY, np.sin(WAY))), TIMES, "path: given"),
])
def test_way_that_is_no_measure_is_refused(places, times, told) -> None:
    with pytest.raises(InvalidInputError, match=told):
        rolled_radius(times, places, 0.3, 3.0)


def test_command_prints_the_parameter_from_a_bag(tmp_path, capsys) -> None:
    write_own(tmp_path / "bag", (
        ("/pose", POSE, stamp, pose(stamp, (*place, 1.0, 0.0, 0.0, 0.0)))
        for stamp, place in zip(range(START, 2 * START, STEP), STRAIGHT, strict=False)
    ))
    assert main(["calibrate_radius", "3.0", "--from-bag", str(tmp_path / "bag")]) == 0
    assert "robot.shell_radius: 0.29032    # +- 0.00010 m" in capsys.readouterr().out
    assert main(["calibrate_radius", "3.0", "--from-bag", str(tmp_path / "none")]) != 0

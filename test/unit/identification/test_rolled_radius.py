# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Radius of the shell from a measured way, and the command for it."""

import re

import numpy as np
import pytest
import yaml
from recorded_bags import POSE, START, STEP, pose, write_own

from sphere_nmpc.errors import InvalidInputError
from sphere_sim.cli.main import main
from sphere_sim.identification.rolled_radius import rolled_radius

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


def test_command_gives_the_radius_of_a_bag_without_rotor_speeds(tmp_path, capsys) -> None:
    write_own(tmp_path / "bag", (
        ("/pose", POSE, stamp, pose(stamp, (*place, 1.0, 0.0, 0.0, 0.0)))
        for stamp, place in zip(range(START, 2 * START, STEP), STRAIGHT, strict=False)
    ))
    out = tmp_path / "robot.yaml"
    words = ["identify", str(tmp_path / "bag"), "--distance", "3.0", "--out", str(out)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert re.search(r"robot.shell_radius +0.290323 m +\+- 0.000097 +given 0.3 ", printed)
    robot = yaml.safe_load(out.read_text())["/**"]["ros__parameters"]["robot"]
    assert robot["shell_radius"] == pytest.approx(0.290323, abs=1e-5)
    assert main(["identify", str(tmp_path / "none"), "--distance", "3.0"]) != 0

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A controller node that several tests of a file share."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from driven_controller import Robot


@pytest.fixture(scope="module")
def driven(request) -> Iterator["Robot"]:
    """Return the robot of several tests; a parameter is the settings of its controller."""
    from driven_controller import Robot
    from ros_graph import running_graph

    with running_graph() as graph:
        yield Robot(graph, **getattr(request, "param", {}))


@pytest.fixture
def robot(driven) -> "Robot":
    """Return the robot at rest without a goal."""
    driven.rest()
    return driven


@pytest.fixture
def begun(robot) -> "Robot":
    """Return the robot with a controller that begins, and a clock whose pace it knows."""
    robot.now = 0
    robot.start_again()

    def has_pace() -> bool:
        robot.pass_time(0.1)
        return robot.node._control_clock.watch.pace is not None

    robot.graph.until(has_pace)
    robot.trajectories.clear()
    return robot

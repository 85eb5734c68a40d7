# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The map that the documents use: a way, not a straight one, leads from the start to the goal."""

from pathlib import Path

import numpy as np

from sphere_nmpc.floor.route import in_sight, route_to
from sphere_nmpc.floor.settings import FloorSettings

MAP = Path(__file__).parents[3] / "config" / "maps" / "two_rooms.yaml"
START, GOAL = np.array([2.0, -3.0]), np.zeros(2)


def test_start_and_goal_of_the_first_case_are_in_two_rooms_with_a_doorway() -> None:
    floor = FloorSettings(map_file=str(MAP)).whole(0.3)
    assert floor.distances(np.array([START, GOAL, [1.0, 2.0]])).min() > 1.0
    assert not in_sight(floor, START, GOAL[None], floor.needed)[0]
    assert 4.0 < route_to(floor, GOAL).length(START) < 6.0
    # The doorway is 1.2 m wide.
    assert np.isinf(route_to(FloorSettings(map_file=str(MAP)).whole(0.7), GOAL).length(START))

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Examples without ROS print what the tutorial says, and what it quotes of all is in them."""

import re

import numpy as np
import pytest
import yaml
from documented_examples import EXAMPLES, forms, printed, run_example, section

from sphere_nmpc.floor.route import in_sight, route_to
from sphere_nmpc.floor.settings import FloorSettings

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", sorted(path.name for path in EXAMPLES.glob("*.py")))
def test_what_the_tutorial_quotes_is_in_the_example(name: str) -> None:
    assert f"(../examples/{name})" in section(name)
    source = (EXAMPLES / name).read_text(encoding="utf-8")
    for excerpt in printed(name, "python"):
        assert excerpt in source


def test_controller_settles_on_a_plant_of_ones_own_and_learns_it() -> None:
    done = run_example("own_plant.py")
    assert done.returncode == 0, done.stderr
    (documented,) = printed("own_plant.py", "text")
    assert forms(done.stdout) == forms(documented)
    settled = re.search(r"settled after ([\d.]+) s; at the goal", done.stdout)
    assert settled and float(settled[1]) < 9.0
    learnt, true, told = map(float, re.findall(r"0\.01\d+", done.stdout.splitlines()[-1]))
    assert abs(learnt - true) < 0.1 * abs(told - true)


def test_strategy_of_ones_own_arrives() -> None:
    done = run_example("own_strategy.py")
    assert done.returncode == 0, done.stderr
    (documented,) = printed("own_strategy.py", "text")
    assert forms(done.stdout) == forms(documented)
    own, ours = (float(time) for time in re.findall(r"after ([\d.]+) s", done.stdout))
    assert own < 9.0 and ours < 9.0


def test_robot_of_ones_own_is_the_same_in_both_nodes_and_has_to_go_around_the_table() -> None:
    nodes = yaml.safe_load((EXAMPLES / "own_robot.yaml").read_text(encoding="utf-8"))
    simulator, controller = (nodes[f"/**/{n}"]["ros__parameters"] for n in (
        "simulator", "controller"
    ))
    assert simulator["robot"] == controller["robot"]
    assert simulator["map_file"] == controller["map_file"] == "examples/room.yaml"
    radius, start = simulator["robot"]["shell_radius"], simulator["initial_state"][:2]
    settings = FloorSettings(
        map_file=str(EXAMPLES / "room.yaml"), clearance=controller["clearance"]
    )
    floor = settings.whole(radius)
    ends = np.array([start, [1.5, 0.5]])
    assert floor.distances(ends).min() > 2.0 * radius
    assert not in_sight(floor, ends[0], ends[1:], floor.needed)[0]
    assert route_to(floor, ends[1]).length(ends[0]) < 5.0

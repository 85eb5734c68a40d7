# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scripts of bench/ and examples without ROS, and what documents have of them."""

import json
import re
import runpy
import subprocess
import sys
from copy import copy
from dataclasses import replace
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

import ablation
import lists
import paths
import tables
from documented_examples import EXAMPLES, forms, printed, run_example, section
from parameter_tables import NODES, OF_ROBOT, PARTS, outputs, parameters_yaml

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.estimation import estimator
from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.floor.route import in_sight, route_to
from sphere_nmpc.floor.settings import FloorSettings
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import upright_state
from sphere_nmpc.quantities import quantities
from sphere_nmpc.ros.cdr import Clock
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_sim.evaluation.metrics import measure_along
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.world.plant.rolling_plant import RollingPlant
from sphere_sim.world.walls import Walls

BENCH = Path(__file__).parents[2] / "bench"


@pytest.mark.parametrize("script", sorted(BENCH.rglob("*.py")), ids=lambda path: path.stem)
def test_script_does_nothing_when_it_is_imported(script, monkeypatch, capfd) -> None:
    def files() -> list[Path]:
        return sorted(p for p in BENCH.rglob("*") if "__pycache__" not in p.parts)

    monkeypatch.setattr(sys, "path", [str(script.parent), *sys.path])
    before = files()
    runpy.run_path(str(script), run_name="imported")
    assert capfd.readouterr() == ("", "") and files() == before


def test_table_has_rows_as_they_are_declared_with_reference_total_and_file(
    monkeypatch, capsys, tmp_path
) -> None:
    monkeypatch.setattr(tables, "in_processes", lambda call, tasks, jobs: starmap(call, tasks))
    table = tables.Table(
        ("name", "runs", "over a", "seconds"),
        lambda number, seed: [
            tables.Row((name, number), [(StudyConditions(), factor * (seed + k))
                                        for k in range(number)])
            for name, factor in (("a", 1), ("b", 2), ("c", 3))
        ],
        lambda conditions, value: (value, conditions.duration),
        lambda found, first: (sum(v for v, _ in found) / sum(v for v, _ in first), found[0][1]),
        number=2, has_reference=True, has_total=True,
    )
    command = ["table", "--only", "c", "--seed", "5", "--duration", "4", "--json"]
    monkeypatch.setattr(sys, "argv", [*command, str(tmp_path / "table.json")])
    tables.print_tables({"": table}, None)
    assert capsys.readouterr().out.splitlines() == [
        "| name | runs | over a | seconds |", "|---|---|---|---|",
        "| a | 2 | 1.0 | 4.0 |", "| c | 2 | 3.0 | 4.0 |", "| all | 4 | 1.0 | 4.0 |",
    ]
    rows = json.loads((tmp_path / "table.json").read_text())["rows"]
    assert rows[1] == {"names": ["c", 2], "runs": [[15, 4.0], [18, 4.0]]}
    with pytest.raises(SystemExit, match="given 'd', expected one of a, b, c"):
        list(table.made(only=["d"]))


@pytest.mark.slow
def test_no_instant_of_the_walk_makes_more_calls_than_committed() -> None:
    command = [sys.executable, str(BENCH / "walk.py"), "--counts"]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, f"{found.stdout}{found.stderr}"


def test_walk_counts_records_however_they_are_made_and_none_that_is_compared() -> None:
    meter = runpy.run_path(str(BENCH / "walk_meter.py"))["Meter"](counts=True)
    hold, clock, robot = FirstOrderHold([0.0], [[0.0, 0.0]]), Clock(1), RobotParameters()
    made = [
        lambda: FirstOrderHold.constant(1.0, np.zeros(2)), lambda: replace(hold, times=[1.0]),
        lambda: FirstOrderHold._unchecked(hold.times.copy(), hold.speeds.copy()),
        lambda: copy(hold), lambda: Clock(1), lambda: Clock._make([1]),
        lambda: clock._replace(stamp=3),
        lambda: (hash(robot), robot == robot, clock == clock, repr(hold)),
    ]
    for make in made:
        meter.run(make)
        meter.end("made")
    assert [walk.records for walk in meter.walks["made"]] == [
        *[{"FirstOrderHold"}] * 4, *[{"Clock"}] * 3, set(),
    ]


@pytest.mark.parametrize(
    "numbers", [TimeOptimalSettings(leaving_error=7e-3), EstimatorSettings(window=7)]
)
def test_ablated_run_has_its_settings_and_leaves_none_behind(monkeypatch, numbers) -> None:
    seen = []
    for module, name in ((ablation, "TimeOptimalStrategy"), (estimator, "Scaling")):
        made = getattr(module, name)

        def make(first, second, numbers, made=made) -> object:
            seen.append(numbers)
            return made(first, second, numbers)

        monkeypatch.setattr(module, name, make)
    conditions = StudyConditions(duration=0.5)
    ablation.measured(numbers, conditions, draw_scenarios(1, 1)[0])
    assert numbers in seen
    seen.clear()
    Controller(conditions.controller, conditions.robot)
    assert seen and numbers not in seen


def test_poses_of_a_list_count_as_visited_in_their_order_alone() -> None:
    first, second, between = (upright_state(x, 0.0, 0.3) for x in (0.0, 1.0, 0.5))
    times = 0.1 * np.arange(5)
    path = np.array([second, between, first, between, second])
    assert lists.visits(times, path, [first, second]) == [times[2], times[4]]
    assert lists.visits(times, path, [second, second, first]) == [0.0, 0.0, times[2]]
    assert lists.visits(times, path[:4], [first, second]) == [times[2]]


@pytest.mark.slow
def test_run_of_a_list_visits_its_poses_and_settles_at_the_last_one() -> None:
    poses = [upright_state(0.0, 0.0, 0.0), upright_state(0.4, 0.0, 0.0),
             upright_state(0.4, 0.3, 1.0)]
    settled, visited, contacts = lists.run("nominal", poses, Floor.EMPTY, 1, 20.0)
    assert len(visited) == 2 and visited[0] < visited[1] <= settled < 19.0 and contacts == 0
    settled, visited, _ = lists.run("nominal", poses, Floor.EMPTY, 1, settled - 1.0)
    assert settled == np.inf and len(visited) == 1, "it ends on the way"


@pytest.mark.parametrize("kind", ["circle", "eight", "line", "arc-0.50", "s+0.50"])
def test_judge_of_paths_has_exact_curves_and_finds_what_is_beside_them(kind) -> None:
    nodes = paths.nodes_of(kind, np.random.default_rng(1))
    exact = paths.exact_path(nodes, 0.02)
    x, y = exact.places.T
    beyond = {
        "circle": np.hypot(x, y - 0.5) - 0.5, "eight": y**2 - x**2 * (1.0 - x**2), "line": y,
        "arc-0.50": np.hypot(x, y + 2.0) - 2.0,
        "s+0.50": exact.places + exact.places[::-1] - 2.0 * exact.places[1500],
    }[kind]
    assert np.max(np.abs(beyond)) < 1e-5
    length = {"circle": np.pi, "eight": 6.0972}.get(kind, 3.0)
    assert exact.length == pytest.approx(length, abs=1e-4)
    ahead = np.gradient(exact.places, axis=0)
    normals = np.column_stack((-ahead[:, 1], ahead[:, 0])) / np.linalg.norm(ahead, axis=1)[:, None]
    track = exact.places + 0.004 * np.sin(np.pi * np.linspace(0.0, 1.0, len(x)))[:, None] * normals
    times = np.linspace(0.0, 9.0, len(x))
    rms, largest, duration = measure_along(times, track, [exact], 0.1)
    assert (rms, largest) == pytest.approx((0.004 / np.sqrt(2.0), 0.004), rel=0.01)
    assert duration == pytest.approx(9.0, abs=0.1)


@pytest.mark.slow
def test_judge_of_paths_comes_where_the_plant_does() -> None:
    settings = ("controller.path_speed=0.3 simulator.position_noise=0.002 "
                "simulator.orientation_noise=0.004")
    found = paths.measured(tables.conditions_of(settings, 30.0, 10.0), "line", 1, 0)
    assert found["apart"] < 1e-6 and found["end"] < 0.02 and len(found["track"]) > 100


def values(settings: Any) -> dict[str, Any]:
    found = {name: getattr(settings, name) for name in quantities(settings)}
    return {name: list(v) if isinstance(v, tuple) else v for name, v in found.items()}


@pytest.mark.parametrize("path", outputs(), ids=lambda path: path.name)
def test_file_is_up_to_date(path) -> None:
    assert path.read_text(encoding="utf-8") == outputs()[path], (
        "run python bench/documents/parameter_tables.py"
    )


@pytest.mark.parametrize("node", NODES)
def test_yaml_gives_the_defaults_back(node) -> None:
    given = yaml.safe_load(parameters_yaml())[f"/**/{node}"]["ros__parameters"]
    given.pop("use_sim_time", None)
    expected = values(NODES[node])
    for prefix, _, settings in PARTS[node]:
        expected |= {prefix: values(settings)} if prefix else values(settings)
    if node in OF_ROBOT:
        expected["robot"] = values(RobotParameters())
    assert given == expected
    for key, value in given.items():
        # YAML 1.1 reads some numbers as text.
        assert type(value) is type(expected[key])


@pytest.mark.parametrize(
    "name", sorted(path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".ipynb"))
)
def test_what_the_tutorial_quotes_is_in_the_example(name) -> None:
    assert f"(../examples/{name})" in section(name)
    source = (EXAMPLES / name).read_text(encoding="utf-8")
    for excerpt in printed(name, "python"):
        assert excerpt in source


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "arrival", "number"),
    [("own_plant.py", r"settled after ([\d.]+) s; at the goal", 1),
     ("own_strategy.py", r"after ([\d.]+) s", 2)],
)
def test_example_arrives_and_prints_what_the_tutorial_says(name, arrival, number) -> None:
    done = run_example(name)
    assert done.returncode == 0, done.stderr
    (documented,) = printed(name, "text")
    assert forms(done.stdout) == forms(documented)
    arrivals = re.findall(arrival, done.stdout)
    assert len(arrivals) == number and max(map(float, arrivals)) < 9.0
    if name == "own_plant.py":
        learnt, true, told = map(float, re.findall(r"0\.01\d+", done.stdout.splitlines()[-1]))
        assert abs(learnt - true) < 0.1 * abs(told - true)


def test_plant_of_the_example_moves_as_the_ideal_one_where_its_lag_is_short() -> None:
    example = runpy.run_path(str(EXAMPLES / "own_plant.py"))
    robot, start = RobotParameters(), example["START"]
    lagging = example["Lagging"](robot, start, example["LaggingSettings"](lag=1e-3))
    rolling = RollingPlant(robot, start)
    for plant in (lagging, rolling):
        plant.tilt(0.02, 0.5)
        for k in range(100):
            if k == 50:
                plant.push((0.2, -0.1))
            plant.advance(np.array([40.0, -60.0]) * min(1.0, (k + 1) / 20), 0.01)
    # 1 ms at the speed of some 0.5 m/s and 2 rad/s, and midpoints.
    for name, tolerance in (
        ("state", 3e-3), ("momentum", 1e-3), ("velocity", 1e-2), ("body_rate", 2e-2),
        ("rotor_angles", 0.1), ("rotor_speeds", 1e-6), ("rotor_torques", 1e-2),
    ):
        found, expected = getattr(lagging, name), getattr(rolling, name)
        np.testing.assert_allclose(found, expected, atol=tolerance, err_msg=name)
    assert np.linalg.norm(rolling.state - start) > 0.3
    walls = Walls(Grid(np.zeros((20, 20), dtype=bool), 0.1, (start[0] - 1.0, start[1] - 1.0, 0.0)))
    lagging.surround(walls)
    for _ in range(600):
        lagging.advance(np.array([40.0, -60.0]), 0.01)
    clearance = lagging.contact.least_clearance(lagging.state[None, :2])
    assert lagging.contact.touches == 1 and 0.0 <= clearance < 5e-3


def test_robot_of_ones_own_is_given_once_and_has_to_go_around_the_table() -> None:
    nodes = yaml.safe_load((EXAMPLES / "own_robot.yaml").read_text(encoding="utf-8"))
    robot, simulator, controller = (nodes[name]["ros__parameters"] for name in (
        "/**", "/**/simulator", "/**/controller"
    ))
    assert list(robot) == ["robot"] and not {"robot"} & {*simulator, *controller}
    assert simulator["map_file"] == controller["map_file"] == "examples/room.yaml"
    radius, start = robot["robot"]["shell_radius"], simulator["initial_state"][:2]
    settings = FloorSettings(
        map_file=str(EXAMPLES / "room.yaml"), clearance=controller["clearance"]
    )
    floor = settings.whole(radius)
    ends = np.array([start, [1.5, 0.5]])
    assert floor.distances(ends).min() > 2.0 * radius
    assert not in_sight(floor, ends[0], ends[1:], floor.needed)[0]
    assert route_to(floor, ends[1]).length(ends[0]) < 5.0

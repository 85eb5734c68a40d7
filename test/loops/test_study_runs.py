# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs of a study: what is recorded of them, pushes, and maps with their contacts and refusals."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from inertial_runs import error_of
from scipy.stats import chi2

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, make_state, position_error, upright_state
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_sim.cli.main import main as command
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.odometry_poses import OdometryPoses
from sphere_sim.output.files import ResultFolderError
from sphere_sim.scenario.csv_file import read_scenarios
from sphere_sim.scenario.scenarios import GivenPath, Push, Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.journal import fingerprint
from sphere_sim.study.record import (
    FLOOR_RESULT_COLUMNS,
    ODOMETRY_RESULT_COLUMNS,
    PATH_RESULT_COLUMNS,
    RESULT_COLUMNS,
    RunRecord,
)
from sphere_sim.study.single_run import floor_of, followed_inputs, prepare, run_scenario
from sphere_sim.study.study import Study
from sphere_sim.study.workers import Workers
from sphere_sim.world.plant.rolling_plant import RollingPlant

pytestmark = pytest.mark.slow

SCENARIO = draw_scenarios(1, 5)[0]
PUSHED = replace(SCENARIO, push=Push(1.234567891, (0.3, -0.4)))
SHORT = StudyConditions(duration=4.0)


def run(conditions: StudyConditions, scenario: Scenario, duration: float) -> Trajectory:
    simulator, controller = prepare(conditions, scenario)
    return run_closed_loop(simulator, controller, scenario.goal, duration, push=scenario.push)


@pytest.mark.parametrize("plant", ["rolling", "rigid_body"])
def test_push_acts_at_its_time_to_the_nanosecond(plant) -> None:
    if plant == "rigid_body":
        pytest.importorskip("mujoco")
    conditions = SHORT.with_settings([("plant", plant)])
    still, pushed = (run(conditions, scenario, 2.0) for scenario in (SCENARIO, PUSHED))
    assert not still.at_push.size
    before = pushed.times < 1.234
    # The contact is integrated in other steps up to the push, which is between two samples.
    np.testing.assert_array_equal(pushed.states[before], still.states[before])
    assert np.max(np.abs(pushed.states[-1] - still.states[-1])) > 0.05
    momentum = pushed.at_push[8:]
    np.testing.assert_allclose(momentum, [0.3 * 0.4, 0.3 * 0.3, 0.0], atol=1e-4)
    i = int(np.flatnonzero(before)[-1])
    share = (1.234567891 - pushed.times[i]) / 0.01
    # Linear within 10 ms but for the curvature, below 100 m/s^2 and 1000 1/s^2.
    between = pushed.states[i] + share * (pushed.states[i + 1] - pushed.states[i])
    np.testing.assert_allclose(pushed.at_push[:6], between, atol=0.02)


@pytest.mark.parametrize("speed", [0.3, 0.0])
def test_run_along_a_closed_path_is_settled_once_it_has_followed_it(speed) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 100)
    circle = 0.5 * np.column_stack((np.sin(angles), 1.0 - np.cos(angles)))
    path = GivenPath(circle, Path("circle.csv"))
    scenario = replace(
        SCENARIO, start=make_state(circle[0], SCENARIO.start[QUATERNION]), goal=path.end,
        follows=path, path_speed=speed,
    )
    found = run_scenario(replace(SHORT, duration=14.0), scenario).results
    rms, largest, time = (found[name] for name in PATH_RESULT_COLUMNS)
    assert found["settled"] and rms < largest < 0.02
    assert (10.0 if speed else 5.0) < time < (12.0 if speed else 8.0)
    assert time <= found["settle_time_s"] + 0.02
    early = run_scenario(SHORT, scenario).results
    assert not early["settled"] and early["path_time_s"] is None and early["path_max_m"] < 0.02


def test_recorded_inputs_reproduce_speeds_and_states() -> None:
    conditions = SHORT.with_settings([("control_rate", "7.0")])
    trajectory = run(conditions, SCENARIO, 4.0)
    inputs = followed_inputs(trajectory.holds, 4.0)
    assert (inputs.start, inputs.end) == (0.0, 4.0)
    for i in range(2):
        speeds = np.interp(trajectory.times, inputs.times, inputs.speeds[:, i])
        # Knot times are rounded to nanoseconds.
        np.testing.assert_allclose(speeds, trajectory.rotor_speeds.values[:, i], rtol=0, atol=1e-6)
    plant = RollingPlant(RobotParameters(), SCENARIO.start)
    for duration, end in zip(np.diff(inputs.times), inputs.speeds[1:], strict=True):
        plant.advance(end, float(duration))
    # It integrates in steps of other lengths.
    np.testing.assert_allclose(plant.state, trajectory.states[-1], rtol=0, atol=1e-8)


def test_a_command_replaces_what_is_left_of_the_one_before() -> None:
    first = FirstOrderHold(np.array([0.0, 1.0, 2.0]), np.array([[0, 0], [10, 10], [20, 20]]))
    second = FirstOrderHold(np.array([0.5, 1.5]), np.array([[5, 5], [0, 0]]))
    inputs = followed_inputs([first, second], 1.0)
    np.testing.assert_array_equal(inputs.times, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(inputs.speeds[:, 0], [0.0, 5.0, 2.5])


def test_record_is_read_back_to_the_bit() -> None:
    record = run_scenario(replace(SHORT, duration=2.0), PUSHED)
    assert record.at_push.size == 11
    index, again = RunRecord.from_json(record.as_json(3))
    assert index == 3 and again.results == record.results
    for name in ("times", "speeds", "at_push"):
        np.testing.assert_array_equal(getattr(again, name), getattr(record, name))


def test_run_that_crashes_is_recorded_as_such(monkeypatch) -> None:
    def fail(self: object, end: object, duration: float) -> None:
        raise ArithmeticError("no longer finite")

    monkeypatch.setattr(RollingPlant, "advance", fail)
    record = run_scenario(SHORT, SCENARIO)
    assert record.results["crash"] == "ArithmeticError: no longer finite"
    assert record.results["settled"] is False


def test_controller_has_the_nominal_parameters_of_a_perturbed_robot() -> None:
    simulator, controller = prepare(replace(SHORT, perturbation=3.0), SCENARIO)
    assert simulator.plant._mass != RobotParameters().total_mass
    assert controller.estimator.plant.constants == RobotParameters().lumped


def test_settings_that_depend_on_each_other_are_accepted_in_any_order() -> None:
    small = [("robot.shell_radius", "0.149"), ("robot.rotor_offset", "0.07"),
             ("robot.shell_inertia", "0.014")]
    large = [("robot.shell_radius", "1.0"), ("robot.rotor_offset", "0.5")]
    for settings in (small, large):
        there, back = (SHORT.with_settings(order) for order in (settings, settings[::-1]))
        assert there == back
        assert there.robot.rotor_offset == float(settings[1][1])
    with pytest.raises(InvalidParameterError, match="rotor_offset"):
        SHORT.with_settings(small[:1])


ACROSS = Scenario(upright_state(-1.0, 0.0, 0.0), upright_state(1.0, 0.0, 0.0))
"""From one side of the wall in the middle to the other."""
INTO_WALL = Scenario(*2 * (upright_state(-0.6, 0.0, 0.0),), push=Push(1.0, (4.0, 0.0)))
"""Pushed towards that wall, at rest at the goal, by more than the rotors can hold."""


@pytest.fixture
def map_file(tmp_path, monkeypatch) -> Path:
    """A room of 4 m x 4 m about the origin with a wall in the middle, as map_server saves it."""
    monkeypatch.setattr("sphere_sim.study.study.draw", lambda *arguments: None)
    floor_of.cache_clear()  # each test has a map of its own, which a process keeps
    levels = np.full((80, 80), 254, dtype=np.uint8)
    levels[:, 39:41] = 0
    (tmp_path / "room.pgm").write_bytes(b"P5\n80 80\n255\n" + levels.tobytes())
    path = tmp_path / "room.yaml"
    path.write_text("image: room.pgm\nresolution: 0.05\norigin: [-2, -2, 0]\nnegate: 0\n")
    return path


def conditions_with(map_file: Path, **settings: str) -> StudyConditions:
    """Return those of runs of the strategy ``paper`` unless another one is given."""
    given = {"strategy": "paper", "floor.map_file": str(map_file), **settings}
    return StudyConditions(duration=6.0).with_settings(given.items())


@pytest.mark.parametrize("plant", ["rolling", "rigid_body"])
def test_run_into_a_wall_is_counted(map_file, plant) -> None:
    if plant == "rigid_body":
        pytest.importorskip("mujoco")
    conditions = conditions_with(map_file, plant=plant)
    results = run_scenario(conditions, INTO_WALL).results
    assert results["contacts"] >= 1 and not results["settled"]
    assert -2e-3 < results["least_clearance_m"] < 5e-3
    free = run_scenario(replace(conditions, floor=StudyConditions().floor), INTO_WALL).results
    assert results["final_position_error_m"] < 0.3 < free["final_position_error_m"]
    assert not set(FLOOR_RESULT_COLUMNS) & set(free)


def test_goal_behind_the_wall_is_a_run_in_which_nothing_moves(map_file) -> None:
    conditions = conditions_with(map_file, strategy="time_optimal")
    results = run_scenario(replace(conditions, duration=1.0), ACROSS).results
    assert results["reason"].startswith("the goal: no way with 0.33 m")
    assert not results["settled"] and results["contacts"] == 0
    assert results["least_clearance_m"] == pytest.approx(0.65)
    assert results["final_position_error_m"] == 2.0


def test_reason_is_that_of_the_last_goal_given_up(map_file, monkeypatch) -> None:
    def given_up(*arguments: Any, **options: Any) -> Trajectory:
        found = run_closed_loop(*arguments, **options)
        for decision, status, words in zip(
            found.decisions,
            (PlanStatus.RAMP_TO_REST, PlanStatus.RAMP_TO_REST, PlanStatus.SATURATED),
            ("the goal: no way", "the goal: it is occupied", "saturated"), strict=False,
        ):
            told = (Condition(Kind.GIVEN_UP, words),)
            plan = replace(decision.plan, status=status, conditions=told)
            found.decisions.append(replace(decision, plan=plan))
        return found

    monkeypatch.setattr("sphere_sim.study.single_run.run_closed_loop", given_up)
    conditions = replace(conditions_with(map_file), duration=1.5)
    assert run_scenario(conditions, ACROSS).results["reason"] == "the goal: it is occupied"


def test_runs_on_an_odometry_are_judged_on_the_true_state() -> None:
    settings = [("simulator.pose_source", "odometry"), ("imu.position", "0.1,-0.05,0.08")]
    conditions = StudyConditions(duration=9.0).with_settings(settings)
    results = run_scenario(conditions, SCENARIO).results
    off, turned = (results[name] for name in ODOMETRY_RESULT_COLUMNS)
    # What the odometry does not know the controller cannot put right.
    assert 0.0 < off < 0.02 and 0.0 < turned < 1.0
    assert abs(results["final_position_error_m"] - off) < 5e-3
    with pytest.raises(InvalidParameterError, match="latency"):
        simulator, controller = prepare(conditions, SCENARIO)
        run_closed_loop(simulator, controller, SCENARIO.goal, 1.0, latency=0.1, poses=list)


def test_deviations_that_odometry_and_controller_state_cover_their_errors() -> None:
    noises = {"pose_position_noise": "1e-3", "pose_orientation_noise": "2e-3"}
    settings = {"simulator.pose_source": "odometry", **noises}
    conditions, squares = StudyConditions().with_settings(settings.items()), []
    for scenario in draw_scenarios(4, 9):
        simulator, controller = prepare(conditions, scenario)
        poses = OdometryPoses(simulator, simulator.imu, conditions.odometry, conditions.robot)
        run = run_closed_loop(simulator, controller, scenario.goal, 3.0, poses=poses)
        poses()
        squares.append(error_of(poses.odometry, simulator.plant.state)[1])
        decision, spread = run.decisions[-1], poses.odometry.estimate.covariance[:2, :2]
        then = run.states[np.argmin(np.abs(run.times - 2.75))]
        # Of the pose that it is given, and of its own estimate from that.
        stated = math.sqrt(np.trace(spread)) + decision.position_deviation
        assert position_error(decision.state, then) < 3.0 * stated < 0.1
    # Of four runs with five degrees of freedom, 99.5 % of the sums are below this.
    assert np.mean(squares) < chi2.ppf(0.995, 5 * 4) / 4


def test_map_adds_columns_to_the_table_and_the_summary(map_file, tmp_path, capsys) -> None:
    arguments = ["study", "--draw", "2", "--duration", "1", "--jobs", "1", "--no-bound"]
    arguments += ["--strategy", "paper", "--map", str(map_file), "--out", str(tmp_path / "out")]
    assert command([*arguments, "--set", "floor.clearance=0.4"]) == 0
    with (tmp_path / "out" / "runs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    names = list(rows[0])
    assert names[-len(FLOOR_RESULT_COLUMNS):] == list(FLOOR_RESULT_COLUMNS)
    assert names[13 : -len(FLOOR_RESULT_COLUMNS)] == list(RESULT_COLUMNS)
    clearances = [float(row["least_clearance_m"]) for row in rows]
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["contacts"] == sum(int(row["contacts"]) for row in rows)
    assert summary["least_clearance_m"] == min(clearances)
    line = f"{summary['contacts']} contacts, least clearance {1e3 * min(clearances):.1f} mm"
    assert line in capsys.readouterr().out
    for row in rows:
        for column in ("x", "goal_x"):
            assert 0.05 + 0.7 <= abs(float(row[column])) <= 2.0 - 0.7


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such file"),
        ("image: room.pgm\norigin: [0, 0, 0]\n", "no resolution"),
        ("image: none.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n", "none.pgm"),
    ],
)
def test_map_that_cannot_be_used_exits_2_and_leaves_no_folder(
    tmp_path, capsys, content, words
) -> None:
    path, out = tmp_path / "bad.yaml", tmp_path / "out"
    if content is not None:
        path.write_text(content)
    assert command(["study", "--draw", "1", "--map", str(path), "--out", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(path) in line and words in line
    assert not out.exists()


def test_study_continues_only_on_the_same_map(map_file, tmp_path) -> None:
    conditions = replace(conditions_with(map_file), duration=0.5)
    study = Study([ACROSS], conditions, tmp_path / "out")
    for _ in range(2):
        with Workers() as workers:
            study.run(workers)
    image = map_file.with_suffix(".pgm")
    image.write_bytes(image.read_bytes()[:-1] + b"\0")
    floor_of.cache_clear()
    with Workers() as workers, pytest.raises(ResultFolderError, match="another map"):
        study.run(workers)


def test_each_run_has_its_own_map_also_when_it_is_run_again(map_file, tmp_path) -> None:
    scenarios, conditions = [ACROSS, replace(ACROSS, map_file=map_file)], StudyConditions(0.5)
    tables = []
    for name in ("in/first", "in/other/second"):
        Study(scenarios, conditions, tmp_path / name).run()
        with (tmp_path / name / "runs.csv").open(newline="") as file:
            tables.append(list(csv.DictReader(file)))
        scenarios = read_scenarios(tmp_path / name / "runs.csv")
    for free, walled in tables:
        assert (free["map"], free["contacts"], free["reason"]) == ("", "", "")
        assert walled["contacts"] == "0" and walled["reason"].startswith("the goal: no way")
    assert [row["map"] for _, row in tables] == ["../../room.yaml", "../../../room.yaml"]
    orders = [scenarios[:1], scenarios, scenarios[::-1]]
    assert len({fingerprint(conditions, order).get("map") for order in orders}) == 3


def test_drawn_places_are_uniform_over_what_is_clear() -> None:
    occupied = np.zeros((40, 60), dtype=bool)
    occupied[:, 30:] = True
    occupied[18:22, 45:] = False  # too narrow for the sphere
    floor = Floor(Grid(occupied, 0.1, (5.0, -7.0, 0.5)), 0.3, 0.1)
    drawn = draw_scenarios(300, 3, "anywhere", floor)
    places = np.array([[s.start[POSITION], s.goal[POSITION]] for s in drawn]).reshape(-1, 2)
    assert np.min(floor.distances(places)) >= floor.needed
    local = 0.1 * floor.grid.local(places)
    # Clear is 0.4 to 2.6 m and 0.4 to 3.6 m; three standard deviations of 600 uniform numbers.
    np.testing.assert_allclose(local.mean(axis=0), [1.5, 2.0], atol=0.12)
    np.testing.assert_allclose(local.std(axis=0), [0.635, 0.924], atol=0.06)
    again = draw_scenarios(2, 3, "anywhere", floor)
    np.testing.assert_array_equal(again[1].goal, drawn[1].goal)
    (turn,) = draw_scenarios(1, 3, "half_turn", floor)
    np.testing.assert_array_equal(turn.start[POSITION], turn.goal[POSITION])
    assert turn.seed == draw_scenarios(1, 3, "half_turn")[0].seed


def test_floor_without_room_is_refused() -> None:
    floor = Floor(Grid(np.zeros((4, 4), dtype=bool), 0.1), 0.3, 0.02)
    with pytest.raises(InvalidParameterError, match="room for the sphere"):
        draw_scenarios(1, 0, "anywhere", floor)

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Deviation from paths, by kind, and time along them, judged on curves that are known exactly.

    python bench/paths.py plain --runs 20 --json out/paths.json
    python bench/paths.py plain --perturb 10 --set simulator.plant=rigid_body \\
        simulator.position_noise=0.002 simulator.orientation_noise=0.004
    python bench/paths.py gentle --runs 10
    python bench/paths.py plain --set controller.path_speed=0
    python bench/paths.py places --set controller.path_speed=0

Each run starts at rest at the start of its path with an orientation drawn at random. `gentle` are
the line, arcs and S of 3 m with curvatures of 0.15 to 0.5 1/m to both sides. On the ideal plant
the judge integrates the commands by itself (`worlds.integrated`), elsewhere it has the states.
Times are in those of steady rolling along the path; for `places`, six that are 0.5 to 1.5 m apart
with turns of up to 60 degrees, in that of a list of them, at each of which the sphere rests.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parent / "documents"))

import numpy as np
from tables import Row, Table, conditions_of, print_tables
from worlds import SPEED, integrated

from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.path import Path as Curve
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import POSITION, Vector, make_state
from sphere_sim.evaluation.closed_loop import Trajectory
from sphere_sim.evaluation.metrics import deviations, measure_along
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import GivenPath, Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.record import finite
from sphere_sim.study.single_run import closed_loop, followed_inputs, prepare

_SPACING = 1e-3
"""Spacing of the exact curves [m]."""
_GIVEN = 10
"""Every how many of their places are given to the controller."""
_STEP = 5e-3
"""Time between two looks at the sphere [s]."""
_MEASURED_RANGE = 0.1
"""Way beyond what is rolled in a step, and less than from one part of a path to another [m]."""

_BENT = [f"{form}{sign}{0.05 * k:.2f}" for form in ("arc", "s") for sign in "+-"
         for k in range(3, 11)]
GENTLE = ["line", *_BENT]
PLAIN = ["circle", "eight", "line", "s+0.50"]
KINDS = ["circle", "eight", *GENTLE, "places"]


def nodes_of(kind: str, rng: np.random.Generator) -> Vector:
    """Return places, shape (P, 2) [m], that a path of a kind goes through from start to end."""
    if kind == "places":
        turns = np.cumsum(np.radians(rng.uniform(-60.0, 60.0, 6)))
        ways = rng.uniform(0.5, 1.5, 6) * np.stack((np.cos(turns), np.sin(turns)))
        return np.vstack((np.zeros((1, 2)), np.cumsum(ways, axis=1).T))
    if kind == "eight":  # 2 m long, 1 m wide
        angles = np.linspace(0.0, 2.0 * np.pi, 100_001)
        return np.column_stack((np.sin(angles), np.sin(angles) * np.cos(angles)))
    known = {"circle": (2.0, np.pi), "line": (0.0, 3.0)}
    bend, length = known.get(kind) or (float(kind.lstrip("arcs")), 3.0)
    step = length / round(length / _SPACING)
    bends = np.full(round(length / step), bend)
    if kind.startswith("s"):
        bends[len(bends) // 2 :] *= -1.0
    turns = step * (np.cumsum(bends) - 0.5 * bends)  # in the middle of each step
    steps = step * np.column_stack((np.cos(turns), np.sin(turns)))
    return np.vstack((np.zeros((1, 2)), np.cumsum(steps, axis=0)))


def exact_path(nodes: Vector, tolerance: float) -> Curve:
    """Return the polyline through places, which is not rounded as the controller's path is."""
    at = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))))
    count = round(float(at[-1]) / _SPACING)
    along = np.linspace(0.0, at[-1], count + 1)
    curve = [np.interp(along, at, nodes[:, axis]) for axis in (0, 1)]
    return Curve(np.column_stack((*curve, 0.0 * along, 0.0 * along)), float(at[-1]) / count,
                 tolerance)


def judged_track(
    found: Trajectory, conditions: StudyConditions, scenario: Scenario
) -> tuple[Vector, float]:
    """Return places at the times of a run, (N, 2), and how far the plant's are from them [m]."""
    track = found.states[:, POSITION]
    if conditions.simulator.plant != "rolling":
        return track, 0.0
    rng = np.random.default_rng([scenario.seed, 2])  # as `prepare` draws the robot
    robot = perturbed(conditions.robot, conditions.perturbation / 100.0, rng)
    inputs = followed_inputs(found.holds, conditions.duration)
    times = np.union1d(found.times, inputs.times)
    speeds = np.column_stack([np.interp(times, inputs.times, u) for u in inputs.speeds.T])
    own = integrated(scenario.start, times, speeds, robot.lumped)
    own = own[np.searchsorted(times, found.times)]
    return own, float(np.max(np.linalg.norm(own - track, axis=1)))


def measured(
    conditions: StudyConditions, kind: str, seed: int, number: int
) -> dict[str, Any]:
    """Run along a path of a kind, as long as it takes, and return the figures of the run."""
    rng = np.random.default_rng([seed, KINDS.index(kind), number])
    nodes, settings = nodes_of(kind, rng), conditions.controller
    exact = exact_path(nodes, settings.path_tolerance)
    places = exact.places
    longest = 10.0 + 2.0 * exact.length / (settings.path_speed or SPEED)
    conditions = replace(conditions, duration=longest)
    given = nodes if kind == "places" else np.vstack((places[:-1:_GIVEN], places[-1:]))
    path = GivenPath(given, Path(kind))
    scenario = Scenario(
        make_state(given[0], random_quaternion(rng)), path.end, int(rng.integers(2**31)),
        follows=path,
    )
    made = _, controller = prepare(conditions, scenario)
    found = closed_loop(conditions, scenario, made, output_period=_STEP)
    track, apart = judged_track(found, conditions, scenario)
    rms, largest, time = measure_along(found.times, track, [exact], _MEASURED_RANGE)
    reference = exact.length / SPEED
    if kind == "places":
        stops = (Goal(make_state(place, path.end[2:]), Orientation.ANY) for place in nodes[1:])
        listed = closed_loop(conditions, scenario, None, Course.of(*stops), _STEP)
        reference = listed.settled_after
    upright = np.sum(found.states[:, 3:5] ** 2, axis=1) < 0.5  # on one side of the circle Gamma
    return {
        "kind": kind, "number": number, "length": exact.length, "rms": finite(rms),
        "largest": finite(largest), "time": finite(time), "ratio": finite(time / reference),
        "end": float(np.linalg.norm(track[-1] - places[-1])), "apart": apart,
        "crossings": int(np.sum(upright[1:] != upright[:-1])), "failures": controller.failures,
    } | ({} if number else drawn(exact, track))


def drawn(path: Curve, track: Vector) -> dict[str, Any]:
    """Return what the figure of a run shows."""
    away, way = deviations([path], track, _MEASURED_RANGE)
    shown = {"path": path.places, "track": track, "away": away, "way": way}
    return {name: values[::_GIVEN].tolist() for name, values in shown.items()}


def _rows(number: int, seed: int, kinds: Sequence[str]) -> Iterator[Row]:
    plain = conditions_of("controller.path_speed=0.3 controller.path_tolerance=0.02", 30.0)
    for kind in kinds:
        yield Row((kind, number), [(plain, kind, seed, k) for k in range(number)])


def _cells(rows: list[dict[str, Any]], _: object) -> list[object]:
    """Return the cells of all runs of a kind: medians, 90 % and worst in mm, times as ratios."""
    def spread(name: str, scale: float, form: str) -> str:
        known = [scale * one[name] for one in rows if one[name] is not None]
        if not known:
            return "-"
        return " / ".join(f"{value:{form}}" for value in np.quantile(known, (0.5, 0.9, 1.0)))

    return [
        sum(one["time"] is not None and one["end"] < 0.01 for one in rows),
        spread("rms", 1e3, ".2f"), spread("largest", 1e3, ".1f"), spread("end", 1e3, ".1f"),
        spread("ratio", 1.0, ".3f"), sum(one["crossings"] > 0 for one in rows),
        sum(one["failures"] for one in rows), f"{1e3 * max(one['apart'] for one in rows):.2g}",
    ]


TABLES = {
    name: Table(
        ("path", "runs", "at the end", "rms [mm]: median / 90 % / worst", "largest [mm]",
         "at the end [mm]", "time over that of reference", "across Γ", "failed solves",
         "judge from plant [mm]"),
        partial(_rows, kinds=kinds), measured, _cells, number=20, has_total=True,
    )
    for name, kinds in (("plain", PLAIN), ("gentle", GENTLE), ("places", ["places"]))
}

if __name__ == "__main__":
    print_tables(TABLES, __doc__)

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time of a list of goals over the sum of the times of its single motions, in lockstep.

    python bench/lists.py --runs 20 --json out/lists.json                 # some minutes
    python bench/lists.py --only wrong --runs 20 --seed 2 --jobs 1

Each list has a start and six poses, drawn at random: `nominal` on the ideal plant, `obstacles` on
the same among discs, `wrong` on the contact plant with parameters up to 10 % off those that the
controller has. A single motion is a run of its own, from rest at the pose before. A list has
failed if its poses are not all reached in order, each within the error in R^6 below which a run
counts as settled, or if it does not settle at the last one. Contacts are those of both.
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parent / "documents"))

import numpy as np
from tables import Row, Table, conditions_of, print_tables
from worlds import draw_poses, draw_world, longest_run

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, position_error
from sphere_sim.evaluation.metrics import SETTLED_ERROR, state_errors
from sphere_sim.scenario.scenarios import Scenario, anywhere
from sphere_sim.study.record import finite
from sphere_sim.study.single_run import closed_loop, prepare
from sphere_sim.world.walls import walls_of

_CONDITIONS = {
    "nominal": ("", 0.0), "obstacles": ("", 0.0), "wrong": ("simulator.plant=rigid_body", 10.0),
}
"""Settings of the runs and errors of the parameters [%] by kind."""
_GOALS = 6
"""Goals of a list."""
_CLEARANCE = 0.03
"""Clearance to be kept from obstacles [m]."""
_STEP = 1e-3
"""Time between two looks at the sphere [s], which may pass through a goal at full speed."""


def draw(kind: str, rng: np.random.Generator) -> tuple[list[Vector], Floor]:
    """Draw a start and the poses of a list, shape (6,) each, and the floor that they are on."""
    if kind == "obstacles":
        world = draw_world("discs", rng)
        floor = Floor(world.grid(), RobotParameters().shell_radius, _CLEARANCE)
        return draw_poses(world, floor, rng, _GOALS + 1), floor
    drawn = [pose for _ in range(_GOALS) for pose in anywhere(rng)]
    return drawn[: _GOALS + 1], Floor.EMPTY


def visits(times: Vector, states: Vector, poses: Sequence[Vector]) -> list[float]:
    """Return the first times at which poses are reached in order [s], up to one that is not."""
    found: list[float] = []
    since = 0
    for pose in poses:
        inside = np.flatnonzero(state_errors(states[since:], pose) < SETTLED_ERROR)
        if not inside.size:
            break
        since += int(inside[0])
        found.append(float(times[since]))
    return found


def run(
    kind: str, poses: Sequence[Vector], floor: Floor, seed: int, duration: float
) -> tuple[float, list[float], int]:
    """Run from rest at the first pose to the others in order.

    Returns
    -------
    settled : float
        Time from which on the sphere stays at the last pose [s]; inf without one, and for poses
        that are not all reached in order.
    visited : list of float
        See `visits`.
    contacts : int
        Number of contacts with obstacles.
    """
    settings, percent = _CONDITIONS[kind]
    conditions = conditions_of(settings, duration, percent)
    scenario = Scenario(poses[0], poses[-1], seed)
    made = simulator, controller = prepare(conditions, scenario)
    if not floor.is_empty:
        simulator.plant.surround(walls_of(floor.grid))
        controller.floor = floor
    found = closed_loop(conditions, scenario, made, Course.of(*map(Goal, poses[1:])), _STEP)
    visited = visits(found.times, found.states, poses[1:])
    reached = len(visited) == len(poses) - 1 and np.isfinite(found.settled_after)
    settled = found.settled_after if reached else np.inf
    return settled, visited, simulator.touches


def measured(kind: str, seed: int, number: int) -> dict[str, Any]:
    """Draw a list, run it and its single motions, and return its figures."""
    rng = np.random.default_rng([seed, number])
    poses, floor = draw(kind, rng)
    of_run = int(rng.integers(2**31))
    pairs = [poses[k : k + 2] for k in range(_GOALS)]
    longest = [longest_run(position_error(*pair)) for pair in pairs]
    singles = [
        run(kind, pair, floor, of_run, most) for pair, most in zip(pairs, longest, strict=True)
    ]
    single = sum(settled for settled, _, _ in singles)
    listed, visited, contacts = run(kind, poses, floor, of_run, sum(longest))
    return {
        "kind": kind, "number": number, "list": finite(listed), "single": finite(single),
        "ratio": finite(listed / single) if np.isfinite(single) else None, "visits": visited,
        "singles": [finite(settled) for settled, _, _ in singles],
        "contacts": contacts + sum(touched for _, _, touched in singles),
    }


def _rows(number: int, seed: int) -> Iterator[Row]:
    for kind in _CONDITIONS:
        yield Row((kind, number), [(kind, seed, k) for k in range(number)])


def _cells(rows: list[dict[str, Any]], _: object) -> list[object]:
    """Return the cells of all lists of a kind."""
    judged = [one for one in rows if one["ratio"] is not None]
    median, worst = "-", "-"
    if judged:
        last = max(judged, key=lambda one: one["ratio"])
        median = f"{np.median([one['ratio'] for one in judged]):.3f}"
        worst = f"{last['ratio']:.3f} (list {last['number']})"
    return [
        sum(one["list"] is None for one in rows), sum(one["singles"].count(None) for one in rows),
        sum(one["contacts"] for one in rows), median, worst,
    ]


TABLE = Table(
    ("kind", "lists", "failed", "singles not settled", "contacts", "ratio, median", "worst"),
    _rows, measured, _cells, number=20,
)

if __name__ == "__main__":
    print_tables({"": TABLE}, __doc__)

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time of a list of goals over the sum of the times of its single motions, in lockstep.

    python bench/lists.py --draw 20 --json out/lists.json                 # some minutes
    python bench/lists.py --kinds wrong --draw 20 --seed 2 --jobs 1

Each list has a start and six poses, drawn at random: `nominal` on the ideal plant, `obstacles` on
the same among discs, `wrong` on the contact plant with parameters up to 10 % off those that the
controller has. A single motion is a run of its own, from rest at the pose before. A list has
failed if its poses are not all reached in order, each within the error in R^6 below which a run
counts as settled, or if it does not settle at the last one. Contacts are those of both.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from machine import machine, write_json
from worlds import draw_poses, draw_world, longest_run

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, position_error
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.evaluation.metrics import SETTLED_ERROR, state_errors, stay_below
from sphere_sim.scenario.scenarios import Scenario, anywhere
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.record import finite
from sphere_sim.study.single_run import prepare
from sphere_sim.world.walls import walls_of

_CONDITIONS = {
    "nominal": StudyConditions(),
    "obstacles": StudyConditions(),
    "wrong": StudyConditions(perturbation=10.0).with_settings([("simulator.plant", "rigid_body")]),
}
"""Conditions of the runs by kind."""
_GOALS = 6
"""Goals of a list."""
_CLEARANCE = 0.03
"""Clearance to be kept from obstacles [m]."""
_STEP = 1e-3
"""Time between two looks at the sphere [s], which may pass through a goal at full speed."""


def as_list(poses: Sequence[Vector]) -> Course:
    """Return the course that has these poses, shape (6,) each, in this order."""
    return Course.of(*map(Goal, poses))


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
    conditions = _CONDITIONS[kind]
    simulator, controller = prepare(conditions, Scenario(poses[0], poses[-1], seed))
    if not floor.is_empty:
        simulator.plant.surround(walls_of(floor.grid))
        controller.floor = floor
    found = run_closed_loop(
        simulator, controller, as_list(poses[1:]), duration, conditions.controller.control_period,
        output_period=_STEP,
    )
    visited = visits(found.times, found.states, poses[1:])
    stay = stay_below(found.times, state_errors(found.states, poses[-1]))
    reached = stay is not None and len(visited) == len(poses) - 1
    settled = stay.since if stay is not None and reached else np.inf
    return settled, visited, simulator.touches


def measured(kind: str, seed: int, number: int) -> dict[str, Any]:
    """Draw a list, run it and its single motions, print a line of it and return its figures."""
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
    row = {
        "kind": kind, "number": number, "list": finite(listed), "single": finite(single),
        "ratio": finite(listed / single) if np.isfinite(single) else None, "visits": visited,
        "singles": [finite(settled) for settled, _, _ in singles],
        "contacts": contacts + sum(touched for _, _, touched in singles),
    }
    ratio = "-" if row["ratio"] is None else f"{row['ratio']:.3f}"
    print(
        f"{kind:9} {number:4} list {listed:6.2f} s, single motions {single:6.2f} s, ratio "
        f"{ratio}, visited {len(visited)} of {_GOALS}, contacts {row['contacts']}", flush=True,
    )
    return row


def summary(kind: str, rows: list[dict[str, Any]]) -> str:
    """Return the line of all lists of a kind."""
    judged = [one for one in rows if one["ratio"] is not None]
    failed = sum(one["list"] is None for one in rows)
    unsettled = sum(one["singles"].count(None) for one in rows)
    contacts = sum(one["contacts"] for one in rows)
    median, worst = "-", "-"
    if judged:
        last = max(judged, key=lambda one: one["ratio"])
        median = f"{np.median([one['ratio'] for one in judged]):.3f}"
        worst = f"{last['ratio']:.3f} (list {last['number']})"
    return f"{kind:9} {len(rows):6} {failed:7} {unsettled:19} {contacts:9}  {median:9}  {worst}"


def main() -> None:
    """Measure all kinds and print the table."""
    # With the scripts of documents.
    sys.path.append(str(Path(__file__).parent / "documents"))
    from tables import in_processes

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draw", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", nargs="*", choices=_CONDITIONS, default=list(_CONDITIONS))
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    limit_library_threads()
    tasks = [
        (kind, options.seed, number) for kind in options.kinds for number in range(options.draw)
    ]
    rows = list(in_processes(measured, tasks, options.jobs))
    print("kind       lists  failed  singles not settled  contacts  ratio p50  max")
    for kind in options.kinds:
        print(summary(kind, [one for one in rows if one["kind"] == kind]))
    told = vars(options) | {"json": None}
    write_json(options.json, {"machine": machine(), "options": told, "rows": rows})


if __name__ == "__main__":
    main()

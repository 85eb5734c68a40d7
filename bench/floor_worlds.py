# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs of the controller in random worlds.

    python bench/floor_worlds.py kinds --runs 40 --json out/floor_worlds.json    # an hour or more
    python bench/floor_worlds.py gaps --only doors --runs 5
    python bench/floor_worlds.py areas

Contacts are judged by the world's rectangles and discs along the path of the true sphere, every
millisecond; on the ideal plant also along the path that the judge integrates by itself. `gaps` are
widths of doorways beyond the diameter. `bench/documents/figures.py worlds` draws the file.
In `areas` one to keep out of is announced ten times a second, and searches take a simulated time.
"""

import itertools
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parent / "documents"))
sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))

import numpy as np
from sampled_loop import SampledLoop
from tables import Row, Table, conditions_of, median_and_worst, print_tables
from worlds import KINDS, SIDE, SPEED, World, draw_task, draw_world, integrated, longest_run

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.state import POSITION
from sphere_nmpc.reporting.conditions import Kind
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.record import finite
from sphere_sim.study.single_run import closed_loop, prepare
from sphere_sim.world.walls import walls_of

_STEP = 1e-3
"""Time between two looks of the judge [s]."""
_AREAS = (
    ("none", 0.0, 0.03), ("stands beside", 0.0, 0.03), ("moves beside", 0.3, 0.03),
    ("crosses the way", 0.1, 0.03), ("crosses the way", 0.3, 0.03), ("crosses the way", 0.3, 0.15),
    ("over the goal", 0.3, 0.03),
)
"""What an area does, its speed [m/s], and the clearance [m]."""
_SQUARE = 0.25 * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
"""Corners of an area about its centre [m]."""


def run(conditions: StudyConditions, kind: str, seed: int, gap: float | None) -> dict[str, Any]:
    """Run a task of a world, as long as it takes, and return its figures."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    world = draw_world(kind, rng, gap)
    floor = Floor(world.grid(), conditions.robot.shell_radius, conditions.floor.clearance)
    start, goal, length = draw_task(world, floor, rng)
    conditions = replace(conditions, duration=longest_run(length))
    scenario = Scenario(start, goal, seed)
    made = simulator, controller = prepare(conditions, scenario)
    simulator.plant.surround(walls_of(floor.grid))
    controller.floor = floor
    found = closed_loop(conditions, scenario, made, output_period=_STEP)
    robot = perturbed(
        conditions.robot, conditions.perturbation / 100.0, np.random.default_rng([seed, 2])
    )
    least = float(world.distances(found.states[:, POSITION]).min()) - robot.shell_radius
    apart = 0.0
    if conditions.simulator.plant == "rolling" and not simulator.touches:
        # Until the rotors rest for good.
        moving = int(np.flatnonzero(found.rotor_speeds.values.any(axis=1)).max(initial=0)) + 2
        times, speeds = found.times[:moving], found.rotor_speeds.values[:moving]
        own = integrated(start, times, speeds, robot.lumped)
        apart = float(np.linalg.norm(own - found.states[:moving, POSITION], axis=1).max())
        least = min(least, float(world.distances(own).min()) - robot.shell_radius)
    settled = finite(found.settled_after)
    first = [d.plan.made.solve_time for d in found.decisions if d.mode is Kind.TRACKING][:1]
    return {
        "kind": kind, "seed": seed, "gap": world.gap, "length": length, "settled": settled,
        "beyond": finite(found.settled_after - length / SPEED),
        "least_clearance": least, "contacts": max(simulator.touches, int(least < 0.0)),
        "apart": apart, "failures": controller.failures, "plans": controller.plans,
        "first_plan": first[0] if first else None,
        "given_up": found.decisions[-1].plan.given_up, "goal": goal.tolist(),
        "path": found.states[::10, POSITION].tolist(), "walls": world.walls, "discs": world.discs,
    }


def run_with_area(
    conditions: StudyConditions, area: str, speed: float, kind: str, seed: int
) -> dict[str, Any]:
    """Run a task of a world while an area moves, and return its figures."""
    rng, radius = np.random.default_rng(seed), conditions.robot.shell_radius
    world = World(kind) if kind == "open" else draw_world(kind, rng)
    floor = Floor(world.grid(), radius, conditions.floor.clearance)
    start, goal, length = draw_task(world, floor, rng)
    place, way = 0.5 * (start + goal)[POSITION], (goal - start)[POSITION]
    across = np.array([-way[1], way[0]]) / np.linalg.norm(way)
    across *= np.sign(across @ (0.5 * SIDE - place))
    met = 0.5 * length / SPEED + 1.0
    if area == "over the goal":
        place, met = goal[POSITION], 2.0 * met + 3.0
    elif area.endswith("beside"):
        place, met = place + 3.0 * across, 0.0
    loop = SampledLoop(start, conditions.controller, goal=goal, floor=floor, search_time=0.08)
    restless = np.zeros(0)
    if area == "none":
        loop.run(longest_run(length))
    else:
        corners, velocity = place - met * speed * across + _SQUARE, speed * across
        restless = loop.run_with_area(corners, velocity, longest_run(length))
    return {
        "settled": finite(loop.settled()), "plans": loop.controller.plans,
        "tasks": len(loop.worker.tasks), "solves": sum(each.is_new for each in loop.decisions),
        "contacts": restless.size, "restless": int(restless.sum()),
    }


def _of_areas(number: int, seed: int) -> Iterator[Row]:
    for kind, (area, speed, clearance) in itertools.product(("open", "discs"), _AREAS):
        given = conditions_of(f"control_rate=50 floor.clearance={clearance}", 30.0)
        runs = [(given, area, speed, kind, each) for each in range(seed, seed + number)]
        yield Row((area, speed, clearance, kind), runs)


def _area_cells(rows: list[dict[str, Any]], _: object) -> list[object]:
    """Return the cells of all runs with an area."""
    settled = [row["settled"] for row in rows if row["settled"] is not None]
    sums = [sum(row[name] for row in rows) for name in list(rows[0])[1:]]
    return [f"{len(settled)} of {len(rows)}", median_and_worst(settled, ".2f"), *sums]


def _of_kinds(number: int, seed: int) -> Iterator[Row]:
    for kind in KINDS:
        yield _row((kind, "-"), kind, number, seed, None)


def _of_gaps(number: int, seed: int) -> Iterator[Row]:
    for kind in ("doors", "corridor"):
        for gap in (0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0):
            yield _row((kind, gap), kind, number, seed, gap)


def _row(
    names: tuple[object, ...], kind: str, number: int, seed: int, gap: float | None
) -> Row:
    plain = conditions_of("floor.clearance=0.03", 30.0)
    return Row(names, [(plain, kind, each, gap) for each in range(seed, seed + number)])


def _cells(rows: list[dict[str, Any]], _: object) -> list[object]:
    """Return the cells of all runs of a kind."""
    beyond = [row["beyond"] for row in rows if row["beyond"] is not None]
    quantiles = np.quantile(beyond, (0.5, 0.9, 1.0)) if beyond else np.full(3, np.nan)
    first = np.median([row["first_plan"] for row in rows if row["first_plan"] is not None])
    return [
        len(rows), sum(row["contacts"] for row in rows), len(beyond),
        " / ".join(f"{each:.2f}" for each in quantiles),
        f"{1e3 * min(row['least_clearance'] for row in rows):.1f}", f"{1e3 * first:.0f}",
    ]


_COLUMNS = (
    "worlds", "doorways [m]", "runs", "contacts", "settled",
    "beyond way / 0.742 m/s [s]: median / 90 % / worst", "least clearance [mm]",
    "first plan, median [ms]",
)
TABLES = {
    "kinds": Table(_COLUMNS, _of_kinds, run, _cells, number=10, seed=0),
    "gaps": Table(_COLUMNS, _of_gaps, run, _cells, number=10, seed=0),
    "areas": Table((
        "area", "speed [m/s]", "clearance [m]", "world", "settled", "after: median (worst) [s]",
        "motions", "searches", "solves", "contacts", "without a rest before",
    ), _of_areas, run_with_area, _area_cells, number=6, seed=0),
}

if __name__ == "__main__":
    print_tables(TABLES, __doc__)

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs of the controller in random worlds, and the gallery of their paths.

    python bench/floor_worlds.py --draw 40 --json out/floor_worlds.json    # an hour or more
    python bench/floor_worlds.py --kinds doors --gaps 0.1 0.2 0.4 0.8 --draw 5

Contacts are judged by the world's rectangles and discs along the path of the true sphere, every
millisecond; on the ideal plant also along the path that the judge integrates by itself.
"""

import argparse
import itertools
from pathlib import Path
from typing import Any

import numpy as np
from node_runs import machine, write_json
from worlds import KINDS, SIDE, SPEED, draw_task, draw_world, integrated, longest_run

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_nmpc.reporting.conditions import Kind
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.metrics import state_errors, stay_below
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import prepare
from sphere_sim.world.walls import walls_of

_ROBOT = RobotParameters()
_STEP = 1e-3
"""Time between two looks of the judge [s]."""


def run(kind: str, seed: int, gap: float | None, options: dict[str, Any]) -> dict[str, Any]:
    """Run a task of a world and return its figures."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    world = draw_world(kind, rng, gap)
    floor = Floor(world.grid(), _ROBOT.shell_radius, options["clearance"])
    start, goal, length = draw_task(world, floor, rng)
    settings = {"simulator.plant": options["plant"]}
    if options["noise"]:
        settings["simulator.position_noise"] = options["noise"]
        settings["simulator.orientation_noise"] = 2.0 * options["noise"]
    conditions = StudyConditions(
        duration=longest_run(length), perturbation=options["perturb"]
    ).with_settings([(name, str(value)) for name, value in settings.items()])
    simulator, controller = prepare(conditions, Scenario(start, goal, seed))
    simulator.plant.surround(walls_of(floor.grid))
    controller.floor = floor
    found = run_closed_loop(
        simulator, controller, goal, conditions.duration, conditions.controller.control_period,
        output_period=_STEP,
    )
    robot = perturbed(
        conditions.robot, conditions.perturbation / 100.0, np.random.default_rng([seed, 2])
    )
    least = float(world.distances(found.states[:, POSITION]).min()) - robot.shell_radius
    apart = 0.0
    if options["plant"] == "rolling" and not simulator.touches:
        # Until the rotors rest for good.
        moving = int(np.flatnonzero(found.rotor_speeds.values.any(axis=1))[-1]) + 2
        times, speeds = found.times[:moving], found.rotor_speeds.values[:moving]
        own = integrated(start, times, speeds, robot.lumped)
        apart = float(np.linalg.norm(own - found.states[:moving, POSITION], axis=1).max())
        least = min(least, float(world.distances(own).min()) - robot.shell_radius)
    stay = stay_below(found.times, state_errors(found.states, goal), 1e-2)
    settled = None if stay is None else float(stay.since)
    first = [d.plan.made.solve_time for d in found.decisions if d.mode is Kind.TRACKING][:1]
    _keep_path(options["paths"], f"{kind}_{seed}", found, goal, world.walls, world.discs)
    return {
        "kind": kind, "seed": seed, "gap": world.gap, "length": length, "settled": settled,
        "beyond": None if settled is None else settled - length / SPEED,
        "least_clearance": least, "contacts": max(simulator.touches, int(least < 0.0)),
        "apart": apart, "failures": controller.failures, "plans": controller.plans,
        "first_plan": first[0] if first else None,
        "given_up": found.decisions[-1].plan.given_up,
    }


def _keep_path(
    folder: str | None, name: str, found: Trajectory, goal: Vector, *world: Any
) -> None:
    if folder is not None:
        Path(folder).mkdir(parents=True, exist_ok=True)
        np.savez(
            Path(folder) / f"{name}.npz", path=found.states[::10, POSITION], goal=goal,
            walls=world[0], discs=world[1],
        )


def shown(row: dict[str, Any]) -> str:
    """Return the line of a run."""
    settled = "not settled" if row["settled"] is None else (
        f"settled {row['settled']:6.2f} s ({row['beyond']:+.2f})"
    )
    return (
        f"{row['kind']:6} {row['seed']:4} way {row['length']:6.2f} m, {settled}, least clearance "
        f"{1e3 * row['least_clearance']:6.1f} mm, {row['plans']} plans {row['given_up']}"
    )


def summary(name: str, rows: list[dict[str, Any]]) -> str:
    """Return the line of all runs of a kind."""
    beyond = [row["beyond"] for row in rows if row["beyond"] is not None]
    quantiles = np.quantile(beyond, (0.5, 0.9, 1.0)) if beyond else np.full(3, np.nan)
    first = np.median([row["first_plan"] for row in rows if row["first_plan"] is not None])
    return (
        f"{name:10} runs {len(rows)}, contacts {sum(row['contacts'] for row in rows)}, settled "
        f"{len(beyond)}, beyond way / 0.742 m/s: median {quantiles[0]:.2f} s, 90 % "
        f"{quantiles[1]:.2f} s, worst {quantiles[2]:.2f} s; least clearance "
        f"{1e3 * min(row['least_clearance'] for row in rows):.1f} mm; first plan "
        f"{1e3 * first:.0f} ms in the median"
    )


def draw_gallery(folder: Path, out: Path) -> None:
    """Draw the kept paths of a dozen runs."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot
    from matplotlib.patches import Circle, Rectangle

    names = sorted(folder.glob("*.npz"), key=lambda path: path.stem.split("_")[::-1])[:12]
    figure, axes = pyplot.subplots(3, 4, figsize=(12, 9))
    for axis, name in zip(axes.ravel(), names, strict=False):
        kept = np.load(name)
        for x0, y0, x1, y1 in kept["walls"]:
            axis.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, color="0.35", lw=0))
        for x, y, radius in kept["discs"]:
            axis.add_patch(Circle((x, y), radius, color="0.35", lw=0))
        path, radius = kept["path"], _ROBOT.shell_radius
        for x, y in path[:: max(1, len(path) // 60)]:
            axis.add_patch(Circle((x, y), radius, color="tab:blue", alpha=0.08, lw=0))
        axis.plot(*path.T, color="tab:blue", lw=1.0)
        axis.plot(*path[0], "o", color="tab:green", ms=4)
        axis.plot(*kept["goal"][:2], "*", color="tab:red", ms=7)
        axis.set(xlim=(0, SIDE), ylim=(0, SIDE), aspect="equal", xticks=[], yticks=[])
        axis.set_title(name.stem.replace("_", " "), fontsize=8)
    for axis in axes.ravel()[len(names) :]:
        axis.set_axis_off()
    figure.tight_layout()
    figure.savefig(out, metadata={"Date": None})


def main() -> None:
    """Run the worlds, print a line for each and the summaries."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draw", type=int, default=10, help="worlds of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--gaps", nargs="+", type=float, help="beyond the diameter, all doorways")
    parser.add_argument("--plant", default="rolling")
    parser.add_argument("--perturb", type=float, default=0.0, help="per cent")
    parser.add_argument("--noise", type=float, default=0.0, help="of the position [m]")
    parser.add_argument("--clearance", type=float, default=0.03)
    parser.add_argument("--paths", help="folder for the paths")
    parser.add_argument("--gallery", type=Path, help="drawing of the paths in that folder")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    gaps: list[float | None] = [None] if options.gaps is None else options.gaps
    of_runs = {
        name: getattr(options, name)
        for name in ("plant", "perturb", "noise", "clearance", "paths")
    }
    limit_library_threads()
    seeds = range(options.seed, options.seed + options.draw)
    rows = []
    for seed, kind, gap in itertools.product(seeds, options.kinds, gaps):
        rows.append(run(kind, seed, gap, of_runs) | {"asked": gap})
        print(shown(rows[-1]), flush=True)
    for kind in options.kinds:
        for gap in gaps:
            of = [row for row in rows if row["kind"] == kind and row["asked"] == gap]
            print(summary(kind if gap is None else f"{kind} {gap:g} m", of))
    if options.gallery is not None and options.paths is not None:
        draw_gallery(Path(options.paths), options.gallery)
    told = vars(options) | {"json": None, "gallery": None}
    write_json(options.json, {"machine": machine(), "options": told, "rows": rows})


if __name__ == "__main__":
    main()

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc study``: run many scenarios and write tables of the results."""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.foreign.file import find_file
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_nmpc.settings import STRATEGIES
from sphere_sim.cli.exits import if_interrupted
from sphere_sim.output.arguments import (
    assignment,
    cluster_address,
    not_negative,
    number,
    positive,
    whole,
)
from sphere_sim.output.files import prepare_folder
from sphere_sim.world.settings import PLANTS, POSE_SOURCES, SimulatorSettings

if TYPE_CHECKING:
    from sphere_sim.scenario.perturbation import DisturbanceDraws
    from sphere_sim.study.conditions import StudyConditions
    from sphere_sim.study.motion import Motion

_KINDS = ("anywhere", "far", "kilometre", "circle", "half_turn", "upright", "typed")
"""Names of `scenario.scenarios.DRAWS`, whose import would load NumPy; a test compares."""
_SUITES = ("point-v1", "contact-v1", "worlds-v1")
"""Names of `study.suite.SUITES`, likewise."""
_MOST_DRAWN, _MOST_JOBS = 10**6, 1024
_STEEPEST, _FARTHEST_OFF = 28.0, 30.0  # [degree], [mm]
"""Largest numbers that are accepted."""
_EFFORTS = 0.01, 1000.0
"""Least and largest factor that is accepted."""


def main(argv: Sequence[str]) -> int:
    """Run the study; return 0 when all runs were made, 1 when a run crashed."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    if len(arguments.push or ()) > 2:
        parser.error(f"argument --push: given {len(arguments.push)}, expected one or two")
    limit_library_threads()  # before numpy is loaded, hence the imports below
    out = arguments.out
    kept = f"{out} has the runs made so far; the same command continues from them"
    with if_interrupted(lambda: kept):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    from sphere_sim.scenario.csv_file import read_scenarios
    from sphere_sim.scenario.scenarios import draw_scenarios
    from sphere_sim.study.best_known import best_known_times
    from sphere_sim.study.progress import StudyProgress
    from sphere_sim.study.single_run import floor_of
    from sphere_sim.study.study import Study
    from sphere_sim.study.suite import Score, scenarios_of
    from sphere_sim.study.tables import headline
    from sphere_sim.study.workers import Workers, cores

    strategies = tuple(dict.fromkeys(arguments.strategy or ()))
    conditions = _conditions(arguments, strategies)
    floor, _ = floor_of(conditions.floor, conditions.robot.shell_radius)
    known: list[float] = []
    if arguments.suite is not None:
        scenarios, known = scenarios_of(arguments.suite)
    elif arguments.scenarios is not None:
        scenarios = read_scenarios(arguments.scenarios)
    else:
        scenarios = draw_scenarios(arguments.draw, arguments.seed, arguments.kind, floor)
    draws = _draws(arguments)
    scenarios = [draws.applied_to(scenario) for scenario in scenarios]
    study = Study(scenarios, conditions, prepare_folder(arguments.out), strategies)

    def search(motions: "Sequence[Motion]") -> Sequence[float]:
        if known:
            return [*known] * (len(motions) // len(known))
        progress.close()
        left = (
            f"{arguments.out} has all results but the best known times; the same command "
            "continues the search"
        )
        with if_interrupted(lambda: left):
            times = best_known_times(motions, conditions.robot, workers, arguments.bound_effort)
        # Runs are judged by when they settle, which is before they are at rest at the goal.
        return [found.settling for found in times]

    runs = len(scenarios) * max(1, len(strategies))
    jobs = arguments.jobs or cores()
    with Workers(jobs, arguments.scheduler) as workers, StudyProgress(runs) as progress:
        summaries = study.run(workers, None if arguments.no_bound else search, progress.count)
    for summary in summaries.values():
        print(f"{headline(summary)} -> {arguments.out}")
        if arguments.suite is not None and summary["scores"]:
            print(Score(arguments.suite, summary["strategy"], summary["scores"]))
    return 1 if any(summary["crashed"] for summary in summaries.values()) else 0


def _draws(arguments: argparse.Namespace) -> "DisturbanceDraws":
    from sphere_sim.scenario.perturbation import DisturbanceDraws

    push = None
    if arguments.push is not None:
        push = min(arguments.push), max(arguments.push)
    return DisturbanceDraws(
        push, arguments.push_time, math.radians(arguments.slope), 1e-3 * arguments.offset
    )


def _conditions(
    arguments: argparse.Namespace, strategies: Sequence[str]
) -> "StudyConditions":
    from sphere_sim.scenario.perturbation import DisturbanceDraws
    from sphere_sim.study.conditions import StudyConditions
    from sphere_sim.study.suite import SUITES

    position_noise, orientation_noise = arguments.pose_noise
    named = {
        "controller.strategy": strategies[0] if strategies else None,
        "controller.learning": "false" if arguments.no_learning else None,
        # As workers of a cluster may have other working directories.
        "floor.map_file": arguments.map and find_file(arguments.map),
        "simulator.plant": arguments.plant,
        "simulator.pose_source": arguments.pose_source,
        "simulator.process_noise": arguments.process_noise,
        "simulator.position_noise": position_noise,
        "simulator.orientation_noise": orientation_noise,
    }
    given = [(name, str(value)) for name, value in named.items() if value is not None]
    conditions = StudyConditions() if arguments.suite is None else SUITES[arguments.suite]
    run = {"duration": arguments.duration, "perturbation": arguments.perturb,
           "latency": arguments.latency}
    changed = replace(conditions, **{name: it for name, it in run.items() if it is not None})
    changed = changed.with_settings([*given, *arguments.set])
    is_other = replace(changed, controller=conditions.controller) != conditions
    if arguments.suite is not None and (is_other or _draws(arguments) != DisturbanceDraws()):
        raise InvalidParameterError(
            "--suite", arguments.suite, "settings of the controller alone beside it"
        )
    return changed


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="sphere_nmpc study",
        description="Run many scenarios in closed loop and write tables of the results. "
        "The same command continues an interrupted study.",
    )
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--scenarios", type=Path, metavar="FILE.csv",
        help="starts and goals: x,y,qw,qx,qy,qz,goal_x,...,goal_qz and, optionally, seed; or "
        "starts and path, a CSV file of x,y, and path_speed",
    )
    source.add_argument(
        "--draw", type=whole(1, _MOST_DRAWN), metavar="N",
        help="N random scenarios; see --kind",
    )
    source.add_argument(
        "--suite", choices=_SUITES,
        help="scenarios and conditions of a suite, and scores; docs/suites.md",
    )
    parser.add_argument(
        "--kind", choices=_KINDS, default=_KINDS[0],
        help="kind of random scenarios: positions in +-3 m and any orientations; goals 10 to 60 m "
        "or 1 km away; both contact points on the circle Gamma; half turns in place about any "
        "axis; goals upright, with any heading; round numbers as a person types them",
    )
    parser.add_argument(
        "--seed", type=whole(0), default=0, metavar="S", help="seed of the random scenarios (0)"
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder of the results"
    )
    parser.add_argument(
        "--strategy", nargs="+", action="extend", choices=STRATEGIES, metavar="NAME",
        help=f"one or several of {', '.join(STRATEGIES)}; several are compared",
    )
    parser.add_argument(
        "--plant", choices=PLANTS, help=f"plant of the runs ({SimulatorSettings.plant})"
    )
    parser.add_argument(
        "--pose-source", choices=POSE_SOURCES,
        help="poses of a sensor (the default), or of an odometry by IMU and encoders",
    )
    parser.add_argument(
        "--perturb", type=not_negative, metavar="PERCENT",
        help="largest error of the robot's parameters, whose nominal values the controller has",
    )
    parser.add_argument(
        "--process-noise", type=not_negative, metavar="S",
        help="standard deviation of the noise added to each state every noise_period (0.5 s)",
    )
    parser.add_argument(
        "--pose-noise", type=not_negative, nargs=2, default=(None, None),
        metavar=("METRES", "RADIANS"),
        help="standard deviation of the measured position and orientation",
    )
    parser.add_argument(
        "--latency", type=not_negative, metavar="SECONDS",
        help="age of the newest pose at a sampling instant",
    )
    parser.add_argument(
        "--push", type=not_negative, nargs="+", metavar="NEWTON_SECONDS",
        help="impulse of a push in each run, in a random direction; two numbers are a range",
    )
    parser.add_argument(
        "--push-time", type=not_negative, metavar="SECONDS",
        help="time of the push; by default random, 0.5 to 3 s",
    )
    parser.add_argument(
        "--slope", type=number(0.0, _STEEPEST), default=0.0, metavar="DEGREES",
        help="inclination of the floor, in a random direction for each run",
    )
    parser.add_argument(
        "--offset", type=number(0.0, _FARTHEST_OFF), default=0.0, metavar="MILLIMETRES",
        help="distance of the centre of mass from the centre, in a random direction for each run",
    )
    parser.add_argument(
        "--map", type=Path, metavar="FILE.yaml",
        help="map whose occupied cells are walls, as map_server saves it; random starts and goals "
        "are anywhere on it where the sphere has its clearance",
    )
    parser.add_argument(
        "--duration", type=positive, metavar="SECONDS",
        help="length of a run (30)",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--jobs", type=whole(1, _MOST_JOBS), metavar="N",
        help="processes; all cores by default",
    )
    where.add_argument(
        "--scheduler", type=cluster_address, metavar="URL",
        help="run on this Dask cluster, such as tcp://host:8786"
    )
    parser.add_argument(
        "--no-learning", action="store_true", help="do not estimate the robot's parameters"
    )
    bound = parser.add_mutually_exclusive_group()
    bound.add_argument(
        "--no-bound", action="store_true", help="do not search for the best known times"
    )
    bound.add_argument(
        "--bound-effort", type=number(*_EFFORTS), default=1.0, metavar="FACTOR",
        help="factor on the effort of the searches for best known times (1)",
    )
    parser.add_argument(
        "--set", type=assignment, nargs="+", action="extend", default=[], metavar="NAME=VALUE",
        help="one or several other settings, in any order, each once: controller.NAME, "
        "simulator.NAME, robot.NAME, PLANT.NAME, disturbances.NAME or floor.NAME, such as "
        "controller.horizon=8; the prefix may be left out. msg_docs/parameters.md lists the "
        "names; one that no study reads is refused with those that it reads",
    )
    return parser

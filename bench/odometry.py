# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Odometry from inside: goals reached by it, drift, consistency, fixes, other methods, its cost.

    python bench/odometry.py --json out/odometry.json                # about half an hour
    python bench/odometry.py --parts drift others --seeds 10
    python bench/odometry.py --parts goals wrong --goals 20
    python bench/odometry.py --set imu.cross_axis=0 imu.g_sensitivity=0

Errors are those of the true state. `others` has the sensor data of `drift` and needs the package
`ahrs` from PyPI. A figure of three is median, 95th percentile and maximum.
"""

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from machine import machine, write_json
from odometry_drives import (
    FURTHER,
    INSTANTS,
    conditions_of,
    drift,
    quantiles,
    recorded,
    shown,
    sizes,
    world,
    world_error,
)

from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.model.error_state import apply_error
from sphere_nmpc.model.state import Vector
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.evaluation.metrics import angle_errors, position_errors
from sphere_sim.evaluation.odometry_poses import OdometryPoses
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.record import ODOMETRY_RESULT_COLUMNS
from sphere_sim.study.single_run import closed_loop

_LIMITS = {"goals": (0.02, 1.5), "wrong": (0.04, 2.0)}
"""Errors at rest within which a goal is reached [m, degree]."""
_WRONG = 0.03
"""Largest relative error of each parameter but the radius [-]."""
_FIX_EVERY, _FIX_LATE, _FIX_NOISE = 10.0, 0.2, np.repeat((5e-3, np.radians(0.5)), (2, 3))
"""Period and least age of a fix [s], and its noise [m, rad]."""


def tell(found: dict[str, Any], before: str = "") -> None:
    """Print figures, each after its names; lists with one for each run are left to the file."""
    for name, value in found.items():
        if isinstance(value, dict):
            tell(value, f"{before}{name}: ")
        elif not isinstance(value, list):
            print(f"{before}{name} {value if isinstance(value, int) else f'{value:.4g}'}")
        elif len(value) <= len(INSTANTS) and isinstance(value[0], float):
            print(f"{before}{name} " + "  ".join(f"{one:.4g}" for one in value), flush=True)


def off_goal(states: Vector, goal: Vector, limits: tuple[float, float]) -> tuple[Vector, Any]:
    """Return distance [m] and angle [deg] of states, (n, 6), to a goal, (n, 2), and who is out."""
    turned = np.degrees(angle_errors(states, goal))
    found = np.column_stack((position_errors(states, goal), turned))
    return found, np.any(found > limits, axis=1)


def goal_run(
    conditions: StudyConditions, scenario: Scenario, limits: tuple[float, float],
    wrong: float = 0.0, exact: bool = False,
) -> dict[str, float]:
    """Return the errors at the end of a run to a goal, and from when on it stays within limits."""
    simulator, imu, controller = world(conditions, scenario, wrong)
    own = OdometryPoses(simulator, imu, conditions.odometry, conditions.robot)
    made = simulator, controller
    run = closed_loop(conditions, scenario, made, poses=None if exact else own)
    off, is_out = off_goal(run.states, scenario.goal, limits)
    outside = np.flatnonzero(is_out)
    settled = run.times[outside[-1]] if outside.size else 0.0
    settled = math.inf if is_out[-1] else float(settled)
    return {"seed": scenario.seed, "position_m": float(off[-1, 0]), "angle_deg": float(off[-1, 1]),
            "settled_s": settled} | dict(zip(ODOMETRY_RESULT_COLUMNS, own.errors(), strict=True))


def goals(options: argparse.Namespace, part: str) -> dict[str, Any]:
    """Measure random goals, with exact parameters and exact poses as well, or with wrong ones."""
    wrong = _WRONG if part == "wrong" else 0.0
    more = [("odometry.constants_deviation", "0.02")] if wrong else []
    conditions, limits = conditions_of("rigid_body", *more), _LIMITS[part]
    scenarios = draw_scenarios(options.goals, options.seed)
    runs = [goal_run(conditions, one, limits, wrong) for one in shown(scenarios, part)]
    found: dict[str, Any] = {"within": sum(run["settled_s"] < math.inf for run in runs)}
    for name in ("position_m", "angle_deg"):
        found[name] = quantiles(np.array([run[name] for run in runs]))
    found["runs"] = runs
    if not wrong:
        found["exact"] = exact = [
            goal_run(conditions, one, limits, exact=True)
            for one in shown(scenarios, "exact poses")
        ]
        both = np.array([[run["settled_s"] for run in some] for some in (runs, exact)])
        both = both[:, np.isfinite(both).all(axis=0)]
        ratios = both[0] / both[1]
        found["pairs"] = both.shape[1]
        found["settling_over_exact"] = {"median": np.median(ratios), "mean": np.mean(ratios)}
        found["settling_means_s"] = both.mean(axis=1).tolist()
    return found


def fixes(options: argparse.Namespace) -> dict[str, Any]:
    """Measure the odometry over minutes of random goals, with late, noisy fixes."""
    conditions, duration = conditions_of("rigid_body"), 60.0 * options.minutes
    scenarios = draw_scenarios(round(duration), options.seed + 1)
    goal_of = iter(scenarios)
    simulator, imu, controller = world(conditions, scenarios[0])
    poses = OdometryPoses(simulator, imu, conditions.odometry, conditions.robot)
    rng, goal = np.random.default_rng([options.seed, 10]), next(goal_of).goal
    made: list[tuple[float, Vector]] = []
    errors: list[Vector] = []
    reached, since, near, used = 0, 0.0, 0.0, 0

    def observe() -> list[tuple[int, Vector]]:
        """Return the newest pose, after fixes that are due; a goal that is over is replaced."""
        nonlocal goal, reached, since, near, used
        now, state = simulator.time, simulator.plant.state
        found = poses()
        if now >= _FIX_EVERY * (len(made) + 1):
            made.append((now, apply_error(state, _FIX_NOISE * rng.normal(size=5))))
        if used < len(made) and now >= made[used][0] + _FIX_LATE:
            poses.odometry.correct(*made[used], np.diag(_FIX_NOISE**2))
            found, used = poses(), used + 1
        errors.append(world_error(found[-1][1], state))
        if off_goal(state[None], goal, _LIMITS["goals"])[1][0]:
            near = now
        if now >= min(near + 1.0, since + 12.0):
            reached, since, near, goal = reached + (now > near), now, now, next(goal_of).goal
            controller.set_goal(goal)
        return found

    run_closed_loop(simulator, controller, goal, duration, poses=observe)
    names = ("position_mm", "heading_deg", "tilt_deg")
    found = sizes(np.array(errors))
    return {"goals_reached": int(reached), "fixes_used": poses.odometry.fixes_used,
            "fixes_left_out": poses.odometry.fixes_left_out} | {
        name: {"rms": float(np.sqrt(np.mean(values**2))), "quantiles": quantiles(values)}
        for name, values in zip(names, found.T, strict=True)
    }


def cost(options: argparse.Namespace) -> dict[str, Any]:
    """Measure the processor time of an update by a reading of IMU and encoders."""
    result: dict[str, Any] = {}
    for rate in (100, 500):
        conditions = conditions_of("rigid_body", ("imu.rate", str(rate)))
        scenario = draw_scenarios(1, options.seed)[0]
        drive, took = recorded(conditions, scenario, 20.0), []
        settings = replace(conditions.odometry, initial_state=tuple(scenario.start.tolist()))
        odometry = Odometry(settings, conditions.imu, conditions.robot)
        for stamp, turning, force, angles, speeds, _ in zip(*drive, strict=True):
            began = time.thread_time()
            odometry.observe_imu(stamp, turning, force)
            odometry.observe_rotors(stamp, speeds, angles)
            took.append(time.thread_time() - began)
        # The readings at rest are the warm-up.
        kept = np.array(took)[drive.times > 0.0]
        median, p99 = 1e3 * np.quantile(kept, (0.5, 0.99))
        result[f"{rate} Hz"] = {
            "median_ms": median, "mean_ms": 1e3 * kept.mean(), "p99_ms": p99,
            "of_a_core_percent": 100.0 * rate * kept.mean(),
        }
    return result


def main() -> None:
    """Measure the parts that are wanted, print their figures and write them."""
    parts = ("goals", "wrong", "drift", "others", "fixes", "cost")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=parts, default=parts)
    parser.add_argument("--goals", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=50, help="drives on each plant")
    parser.add_argument("--minutes", type=float, default=20.0, help="length of the run with fixes")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--set", nargs="+", default=[], metavar="NAME=VALUE", help="as of study")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    limit_library_threads()
    for one in options.set:
        name, _, value = one.partition("=")
        FURTHER.append((name, value))
    result: dict[str, Any] = {"machine": machine()}
    measures: dict[str, Callable[[], dict[str, Any]]] = {
        "goals": lambda: goals(options, "goals"), "wrong": lambda: goals(options, "wrong"),
        "drift": lambda: drift(options.seeds, options.seed, "others" in options.parts),
        "fixes": lambda: fixes(options), "cost": lambda: cost(options),
    }
    wanted = {"drift" if part == "others" else part for part in options.parts}
    for part in (one for one in measures if one in wanted):
        result[part] = measures[part]()
        tell(result[part], f"{part}: ")
        write_json(options.json, result)


if __name__ == "__main__":
    main()

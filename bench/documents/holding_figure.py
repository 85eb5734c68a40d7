# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of docs/momentum.md: how long momentum can be held, and two closed loops that hold it.

    python bench/documents/holding_figure.py --out docs/momentum.svg

Left: time at an upright goal from rotors at rest until one is at its limit. Right: the plant with
contact at an upright goal: pushed at rest after it has rolled there, and on a slope until a rotor
is at its limit.
"""

import argparse
import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.disturbance import (
    Disturbance,
    imbalance_of_offset,
    rest_speeds,
    slope_torque,
    time_to_saturation,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import exponential
from sphere_nmpc.model.state import NO_MOMENTUM, QUATERNION, Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.metrics import SETTLED_ERROR, state_errors
from sphere_sim.report.figures.style import (
    BLUE,
    GREY,
    ROTORS,
    SMALLEST_ERROR,
    VERMILION,
    styled,
)
from sphere_sim.world.disturbances import DisturbanceSettings, Push
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
GOAL: Vector = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
SLOPES = np.geomspace(0.03, 3.0, 41)
"""Inclinations [degree]."""
OFFSETS = np.geomspace(0.05, 5.0, 41)
"""Distances of the centre of mass from the centre of the sphere [mm]."""
HEADINGS: Vector = np.radians(np.arange(0.0, 180.0, 15.0))
START: Vector = np.array([-1.0, 0.5, 1.0, 0.0, 0.0, 0.0])
"""Start of the run with a push: on the way to the goal the constants of the plant are learnt."""
PUSH = Push(8.0, (1.0, 0.0))
SLOPE = math.radians(0.5)


def times_on_slope(angle: float) -> tuple[float, float]:
    """Return the shortest and longest time [s] over all headings on a slope of `angle` [rad]."""
    disturbance = Disturbance(slope=slope_torque(ROBOT, angle, 0.0))
    turns = [exponential(np.array([0.0, 0.0, heading])) for heading in HEADINGS]
    times = [
        time_to_saturation(NO_MOMENTUM, disturbance, turn, ROBOT.max_rotor_speed) for turn in turns
    ]
    return min(times), max(times)


def time_out_of_balance(offset: float) -> float:
    """Return the time [s] with the centre of mass `offset` [m] along the axis of a rotor."""
    imbalance = imbalance_of_offset(ROBOT, np.array([offset, 0.0, 0.0]))
    disturbance = Disturbance(imbalance=imbalance)
    return time_to_saturation(NO_MOMENTUM, disturbance, GOAL[QUATERNION], ROBOT.max_rotor_speed)


def run(
    duration: float, start: Vector, push: Push | None = None, slope: float = 0.0
) -> Trajectory:
    """Return a run of `duration` [s] from `start`, (6,), with the default strategy."""
    settings = ControllerSettings()
    plant = RigidBodyPlant(ROBOT, start, disturbances=DisturbanceSettings(slope=slope))
    world = SimulatorSettings(initial_state=tuple(start.tolist()))
    return run_closed_loop(
        Simulator(world, ROBOT, plant), Controller(settings, ROBOT), GOAL, duration,
        settings.control_period, push=push,
    )


def draw_times(on_slope: Axes, out_of_balance: Axes) -> None:
    """Draw how long an upright goal can be held."""
    worst, best = np.array([times_on_slope(math.radians(angle)) for angle in SLOPES]).T
    on_slope.loglog(SLOPES, best, color=BLUE, linestyle="--", label="best heading")
    on_slope.loglog(SLOPES, worst, color=VERMILION, label="worst heading")
    on_slope.set_title("a: time on a slope")
    on_slope.set_xlabel("inclination [°]")
    on_slope.legend()
    times = [time_out_of_balance(1e-3 * offset) for offset in OFFSETS]
    out_of_balance.loglog(OFFSETS, times, color=VERMILION, label="worst orientation")
    out_of_balance.set_title("b: time out of balance, without unloading")
    out_of_balance.set_xlabel("offset of the centre of mass [mm]")
    out_of_balance.legend()
    for axes in (on_slope, out_of_balance):
        axes.set_ylabel("time until saturation [s]")


def draw_run(found: Trajectory, error: Axes, speed: Axes, name: str) -> None:
    """Draw errors and rotor speeds of a run, with the speeds of rest by the estimated momentum."""
    errors = state_errors(found.states, GOAL)
    error.semilogy(found.times, np.maximum(errors, SMALLEST_ERROR), color=BLUE)
    error.axhline(SETTLED_ERROR, color=GREY, linestyle=":", label="settled below")
    error.set_title(f"{name}: error")
    error.set_ylabel(r"$\|x - x_d\|$ [m, -]")
    error.legend()
    samples = ControllerSettings().control_period * np.arange(len(found.decisions))
    rest = np.array([rest_speeds(d.momentum, GOAL[QUATERNION]) for d in found.decisions])
    for rotor, colour in enumerate(ROTORS):
        speed.plot(found.times, found.rotor_speeds.values[:, rotor], color=colour,
                   label=f"rotor {rotor + 1}")
        speed.plot(samples, rest[:, rotor], color=colour, linestyle="--",
                   label=f"rotor {rotor + 1}, speed of rest")
    limit = ROBOT.max_rotor_speed
    for side, label in ((-limit, "limit"), (limit, None)):
        speed.axhline(side, color=GREY, linestyle=":", label=label)
    speed.set_ylim(-1.3 * limit, 1.3 * limit)
    speed.set_title(f"{name}: rotor speeds")
    speed.set_ylabel("rotor speed [rad/s]")
    speed.set_xlabel("time [s]")


def main() -> None:
    """Write the figure."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("docs/momentum.svg"))
    parser.add_argument("--duration", type=float, default=12.0)
    arguments = parser.parse_args()
    dated = {"Date": None} if arguments.out.suffix == ".svg" else None
    with styled():
        figure = Figure(figsize=(12.0, 6.4), layout="constrained")
        rows = figure.subplots(2, 3)
        draw_times(rows[0, 0], rows[1, 0])
        pushed = run(arguments.duration, START, push=PUSH)
        draw_run(pushed, rows[0, 1], rows[1, 1], f"c: push of 1 N s at {PUSH.time:g} s")
        tilted = run(arguments.duration, GOAL, slope=SLOPE)
        draw_run(tilted, rows[0, 2], rows[1, 2], "d: slope of 0.5°")
        rows[1, 1].legend(loc="lower right")
        figure.savefig(arguments.out, metadata=dated)


if __name__ == "__main__":
    main()

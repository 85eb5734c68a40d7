# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop on a slippery or tilted floor, with weak drives, and under pushes.

``python bench/documents/contact_events.py`` prints a table for docs/rigid_body.md: the paper's
cases on the plant with contact, each for 20 s.
"""

import argparse
import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.evaluation.metrics import (
    angle_errors,
    position_errors,
    settling_index,
    state_errors,
)
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.disturbances import DisturbanceSettings, Push
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
TAIL = 5.0
"""Length of the end of a run over which errors are reported [s]."""


@dataclass(frozen=True)
class Event:
    """A disturbance of a run, and the part of it that the controller knows."""

    name: str
    case: int
    world: dict[str, Any] = field(default_factory=dict)
    modelled: dict[str, Any] = field(default_factory=dict)
    slope: float = 0.0
    push: Push | None = None


SLIPPERY = {"friction": 0.2}
SLOWER = {"max_rotor_acceleration": 250.0}
WEAK = {"torque_limit": 1.6}
EVENTS = (
    Event("friction 0.2", 1, SLIPPERY),
    Event("friction 0.2", 2, SLIPPERY),
    Event("friction 0.2", 3, SLIPPERY),
    Event("the same, `max_rotor_acceleration` 250", 1, SLIPPERY, SLOWER),
    Event("the same, `max_rotor_acceleration` 250", 2, SLIPPERY, SLOWER),
    Event("the same, `max_rotor_acceleration` 250", 3, SLIPPERY, SLOWER),
    Event("drives of 1.6 N m", 1, WEAK),
    Event("the same, `max_rotor_torque` 1.6", 1, WEAK, {"max_rotor_torque": 1.6}),
    Event("push of 1 N s at rest, at 12 s", 3, push=Push(12.0, (1.0, 0.0))),
    Event("push of 1 N s in motion, at 2 s", 1, push=Push(2.0, (1.0, 0.0))),
    Event("push of 0.1 N s in motion, at 2 s", 1, push=Push(2.0, (0.1, 0.0))),
    Event("slope of 0.1 degree", 1, slope=math.radians(0.1)),
    Event("slope of 1 degree", 1, slope=math.radians(1.0)),
)


def run(event: Event, strategy: str, duration: float) -> str:
    """Return the row of a run."""
    scenario = PAPER_CASES[event.case]
    plant = RigidBodyPlant(
        ROBOT, scenario.start, RigidBodySettings(**event.world),
        DisturbanceSettings(slope=event.slope),
    )
    world = SimulatorSettings(initial_state=tuple(float(v) for v in scenario.start))
    settings = ControllerSettings(strategy=strategy)
    found = run_closed_loop(
        Simulator(world, ROBOT, plant), Controller(settings, replace(ROBOT, **event.modelled)),
        scenario.goal, duration, settings.control_period, push=event.push,
    )
    index = settling_index(state_errors(found.states, scenario.goal))
    settled = "no" if index is None else f"{found.times[index]:.1f} s"
    tail = found.states[found.times > duration - TAIL]
    position = position_errors(tail, scenario.goal)
    angle = np.degrees(angle_errors(tail, scenario.goal))
    return (
        f"| {event.name} | {event.case} | {strategy} | {settled} "
        f"| {np.median(position):.3f} m, {np.median(angle):.1f}° "
        f"| {np.max(position):.3f} m, {np.max(angle):.1f}° |"
    )


def main() -> None:
    """Print a row for each event and strategy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=20.0)
    arguments = parser.parse_args()
    print("| what happens | case | strategy | settled | last 5 s, median | last 5 s, largest |")
    print("|---|---|---|---|---|---|")
    for event in EVENTS:
        for strategy in ("paper", "time_optimal"):
            print(run(event, strategy, arguments.duration), flush=True)


if __name__ == "__main__":
    main()

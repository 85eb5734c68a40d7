# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop on a slippery or tilted floor, with weak drives, and under pushes.

``python bench/documents/contact_events.py`` prints a table for docs/rigid_body.md: the paper's
cases on the plant with contact, each for 20 s.
"""

import argparse
import itertools
import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from tables import header, row

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.evaluation.metrics import angle_errors, position_errors, state_errors, stay_below
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
    cases: tuple[int, ...]
    world: dict[str, Any] = field(default_factory=dict)
    modelled: dict[str, Any] = field(default_factory=dict)
    slope: float = 0.0
    push: Push | None = None


SLIPPERY, SLOWER = {"friction": 0.2}, {"max_rotor_acceleration": 250.0}
WEAK = {"torque_limit": 1.6}
EVENTS = (
    Event("friction 0.2", (1, 2, 3), SLIPPERY),
    Event("the same, `max_rotor_acceleration` 250", (1, 2, 3), SLIPPERY, SLOWER),
    Event("drives of 1.6 N m", (1,), WEAK),
    Event("the same, `max_rotor_torque` 1.6", (1,), WEAK, {"max_rotor_torque": 1.6}),
    Event("push of 1 N s at rest, at 12 s", (3,), push=Push(12.0, (1.0, 0.0))),
    Event("push of 1 N s in motion, at 2 s", (1,), push=Push(2.0, (1.0, 0.0))),
    Event("push of 0.1 N s in motion, at 2 s", (1,), push=Push(2.0, (0.1, 0.0))),
    Event("slope of 0.1 degree", (1,), slope=math.radians(0.1)),
    Event("slope of 1 degree", (1,), slope=math.radians(1.0)),
)


def run(event: Event, case: int, strategy: str, duration: float) -> str:
    """Return the row of a run."""
    scenario = PAPER_CASES[case]
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
    stay = stay_below(found.times, state_errors(found.states, scenario.goal))
    settled = "no" if stay is None else f"{stay.since:.1f} s"
    tail = found.states[found.times > duration - TAIL]
    position = position_errors(tail, scenario.goal)
    angle = np.degrees(angle_errors(tail, scenario.goal))
    return row(
        event.name, case, strategy, settled,
        *(f"{of(position):.3f} m, {of(angle):.1f}°" for of in (np.median, np.max)),
    )


def main() -> None:
    """Print a row for each event and strategy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=20.0)
    arguments = parser.parse_args()
    print(header("what happens", "case", "strategy", "settled", "last 5 s, median",
                 "last 5 s, largest"))
    for event in EVENTS:
        for case, strategy in itertools.product(event.cases, ("paper", "time_optimal")):
            print(run(event, case, strategy, arguments.duration), flush=True)


if __name__ == "__main__":
    main()

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of plants and models on rotor speeds that ramp between knots, without a controller.

    python bench/documents/open_loops.py robots       # docs/rigid_body.md, robots of all sizes
    python bench/documents/open_loops.py momentum     # docs/momentum.md, model with momentum

`compare_plants.py` makes its figures of the same runs.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from sized_robots import ROBOTS
from tables import Row, Table, drawn, median_and_worst, print_tables

from sphere_nmpc.model.disturbance import GRAVITY, UNDISTURBED, Disturbance, momentum_of_push
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import MOMENTUM, NO_MOMENTUM, POSITION, Vector, without_momentum
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.evaluation.metrics import angle_errors
from sphere_sim.scenario.perturbation import DisturbanceDraws
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.motion import disturbance_of
from sphere_sim.world.disturbances import DisturbanceSettings, Push
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
STEP = 0.01
"""Step of the simulator between two samples of the command [s]."""
KNOT_PERIOD = 0.5
"""Length of a ramp, where it is not said [s]."""


def ramped(knots: Vector, steps: int = round(KNOT_PERIOD / STEP)) -> Vector:
    """Return the speeds at the start and after each step of ramps from rest to knots, (K, 2)."""
    knots = np.vstack((np.zeros(2), knots))
    shares = (np.arange(steps) + 1.0)[:, None] / steps
    ends = knots[:-1, None] + shares * np.diff(knots, axis=0)[:, None]
    return np.vstack((np.zeros(2), ends.reshape(-1, 2)))


def run(plant: Any, speeds: Vector, step: float = STEP, push: Push | None = None) -> Vector:
    """Return the states of a plant after each step of `ramped` speeds, shape (steps, 6)."""
    states = []
    for k, there in enumerate(speeds[1:]):
        if push is not None and k == round(push.time / step):
            plant.push(push.impulse)
        plant.advance(there, step)
        states.append(plant.state)
    return np.array(states)


def deviation(states: Vector, reference: Vector) -> tuple[float, float]:
    """Return the largest distance [m] and angle [rad] between two runs."""
    distance = np.linalg.norm(states[:, POSITION] - reference[:, POSITION], axis=1)
    return float(distance.max()), float(angle_errors(states, reference).max())


# The plant with contact and ideal rolling, for robots of all sizes.

_RAMPS, _STEPS = 10, 50
"""Ramps of a sequence, and steps of the simulator on each."""


def _of_robots(number: int) -> Iterator[Row]:
    for name, robot in ROBOTS.items():
        own = RigidBodySettings().for_robot(robot)
        about = (name, f"{own.drive_bandwidth:.0f}", f"{own.torque_limit:.3g}",
                 f"{1e3 * own.time_step:g}")
        yield Row(about, [(robot, seed) for seed in range(number)])


def _from_rolling(robot: RobotParameters, seed: int) -> tuple[float, float, float]:
    """Return the largest distance [radii] and angle [rad] within a sequence.

    The rotor speeds are uniform in half their range, at which no robot here slips, on the
    shortest ramps allowed. The last is the friction at which a curve at full speed does not slip,
    to first order [-].
    """
    limit, rng = 0.5 * robot.max_rotor_speed, np.random.default_rng([0, seed])
    step = 2.0 * limit / robot.max_rotor_acceleration / _STEPS
    start = np.concatenate(([0.0, 0.0], random_quaternion(rng)))
    speeds = ramped(rng.uniform(-limit, limit, (_RAMPS, 2)), _STEPS)
    contact, ideal = (run(kind(robot, start), speeds, step)
                      for kind in (RigidBodyPlant, RollingPlant))
    distance, angle = deviation(contact, ideal)
    rate = math.sqrt(2.0) * robot.lumped.input_gain * robot.max_rotor_speed
    return distance / robot.shell_radius, angle, robot.shell_radius * rate**2 / GRAVITY


def _cells_of_robots(found: list[Any]) -> list[str]:
    distances, angles, (friction, *_) = np.array(found).T
    return [*(median_and_worst(each, ".2g") for each in (distances, angles)), f"{friction:.2g}"]


# The model with momentum, and that of the paper, from plants with disturbances.

_CONTACT = RigidBodySettings(
    drive_bandwidth=1e6, drive_feedforward=True, torque_limit=1e3, friction=2.0,
    time_step=5e-4, contact_time_constant=1e-3,
)
_SPEED, _KNOTS, _PUSH_TIME = 60.0, 6, 1.0
_DISTURBANCES = {  # push [N s], slope [degree], offset [mm]
    "none": (0.0, 0.0, 0.0),
    "push of 1 N s after 1 s": (1.0, 0.0, 0.0),
    "slope of 1°": (0.0, 1.0, 0.0),
    "centre of mass 1 mm off": (0.0, 0.0, 1.0),
    "centre of mass 3 mm off": (0.0, 0.0, 3.0),
    "push 0.5 N s, 0.3°, 0.5 mm together": (0.5, 0.3, 0.5),
}


def _of_momentum(number: int) -> Iterator[Row]:
    for name, (push, slope, offset) in _DISTURBANCES.items():
        impulses = (push, push) if push else None
        draws = DisturbanceDraws(impulses, _PUSH_TIME, math.radians(slope), 1e-3 * offset)
        scenarios = drawn(StudyConditions(), number, 0, draws=draws)
        yield Row((name,), [(one,) for one in scenarios])


def _model_states(
    scenario: Scenario, speeds: Vector, disturbance: Disturbance, jump: Vector
) -> Vector:
    """Return the states of the model after each step, shape (steps, 9)."""
    states, state = [], without_momentum(scenario.start)
    durations, constants = np.array([STEP]), ROBOT.lumped.as_array()
    for step, ends in enumerate(pairwise(speeds)):
        if step == round(_PUSH_TIME / STEP):
            state[MOMENTUM] += jump
        inputs = np.array(ends)
        state = roll_out(state, inputs, durations, constants, disturbance=disturbance)[-1]
        states.append(state)
    return np.array(states)


def _from_plants(scenario: Scenario) -> Vector:
    """Return deviations [m, rad] of both models from the plants, shape (3, 2).

    The model with momentum from `rigid_body` and from `rolling`, the paper's from `rigid_body`.
    """
    knots = np.random.default_rng(scenario.seed).uniform(-_SPEED, _SPEED, (_KNOTS, 2))
    speeds, settings = ramped(knots), DisturbanceSettings(**scenario.disturbances)
    contact, ideal = (run(plant, speeds, push=scenario.push) for plant in (
        RigidBodyPlant(ROBOT, scenario.start, _CONTACT, settings),
        RollingPlant(ROBOT, scenario.start, settings),
    ))
    impulse = (0.0, 0.0) if scenario.push is None else scenario.push.impulse
    jump = momentum_of_push(ROBOT, np.array(impulse))
    model = _model_states(scenario, speeds, disturbance_of(settings, ROBOT), jump)
    paper = _model_states(scenario, speeds, UNDISTURBED, NO_MOMENTUM)
    pairs = (model, contact), (model, ideal), (paper, contact)
    return np.array([deviation(*pair) for pair in pairs])


def _cells_of_momentum(found: list[Vector]) -> list[str]:
    cells = []
    for pair in np.swapaxes(found, 0, 1):
        sizes = (of(pair, axis=0) for of in (np.median, np.max))
        median, worst = (f"{p:.4f} m, {math.degrees(a):.2f}°" for p, a in sizes)
        cells.append(f"{median} ({worst})")
    return cells


TABLES = {
    "robots": Table(
        ("radius", "bandwidth [rad/s]", "torque limit [N m]", "time step [ms]",
         "deviation, median (worst) [radii]", "angle [rad]", "friction needed at full speed"),
        _of_robots, _from_rolling, _cells_of_robots, number=20,
    ),
    "momentum": Table(
        ("disturbance", "with momentum, from `rigid_body`: median (worst)",
         "with momentum, from `rolling`", "paper's model, from `rigid_body`"),
        _of_momentum, _from_plants, _cells_of_momentum, number=100,
    ),
}

if __name__ == "__main__":
    print_tables(TABLES, __doc__)

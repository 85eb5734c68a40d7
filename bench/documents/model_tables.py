# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of plants, models and integrators on ramps of the rotor speeds, and of Algorithm 1.

    python bench/documents/model_tables.py robots       # docs/rigid_body.md, robots of all sizes
    python bench/documents/model_tables.py momentum     # docs/momentum.md, model with momentum
    python bench/documents/model_tables.py stability    # docs/model.md, Theorem 3 along its loops
    python bench/documents/model_tables.py integrator   # docs/model.md, error by number of steps
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from sized_robots import ROBOTS
from tables import Row, Table, drawn, median_and_worst, print_tables

from sphere_nmpc.control.stability import Sample, StabilityMonitor
from sphere_nmpc.model.disturbance import GRAVITY, UNDISTURBED, Disturbance, momentum_of_push
from sphere_nmpc.model.dynamics import state_rate
from sphere_nmpc.model.integrator import step_function
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import (
    INPUT_SIZE,
    MOMENTUM,
    NO_MOMENTUM,
    POSITION,
    QUATERNION,
    Vector,
    upright_state,
    without_momentum,
)
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.problem import SolverSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.solver.solve import solve
from sphere_sim.benchmark.problem import paper_problem, shifted
from sphere_sim.evaluation.metrics import angle_errors
from sphere_sim.scenario.perturbation import DisturbanceDraws
from sphere_sim.scenario.scenarios import PAPER_CASES, Scenario
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


def _of_robots(number: int, seed: int) -> Iterator[Row]:
    for name, robot in ROBOTS.items():
        own = RigidBodySettings().for_robot(robot)
        about = (name, f"{own.drive_bandwidth:.0f}", f"{own.torque_limit:.3g}",
                 f"{1e3 * own.time_step:g}")
        yield Row(about, [(robot, seed, k) for k in range(number)])


def _from_rolling(robot: RobotParameters, *seed: int) -> tuple[float, float, float]:
    """Return the largest distance [radii] and angle [rad] within a sequence.

    The rotor speeds are uniform in half their range, at which no robot here slips, on the
    shortest ramps allowed. The last is the friction at which a curve at full speed does not slip,
    to first order [-].
    """
    limit, rng = 0.5 * robot.max_rotor_speed, np.random.default_rng(seed)
    step = 2.0 * limit / robot.max_rotor_acceleration / _STEPS
    start = np.concatenate(([0.0, 0.0], random_quaternion(rng)))
    speeds = ramped(rng.uniform(-limit, limit, (_RAMPS, 2)), _STEPS)
    contact, ideal = (run(kind(robot, start), speeds, step)
                      for kind in (RigidBodyPlant, RollingPlant))
    distance, angle = deviation(contact, ideal)
    rate = math.sqrt(2.0) * robot.lumped.input_gain * robot.max_rotor_speed
    return distance / robot.shell_radius, angle, robot.shell_radius * rate**2 / GRAVITY


def _cells_of_robots(found: list[Any], _: object) -> list[str]:
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


def _of_momentum(number: int, seed: int) -> Iterator[Row]:
    for name, (push, slope, offset) in _DISTURBANCES.items():
        impulses = (push, push) if push else None
        draws = DisturbanceDraws(impulses, _PUSH_TIME, math.radians(slope), 1e-3 * offset)
        scenarios = drawn(StudyConditions(), number, seed, draws=draws)
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


def _cells_of_momentum(found: list[Vector], _: object) -> list[str]:
    cells = []
    for pair in np.swapaxes(found, 0, 1):
        sizes = (of(pair, axis=0) for of in (np.median, np.max))
        median, worst = (f"{p:.4f} m, {math.degrees(a):.2f}°" for p, a in sizes)
        cells.append(f"{median} ({worst})")
    return cells


# Frequency with which Eq. (42), the conclusion of Theorem 3, holds along Algorithm 1.

_PAPER = ControllerSettings(strategy="paper")
_SAMPLES = 40
"""Samples of a run, 20 s."""
_HEADINGS = np.linspace(0.03, 2.5, 19)
"""Errors of the heading alone [rad], from an upright start in place."""


def _of_stability(number: int, seed: int) -> Iterator[Row]:
    drawn_ones = drawn(StudyConditions(), number, seed)
    upright = upright_state(0.0, 0.0, 0.0)
    turned = [Scenario(upright, upright_state(0.0, 0.0, angle)) for angle in _HEADINGS]
    runs = {f"case {case}": [scenario] for case, scenario in PAPER_CASES.items()}
    runs |= {"random": drawn_ones, "upright, only the heading wrong": turned}
    for name, scenarios in runs.items():
        yield Row((name, len(scenarios)), [(one.start, one.goal) for one in scenarios])


def _along_algorithm_1(start: Vector, goal: Vector) -> tuple[int, int, int, float]:
    """Return how many steps of a run, started with u = 0 on the exact model, are outside of D.

    For how many of them Eq. (42) holds and the error falls, and the time at which the run is
    first inside [s], inf for one that is not.
    """
    limits = SolverSettings(max_iterations=_PAPER.max_iterations)
    plant, monitor = RollingPlant(ROBOT, start), StabilityMonitor()
    guess: Vector = np.zeros((_PAPER.horizon, INPUT_SIZE))
    speeds, inside, beta = np.zeros(INPUT_SIZE), math.inf, _PAPER.terminal_weight
    for k in range(_SAMPLES):
        state, now = plant.state, k * _PAPER.period
        problem = replace(paper_problem(state, goal, speeds), max_step=_PAPER.longest_step)
        solution = solve(problem, guess, limits)
        speeds, guess = solution.inputs[1], shifted(solution.inputs)
        report = monitor.update(Sample(
            time=now, state=state, goal=goal,
            # The problem is over beta and lacks the stage cost of the state itself.
            value=beta * solution.cost + float(np.sum((state - goal) ** 2)), next_input=speeds,
            weights=(_PAPER.alpha, beta, ROBOT.max_rotor_speed),
        ))
        inside = min(inside, now) if report.inside else inside
        plant.advance(speeds, _PAPER.period)
    judged = report.judged
    return judged, judged - report.violations, judged - report.not_nearer, inside


def _cells_of_stability(found: list[Any], _: object) -> list[object]:
    *counts, inside = np.array(found).T
    reached = inside[np.isfinite(inside)]
    when = f"{min(reached):.1f} to {max(reached):.1f} s" if reached.size else "-"
    return [*(int(count.sum()) for count in counts), reached.size, when]


# Error of the integrators over one sample period, by the number of steps.

_PERIOD, _TRUTH_STEPS = 0.5, 400


@cache
def _runge_kutta_step() -> ca.Function:
    """Return the classical method of order four on R^6, with the signature of the other one."""
    x, p, h = ca.SX.sym("x", 6), ca.SX.sym("p", 4), ca.SX.sym("h")
    u_start, u_end = ca.SX.sym("u_start", 2), ca.SX.sym("u_end", 2)
    middle = 0.5 * (u_start + u_end)
    k1 = state_rate(x, u_start, p)
    k2 = state_rate(x + 0.5 * h * k1, middle, p)
    k3 = state_rate(x + 0.5 * h * k2, middle, p)
    k4 = state_rate(x + h * k3, u_end, p)
    end = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function("rk4_step", [x, u_start, u_end, h, p], [end])


_METHODS = {"CF4": step_function, "RK4": _runge_kutta_step}
"""The Lie-group method, with which both are compared at many steps, and the other one."""


def _of_integrator(number: int, seed: int) -> Iterator[Row]:
    for speeds in ("random", "full"):
        for steps in (2, 3, 4, 5, 8, 10, 16, 20, 32, 64):
            yield Row((speeds, steps), [(speeds, steps, number, seed)])


@cache
def _ends(method: str, speeds: str, steps: int, number: int, seed: int) -> Vector:
    """Return the states after the interval, shape (6, K).

    Orientations are uniform on SO(3), rotor speeds uniform in +-100 rad/s at both ends, or full.
    """
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(4, number))
    x = np.vstack((np.zeros((2, number)), quaternions / np.linalg.norm(quaternions, axis=0)))
    first, last = rng.uniform(-100.0, 100.0, size=(2, 2, number))
    if speeds == "full":
        first = last = 100.0 * np.sign(last)
    many, p = _METHODS[method]().map(number), ROBOT.lumped.as_array()
    for i in range(steps):
        here, there = (first + (last - first) * (k / steps) for k in (i, i + 1))
        x = np.array(many(x, here, there, _PERIOD / steps, p))
    return x


def _errors(speeds: str, steps: int, *drawn: int) -> dict[str, list[float]]:
    """Return median, 99 % and worst error, the order by twice the steps, and the 99 % of |q| - 1.

    By method.
    """
    truth, found = _ends("CF4", speeds, _TRUTH_STEPS, *drawn), {}
    for name in _METHODS:
        ends = _ends(name, speeds, steps, *drawn)
        error, finer = (np.linalg.norm(one - truth, axis=0) for one in (
            ends, _ends(name, speeds, 2 * steps, *drawn)
        ))
        norm = np.abs(np.linalg.norm(ends[QUATERNION], axis=0) - 1.0)
        found[name] = [
            *np.quantile(error, [0.5, 0.99, 1.0]).tolist(),
            float(np.log2(np.median(error) / np.median(finer))), float(np.quantile(norm, 0.99)),
        ]
    return found


def _cells_of_integrator(found: list[Any], _: object) -> Iterator[str]:
    for *errors, order, norm in found[0].values():
        yield from (*(f"{error:.1e}" for error in errors), f"{order:.2f}", f"{norm:.0e}")


TABLES = {
    "robots": Table(
        ("radius", "bandwidth [rad/s]", "torque limit [N m]", "time step [ms]",
         "deviation, median (worst) [radii]", "angle [rad]", "friction needed at full speed"),
        _of_robots, _from_rolling, _cells_of_robots, number=20, seed=0,
    ),
    "momentum": Table(
        ("disturbance", "with momentum, from `rigid_body`: median (worst)",
         "with momentum, from `rolling`", "paper's model, from `rigid_body`"),
        _of_momentum, _from_plants, _cells_of_momentum, number=100, seed=0,
    ),
    "stability": Table(
        ("runs", "number", "steps outside D", "Eq. (42) holds", "error falls", "reach D", "after"),
        _of_stability, _along_algorithm_1, _cells_of_stability, number=12,
    ),
    "integrator": Table(
        ("rotor speeds", "steps", *(f"{name} {each}" for name in _METHODS for each in (
            "median", "p99", "worst", "order", "norm of q off by, p99"))),
        _of_integrator, _errors, _cells_of_integrator, number=2000, seed=0,
    ),
}

if __name__ == "__main__":
    print_tables(TABLES, __doc__)

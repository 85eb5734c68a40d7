# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Error of the integrators over one sample period, against the number of steps.

Draws orientations uniform on SO(3) and rotor speeds uniform in +-100 rad/s at both ends of an
interval of 0.5 s, and compares with the Lie-group method at 400 steps. Prints a table for
``docs/model.md`` and draws its figure:

    python bench/documents/integrator_convergence.py --out docs/integrator_convergence.svg
"""

import argparse
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import casadi as ca
import numpy as np
from tables import header, row

from sphere_nmpc.model.dynamics import state_rate
from sphere_nmpc.model.integrator import step_function
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector

PERIOD = 0.5
STEPS = (2, 3, 4, 5, 8, 10, 16, 20, 32, 64)
TRUTH_STEPS = 400


class Draws(NamedTuple):
    """States, shape (6, K), and rotor speeds at both ends of the interval, shape (2, K)."""

    states: Vector
    u_start: Vector
    u_end: Vector


def draw(number: int, seed: int) -> Draws:
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(4, number))
    states = np.vstack((np.zeros((2, number)), quaternions / np.linalg.norm(quaternions, axis=0)))
    return Draws(states, *rng.uniform(-100.0, 100.0, size=(2, 2, number)))


@cache
def runge_kutta_step() -> ca.Function:
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


def integrate_all(step: ca.Function, draws: Draws, steps: int) -> Vector:
    """Return the states after the interval, shape (6, K)."""
    number = draws.states.shape[1]
    many, p = step.map(number), RobotParameters().lumped.as_array()
    x = draws.states
    for i in range(steps):
        here = draws.u_start + (draws.u_end - draws.u_start) * (i / steps)
        there = draws.u_start + (draws.u_end - draws.u_start) * ((i + 1) / steps)
        x = np.array(many(x, here, there, PERIOD / steps, p))
    return x


METHODS: dict[str, Callable[[], ca.Function]] = {"CF4": step_function, "RK4": runge_kutta_step}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", help="figure to write")
    arguments = parser.parse_args()
    draws = draw(arguments.draws, arguments.seed)
    found = all_errors(draws)
    print_table("random speeds", found)
    full = 100.0 * np.sign(draws.u_end)
    print_table("full speed", all_errors(Draws(draws.states, full, full)))
    for name in METHODS:
        medians = [np.median(found[name, n]) for n in (16, 32, 64)]
        slopes = -np.diff(np.log2(medians))
        print(f"order of {name} from 16 to 32 to 64 steps: {slopes[0]:.2f}, {slopes[1]:.2f}")
    for name, steps in (("CF4", TRUTH_STEPS), ("CF4", 5), ("RK4", 5)):
        ends = integrate_all(METHODS[name](), draws, steps)
        drift = np.quantile(np.abs(np.linalg.norm(ends[QUATERNION], axis=0) - 1.0), 0.99)
        print(f"||q| - 1| after {steps} steps of {name}: 99th percentile {drift:.1e}")
    if arguments.out:
        plot(found, arguments.out)


def all_errors(draws: Draws) -> dict[tuple[str, int], Vector]:
    truth = integrate_all(step_function(), draws, TRUTH_STEPS)
    return {
        (name, steps): np.linalg.norm(integrate_all(make(), draws, steps) - truth, axis=0)
        for name, make in METHODS.items()
        for steps in STEPS
    }


def print_table(title: str, found: dict[tuple[str, int], Vector]) -> None:
    columns = ("CF4 median", "p99", "worst", "RK4 median", "p99", "worst")
    print(header(f"{title}: steps", *columns))
    for steps in STEPS:
        quantiles = [np.quantile(found[name, steps], [0.5, 0.99, 1.0]) for name in METHODS]
        print(row(steps, *(f"{value:.1e}" for value in np.concatenate(quantiles))))


def plot(found: dict[tuple[str, int], Vector], path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["svg.hashsalt"] = "integrator"
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for name, colour in (("CF4", "tab:blue"), ("RK4", "tab:orange")):
        values = np.array([np.quantile(found[name, n], [0.5, 0.99]) for n in STEPS])
        axes.loglog(STEPS, values[:, 0], "o-", color=colour, label=f"{name}, median")
        axes.loglog(STEPS, values[:, 1], "o--", color=colour, label=f"{name}, 99th percentile")
    steps = np.array([8.0, 64.0])
    axes.loglog(steps, 2e-5 * (steps / 8.0) ** -4, "k:", label="order 4")
    axes.set_xticks(STEPS, [str(n) for n in STEPS])
    axes.minorticks_off()
    axes.set_ylim(1e-10, 10.0)
    axes.set_xlabel("steps in one sample period of 0.5 s")
    axes.set_ylabel("error of the state after it, in R$^6$")
    axes.grid(True, alpha=0.3)
    axes.legend()
    figure.savefig(path, metadata={"Date": None} if path.endswith(".svg") else None)


if __name__ == "__main__":
    main()

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Derivatives of the plain solver, with which the compiled one is compared; its interrupts."""

import subprocess
import sys

import numpy as np
import pytest
from compiled_solver import expand_compiled
from patience import PATIENCE

from sphere_nmpc.solver.plain import expand

STEP = 1e-6  # of a scaled input; a central difference is then good to about 1e-9
ROUNDING = 1e-12

INTERRUPTED_SOLVES = """
import os, random, signal, threading, time
import numpy as np
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.solver.plain import minimise
from sphere_nmpc.solver.problem import HoldProblem, SolverSettings

handled = seen = 0
armed = False

def interrupt(number, frame):
    global armed, handled
    # Only what arrives during a solve counts, and each solve is interrupted once.
    if armed:
        armed = False
        handled += 1
        raise KeyboardInterrupt

n = 12
problem = HoldProblem(
    np.array([1.0, 0.5, 1.0, 0, 0, 0]), np.array([0, 0, 0, 1.0, 0, 0]), np.zeros(2),
    np.full(n, 0.5), RobotParameters().lumped.as_array(), np.full((n, 2), -100.0),
    np.full((n, 2), 100.0), 100.0, input_weight=1e-12, slew_weight=10.0, max_acceleration=400.0,
)
rng = np.random.default_rng(0)
minimise(problem, np.zeros((n, 2)), SolverSettings(max_iterations=0))

def send():
    while True:
        time.sleep(random.uniform(0.005, 0.02))
        os.kill(os.getpid(), signal.SIGINT)

signal.signal(signal.SIGINT, interrupt)
threading.Thread(target=send, daemon=True).start()
while handled < 50:
    before = handled
    try:
        armed = True
        while handled == before:
            minimise(problem, rng.uniform(-100.0, 100.0, (n, 2)), SolverSettings(max_iterations=5))
        print("lost")
        break
    except KeyboardInterrupt:
        seen += 1
signal.signal(signal.SIGINT, signal.SIG_IGN)
print(handled, seen)
"""


def test_derivatives_agree_with_finite_differences(make_problem, kind):
    problem = make_problem(kind)
    v = np.random.default_rng(1).uniform(-0.9, 0.9, 2 * problem.intervals)
    here = expand(problem, v)
    for i in range(v.size):
        change = np.zeros(v.size)
        change[i] = STEP
        ahead, behind = expand(problem, v + change), expand(problem, v - change)
        slope = (ahead.cost - behind.cost) / (2.0 * STEP)
        assert slope == pytest.approx(here.gradient[i], abs=1e-6, rel=1e-6)
        after, before = (np.hstack(end.motion[:2]) for end in (ahead, behind))
        found = (after - before) / (2.0 * STEP * problem.input_scale)
        assert np.allclose(found, here.motion.derivatives[:, :, i], atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_compiled_expansion_agrees(make_problem, kind, seed):
    problem = make_problem(kind, seed)
    knots = np.random.default_rng(seed).uniform(-100.0, 100.0, (problem.intervals, 2))
    right = expand(problem, knots.ravel() / problem.input_scale)
    found = expand_compiled(problem, knots)
    scale = max(1.0, np.max(np.abs(right.hessian)))
    assert found["cost"] == pytest.approx(right.cost, rel=ROUNDING)
    assert np.max(np.abs(found["states"] - right.motion.states)) < ROUNDING
    sensitivities = right.motion.derivatives[:, :6]
    assert np.max(np.abs(found["sensitivities"] - sensitivities)) < ROUNDING
    assert np.max(np.abs(found["gradient"] - right.gradient)) < ROUNDING * scale
    assert np.max(np.abs(found["hessian"] - right.hessian)) < ROUNDING * scale


def test_every_interrupt_of_a_solve_is_raised():
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_SOLVES], capture_output=True, text=True,
        timeout=PATIENCE, check=False,
    )
    assert done.returncode == 0, done.stderr
    handled, seen = done.stdout.split()
    assert int(handled) >= 50 and handled == seen

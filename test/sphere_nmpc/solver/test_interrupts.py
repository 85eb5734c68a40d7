# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C interrupts the solver on NumPy."""

import os
import signal
import subprocess
import sys
import time

import pytest
from patience import PATIENCE

from sphere_nmpc.cache import CACHE_VARIABLE
from sphere_sim.ros.session.child_process import verb_command

SOLVES = """
import os, random, signal, sys, threading, time
import numpy as np
from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.numpy_backend.horizon import roll_out
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
drift = Drift(np.array([30.0, -20.0, 15.0]) * float(sys.argv[1]))
problem = HoldProblem(
    np.array([1.0, 0.5, 1.0, 0, 0, 0]), np.array([0, 0, 0, 1.0, 0, 0]), np.zeros(2),
    np.full(n, 0.5), RobotParameters().lumped.as_array(), np.full((n, 2), -100.0),
    np.full((n, 2), 100.0), 100.0, input_weight=1e-12, slew_weight=10.0, max_acceleration=400.0,
    drift=drift.as_array(),
)
solver = HoldSolver(SolverSettings(max_iterations=5), "numpy")
rng = np.random.default_rng(0)
solver.solve(problem, np.zeros((n, 2)))

def work():
    solver.solve(problem, rng.uniform(-100.0, 100.0, (n, 2)))
    inputs = rng.uniform(-100.0, 100.0, (n + 1, 2))
    roll_out(problem.state, drift, inputs, problem.durations, problem.constants, 0.1)

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
            work()
        print("lost")
        break
    except KeyboardInterrupt:
        seen += 1
signal.signal(signal.SIGINT, signal.SIG_IGN)
print(handled, seen)
"""


@pytest.mark.parametrize("momentum", ("0", "1"))
def test_every_interrupt_of_a_solve_is_raised(momentum):
    done = subprocess.run(
        [sys.executable, "-c", SOLVES, momentum], capture_output=True, text=True, timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    handled, seen = done.stdout.split()
    assert int(handled) >= 50 and handled == seen


@pytest.mark.slow
@pytest.mark.parametrize("jobs", (1, 2))
def test_study_without_compiler_ends_at_ctrl_c(tmp_path, jobs):
    command = verb_command(
        "study", "--draw", str(jobs), "--seed", "1", "--jobs", str(jobs), "--duration", "600",
        "--no-bound", "--out", str(tmp_path / "out"),
    )
    environment = {
        **os.environ, "CC": "nonesuch", CACHE_VARIABLE: str(tmp_path / "cache"),
        "TMPDIR": str(tmp_path),
    }
    study = subprocess.Popen(
        command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    )
    try:
        assert study.stderr is not None
        assert "no C compiler found" in study.stderr.readline()
        time.sleep(3.0)  # the first plan of `time_optimal` is a search of tens of seconds
        study.send_signal(signal.SIGINT)
        _, errors = study.communicate(timeout=PATIENCE)
        assert study.returncode == 130 and "Traceback" not in errors
    finally:
        study.kill()

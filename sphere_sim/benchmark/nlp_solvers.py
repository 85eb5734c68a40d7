# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Solvers of general nonlinear programs on the same scaled problem."""

import contextlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import scipy.optimize

from sphere_nmpc.model.state import INPUT_SIZE, POSE_SIZE, Vector
from sphere_sim.benchmark.problem import (
    HORIZON,
    INPUT_WEIGHT,
    LIMIT,
    TERMINAL_WEIGHT,
    Answer,
    predicted,
)

SIZE = HORIZON * INPUT_SIZE
_QUIET: dict[str, Any] = {"print_time": False}
_IPOPT: dict[str, Any] = {"ipopt.print_level": 0, "ipopt.sb": "yes"}
_SQP: dict[str, Any] = {
    "qpsol": "qrqp",
    "qpsol_options": {"print_iter": False, "print_header": False, "error_on_fail": False},
    "hessian_approximation": "limited-memory", "max_iter": 100,
    "print_header": False, "print_iteration": False, "print_status": False,
}


@cache
def nonlinear_program() -> dict[str, Any]:
    """Return the problem in CasADi's form: x = scaled knots, p = [state, goal, input in force]."""
    v, p = ca.MX.sym("v", SIZE), ca.MX.sym("p", 2 * POSE_SIZE + INPUT_SIZE)
    x, goal, u = p[0:6], p[6:12], p[12:14]
    cost = INPUT_WEIGHT * LIMIT**2 / TERMINAL_WEIGHT * ca.sumsqr(v)
    for m in range(HORIZON):
        there = LIMIT * v[2 * m : 2 * m + 2]
        x, u = predicted(x, u, there), there
        cost += (1.0 if m == HORIZON - 1 else 1.0 / TERMINAL_WEIGHT) * ca.sumsqr(x - goal)
    return {"x": v, "p": p, "f": cost}


class WarmStarted:
    """Receding horizon around a solver: parameters, warm start, scaling."""

    def start(self, goal: Vector) -> None:
        """Start a run without a warm start; see `BenchmarkedSolver`."""
        self._goal = goal
        self._warm: Vector = np.zeros(SIZE)

    def solve(self, state: Vector, input_in_force: Vector) -> Answer:
        """Return the next rotor speeds; see `BenchmarkedSolver`."""
        p = np.concatenate((state, self._goal, input_in_force))
        v, solved = self.minimise(self._warm, p)
        finite = bool(np.all(np.isfinite(v)))
        v = np.clip(v, -1.0, 1.0) if finite else np.zeros(SIZE)
        self._warm = np.concatenate((v[INPUT_SIZE:], np.zeros(INPUT_SIZE)))
        return Answer(LIMIT * v[:INPUT_SIZE], solved and finite)

    def minimise(self, start: Vector, p: Vector) -> tuple[Vector, bool]:
        """Minimise from `start`, (SIZE,), with parameters `p`; return the point and success."""
        raise NotImplementedError


class Slsqp(WarmStarted):
    """SLSQP of SciPy; its gradient by finite differences or, exact, by CasADi."""

    def __init__(self, exact_gradient: bool) -> None:
        program = nonlinear_program()
        v, p, f = program["x"], program["p"], program["f"]
        outputs = [f, ca.gradient(f, v)] if exact_gradient else [f]
        self._cost = ca.Function("cost", [v, p], outputs)
        self._exact = exact_gradient

    def minimise(self, start: Vector, p: Vector) -> tuple[Vector, bool]:
        """Minimise from `start`; see `WarmStarted`."""

        def evaluate(v: Vector) -> Any:
            if self._exact:
                value, gradient = self._cost(v, p)
                return float(value), np.array(gradient).ravel()
            return float(self._cost(v, p))

        found = scipy.optimize.minimize(
            evaluate, start, jac=self._exact or None, method="SLSQP",
            bounds=[(-1.0, 1.0)] * SIZE, options={"ftol": 1e-10, "maxiter": 100},
        )
        return np.asarray(found.x), bool(found.success)


class CasadiSolver(WarmStarted):
    """Solver called through CasADi's `nlpsol`."""

    def __init__(self, plugin: str, options: dict[str, Any]) -> None:
        with _temporary_folder():
            self._solver = ca.nlpsol("solver", plugin, nonlinear_program(), {**_QUIET, **options})

    def minimise(self, start: Vector, p: Vector) -> tuple[Vector, bool]:
        """Minimise from `start`, (SIZE,), with parameters `p`; return the point and success."""
        found = self._solver(x0=start, p=p, lbx=-1.0, ubx=1.0)
        return np.array(found["x"]).ravel(), bool(self._solver.stats()["success"])


class GeneratedSqp(WarmStarted):
    """CasADi's sqpmethod with qrqp and BFGS, generated as C code and compiled."""

    def __init__(self) -> None:
        solver = ca.nlpsol("solver", "sqpmethod", nonlinear_program(), {**_QUIET, **_SQP})
        with _temporary_folder() as folder:
            solver.generate("solver.c")
            library = folder / "solver.so"
            command = [c_compiler(), "-O2", "-march=native", "-shared", "-fPIC", "solver.c"]
            subprocess.run([*command, "-o", str(library), "-lm"], check=True, capture_output=True)
            self._solver = ca.external("solver", str(library))

    def minimise(self, start: Vector, p: Vector) -> tuple[Vector, bool]:
        """Minimise from `start`, (SIZE,), with parameters `p`; return the point and success."""
        found = self._solver(x0=start, p=p, lbx=-1.0, ubx=1.0)
        # Generated code reports no status: a finite cost counts as success.
        return np.array(found["x"]).ravel(), bool(np.isfinite(float(found["f"])))


def ipopt() -> CasadiSolver:
    """Return IPOPT on CasADi's virtual machine."""
    return CasadiSolver("ipopt", _IPOPT)


def ipopt_compiled() -> CasadiSolver:
    """Return IPOPT with its functions compiled."""
    # CasADi would remove the files too late, when the temporary folder is gone.
    options = {"flags": ["-O2"], "verbose": False, "compiler": c_compiler(), "cleanup": False}
    jit = {"jit": True, "compiler": "shell", "jit_options": options, "jit_cleanup": False}
    return CasadiSolver("ipopt", {**_IPOPT, **jit})


def c_compiler() -> str:
    """Return the C compiler's path."""
    found = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if found is None:
        raise ModuleNotFoundError("needs a C compiler")
    return found


@contextlib.contextmanager
def _temporary_folder() -> Iterator[Path]:
    """Change to a temporary folder: CasADi writes what it compiles into the current one."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        try:
            yield Path(name)
        finally:
            os.chdir(before)

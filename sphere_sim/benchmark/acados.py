# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""acados as a benchmarked solver, in a process of another Python.

Its wheels contain a `casadi` that the other solvers cannot use. A request is state, goal, both of
shape (6,), input in force, (2,) [rad/s], and whether a run starts; an answer is acados' status,
wall and processor time [s], and the next inputs, (2,) [LIMIT]. Arrays are sent as lists, as the
other Python may have another version of NumPy. The first answer is text: empty, or the reason why
acados cannot be set up.
"""

import contextlib
import ctypes
import gc
import importlib
import os
import subprocess
import sys
import tempfile
import time
import weakref
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

import sphere_sim
from sphere_nmpc.model.state import INPUT_SIZE, POSE_SIZE, Vector
from sphere_nmpc.process.channel import Channel, ChannelEndError, encoded
from sphere_nmpc.process.child import Child, python_command
from sphere_sim.benchmark.problem import (
    HORIZON,
    INPUT_WEIGHT,
    LIMIT,
    TERMINAL_WEIGHT,
    Answer,
    Maker,
    predicted,
)

SQP, RTI = "sqp", "rti"
_OPTIONS: dict[str, dict[str, Any]] = {
    SQP: {"nlp_solver_type": "SQP", "qp_solver": "FULL_CONDENSING_QPOASES",
          "globalization": "MERIT_BACKTRACKING", "levenberg_marquardt": 0.3},
    RTI: {"nlp_solver_type": "SQP_RTI", "qp_solver": "PARTIAL_CONDENSING_HPIPM",
          "levenberg_marquardt": 0.1},
}
HOW_TO_GET_IT = (
    "--acados-python takes the Python of an environment of its own with "
    "`pip install comma-deps-acados`"
)
# Last on the path: other packages in this folder must not hide those of that Python.
_CHILD = (
    "sys.path.append(sys.argv[1]); "
    "from sphere_sim.benchmark.acados import serve; serve(sys.argv[2], int(sys.argv[3]))"
)
_PACKAGES = str(Path(sphere_sim.__file__).parents[1])
_HARMFUL = ("LD_LIBRARY_PATH", "PYTHONPATH", "PYTHONHOME", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
"""Variables by which another Python loads wrong libraries."""
_SILENT: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}


class Acados:
    """acados with the settings `SQP` or `RTI`; times are measured in its process, see `serve`.

    `python` is the path of a Python that has acados. ModuleNotFoundError is raised if it is None,
    RuntimeError if it cannot be started or acados cannot be set up in it.
    """

    def __init__(self, kind: str, python: str | None) -> None:
        if python is None:
            raise ModuleNotFoundError(HOW_TO_GET_IT)
        command = python_command(_CHILD, _PACKAGES, kind, python=python)
        environment = {name: text for name, text in os.environ.items() if name not in _HARMFUL}
        child = Child(command, with_channel=True, env=environment, **_SILENT)
        try:
            self._channel = child.start().channel
        except OSError as error:
            raise RuntimeError(f"{python} does not start: {error.strerror}") from error
        self.close = weakref.finalize(self, child.stop)
        try:
            message = self._channel.receive()
        except ChannelEndError:
            message = "ended without an answer"
        if message:
            raise RuntimeError(f"{python}: {message}")

    def start(self, goal: Vector) -> None:
        """Start a run without a warm start; see `BenchmarkedSolver`."""
        self._goal, self._starts = goal, True

    def solve(self, state: Vector, input_in_force: Vector) -> Answer:
        """Return the next rotor speeds; see `BenchmarkedSolver`."""
        request = state.tolist(), self._goal.tolist(), input_in_force.tolist(), self._starts
        self._starts = False
        try:
            self._channel.send(encoded(request))
            status, wall, cpu, v = self._channel.receive()
        except ChannelEndError as error:
            raise RuntimeError("acados' process has ended") from error
        return Answer(LIMIT * np.clip(v, -1.0, 1.0), status == 0, (wall, cpu))


def acados_makers(python: str | None) -> dict[str, Maker]:
    """Return both settings by the names under which they are reported; see `Acados`."""
    return {f"acados {kind}": partial(Acados, kind, python) for kind in (SQP, RTI)}


def build(kind: str, folder: Path) -> Any:
    """Return acados' solver of the paper's problem, generated and compiled in `folder`.

    The first-order hold makes the last input a part of the state; both are scaled by `LIMIT`.
    """
    template = _template(folder)
    ocp = template.AcadosOcp()
    x, v = ca.SX.sym("x", POSE_SIZE + INPUT_SIZE), ca.SX.sym("v", INPUT_SIZE)
    ocp.model.name = f"sphere_{kind}"
    ocp.model.x, ocp.model.u = x, v
    state = predicted(x[:POSE_SIZE], LIMIT * x[POSE_SIZE:], LIMIT * v)
    ocp.model.disc_dyn_expr = ca.vertcat(state, v)
    ocp.dims.N = HORIZON
    cost, size = ocp.cost, POSE_SIZE + INPUT_SIZE
    cost.cost_type = cost.cost_type_e = "LINEAR_LS"
    cost.Vx = np.diag([1.0] * POSE_SIZE + [0.0] * INPUT_SIZE)
    cost.Vu = np.eye(size)[:, POSE_SIZE:]
    cost.Vx_e = np.eye(size)[:POSE_SIZE]
    # acados halves its squares.
    effort = [2.0 * INPUT_WEIGHT * LIMIT**2 / TERMINAL_WEIGHT] * INPUT_SIZE
    cost.W = np.diag([2.0 / TERMINAL_WEIGHT] * POSE_SIZE + effort)
    cost.W_e = 2.0 * np.eye(POSE_SIZE)
    cost.yref, cost.yref_e = np.zeros(size), np.zeros(POSE_SIZE)
    ocp.constraints.lbu, ocp.constraints.ubu = -np.ones(INPUT_SIZE), np.ones(INPUT_SIZE)
    ocp.constraints.idxbu = np.arange(INPUT_SIZE)
    ocp.constraints.x0 = np.zeros(size)
    # Intervals of length one, as acados multiplies the stages' costs by it.
    options = {"tf": float(HORIZON), "integrator_type": "DISCRETE", **_OPTIONS[kind]}
    for name, value in {**options, "hessian_approx": "GAUSS_NEWTON"}.items():
        setattr(ocp.solver_options, name, value)
    ocp.code_export_directory = str(folder / "code")
    solver = template.AcadosOcpSolver(ocp, json_file=str(folder / "ocp.json"))
    # The first state of the horizon is given and, as in the other problems, has no cost.
    solver.cost_set(0, "W", np.diag([0.0] * POSE_SIZE + effort))
    return solver


def _template(folder: Path) -> Any:
    """Return acados' Python interface, from the wheel or from the user's own build."""
    tree = Path(os.environ.get("ACADOS_SOURCE_DIR", folder / "acados"))
    try:
        import acados
    except ModuleNotFoundError:
        template = importlib.import_module("acados_template")
    else:
        # The interface expects the layout of the source tree, which the wheel does not have.
        wheel, tree = Path(acados.__file__).parent, folder / "acados"
        interface = tree / "interfaces" / "acados_template"
        interface.mkdir(parents=True)
        (interface / "acados_template").symlink_to(wheel / "acados_template")
        for part in ("bin", "lib", "include"):
            (tree / part).symlink_to(wheel / "install" / part)
        os.environ["ACADOS_SOURCE_DIR"] = str(tree)
        template = importlib.import_module("acados.acados_template")
    # libacados finds its libraries only on the library path or if they are loaded already.
    libraries = set((tree / "lib").glob("lib*.so")) - {tree / "lib" / "libacados.so"}
    for library in sorted(libraries):  # libblasfeo, which others need, comes first
        ctypes.CDLL(str(library))
    return template


class Loop:
    """Receding horizon whose initial guess is the previous solution, shifted by one knot."""

    def __init__(self, solver: Any) -> None:
        self._solver = solver

    def start(self, state: Vector, goal: Vector) -> None:
        """Start a run towards `goal`, (6,), at `state`, (6,), without a warm start."""
        self._solver.reset()
        target, rest = np.concatenate((goal, np.zeros(INPUT_SIZE))), np.zeros(INPUT_SIZE)
        for k in range(HORIZON):
            self._solver.cost_set(k, "yref", target)
        self._solver.cost_set(HORIZON, "yref", goal)
        self._states = np.tile(np.concatenate((state, rest)), (HORIZON + 1, 1))
        self._inputs = np.zeros((HORIZON, INPUT_SIZE))

    def solve(self, state: Vector, input_in_force: Vector) -> tuple[int, Vector]:
        """Return acados' status and the next inputs, shape (2,) [LIMIT]."""
        solver, x0 = self._solver, np.concatenate((state, input_in_force / LIMIT))
        solver.set(0, "lbx", x0)
        solver.set(0, "ubx", x0)
        self._states[0] = x0
        for k in range(HORIZON):
            solver.set(k, "x", self._states[k])
            solver.set(k, "u", self._inputs[k])
        solver.set(HORIZON, "x", self._states[HORIZON])
        status = solver.solve()
        inputs = np.array([solver.get(k, "u") for k in range(HORIZON)])
        states = np.array([solver.get(k, "x") for k in range(HORIZON + 1)])
        if not (np.isfinite(inputs).all() and np.isfinite(states).all()):
            solver.reset()
            inputs, states = np.zeros_like(inputs), np.tile(x0, (HORIZON + 1, 1))
        self._inputs[:-1], self._inputs[-1] = inputs[1:], 0.0
        self._states[:-1], self._states[-1] = states[1:], states[-1]
        self._states[-1, POSE_SIZE:] = 0.0
        return status, inputs[0]


def serve(kind: str, descriptor: int) -> None:
    """Answer the requests of a channel until it is closed."""
    channel = Channel.inherited(descriptor)
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(ChannelEndError):
        os.chdir(folder)
        try:
            loop = Loop(build(kind, Path(folder)))
        except BaseException as error:
            # acados raises SystemExit where one of its programs is missing.
            channel.send(encoded(" ".join(f"{type(error).__name__}: {error}".split())))
            sys.exit(1)
        channel.send(encoded(""))
        gc.disable()  # as in `sphere_sim.benchmark.closed_loops`
        while True:
            state, goal, in_force, starts = channel.receive()
            if starts:
                loop.start(np.array(state), np.array(goal))
            wall, cpu = time.perf_counter(), time.thread_time()
            status, v = loop.solve(np.array(state), np.array(in_force))
            cpu, wall = time.thread_time() - cpu, time.perf_counter() - wall
            channel.send(encoded((int(status), wall, cpu, v.tolist())))

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""acados as a benchmarked solver; it runs in another Python, see `acados_process`."""

import os
import subprocess
import weakref
from functools import partial
from pathlib import Path

import numpy as np

import sphere_sim
from sphere_nmpc.child import python_command
from sphere_nmpc.model.state import Vector
from sphere_sim.benchmark.acados_process import ANSWER_SIZE, RTI, SQP
from sphere_sim.benchmark.problem import LIMIT, Answer, Maker

HOW_TO_GET_IT = (
    "--acados-python takes the Python of an environment of its own with "
    "`pip install comma-deps-acados`"
)
# Last on the path: other packages in this folder must not hide those of that Python.
_CHILD = (
    "sys.path.append(sys.argv[1]); "
    "from sphere_sim.benchmark.acados_process import main; main(sys.argv[2])"
)
_PACKAGES = str(Path(sphere_sim.__file__).parents[1])
_HARMFUL = ("LD_LIBRARY_PATH", "PYTHONPATH", "PYTHONHOME", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
"""Variables by which another Python loads wrong libraries."""


class Acados:
    """acados with the settings `SQP` or `RTI`; times are measured in its process.

    `python` is the path of a Python that has acados. ModuleNotFoundError is raised if it is None,
    RuntimeError if it cannot be started or acados cannot be set up in it.
    """

    def __init__(self, kind: str, python: str | None) -> None:
        if python is None:
            raise ModuleNotFoundError(HOW_TO_GET_IT)
        try:
            child = subprocess.Popen(
                python_command(_CHILD, _PACKAGES, kind, python=python),
                env={name: text for name, text in os.environ.items() if name not in _HARMFUL},
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            )
        except OSError as error:
            raise RuntimeError(f"{python} does not start: {error.strerror}") from error
        if child.stdin is None or child.stdout is None:
            raise RuntimeError(f"{python}: started without pipes")
        self._requests, self._answers = child.stdin, child.stdout
        # The process ends with its standard input, hence also when this process ends.
        self.close = weakref.finalize(self, child.communicate)
        message = self._answers.readline().decode(errors="replace")
        if message != "\n":
            raise RuntimeError(f"{python}: {message.strip() or 'ended without an answer'}")

    def start(self, goal: Vector) -> None:
        """Start a run without a warm start; see `BenchmarkedSolver`."""
        self._goal, self._start = goal, 1.0

    def solve(self, state: Vector, input_in_force: Vector) -> Answer:
        """Return the next rotor speeds; see `BenchmarkedSolver`."""
        request = np.concatenate(([self._start], state, self._goal, input_in_force))
        self._start = 0.0
        try:
            self._requests.write(request.tobytes())
            self._requests.flush()
            data = self._answers.read(8 * ANSWER_SIZE)
        except OSError:
            data = b""
        if len(data) != 8 * ANSWER_SIZE:
            raise RuntimeError("acados' process has ended")
        status, wall, cpu, *v = np.frombuffer(data)
        return Answer(LIMIT * np.clip(v, -1.0, 1.0), bool(status == 0), (float(wall), float(cpu)))


def acados_makers(python: str | None) -> dict[str, Maker]:
    """Return both settings by the names under which they are reported; see `Acados`."""
    return {f"acados {kind}": partial(Acados, kind, python) for kind in (SQP, RTI)}

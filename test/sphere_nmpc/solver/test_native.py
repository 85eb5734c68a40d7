# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import os
import subprocess
import sys
import time

import pytest

from sphere_nmpc.solver import native

SOLVE = """
import time
began = time.perf_counter()
import warnings
import numpy as np
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import HoldProblem
imported = time.perf_counter()
problem = HoldProblem(
    np.array([0.3, -0.2, 1.0, 0, 0, 0]), np.array([0, 0, 1.0, 0, 0, 0]), np.zeros(2),
    np.full(4, 0.5), RobotParameters().lumped.as_array(), np.full((4, 2), -100.0),
    np.full((4, 2), 100.0), 100.0, input_weight=5e-5,
)
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    solver = HoldSolver()
solution = solver.solve(problem, np.zeros((4, 2)))
print(solver.backend, f"{solution.cost:.12e}", len(caught), time.perf_counter() - imported)
for warning in caught:
    print(warning.message)
"""


def solve_elsewhere(cache, **environment):
    """Start the solver in a process of its own."""
    inherited = {k: v for k, v in os.environ.items() if k not in ("CC", "XDG_CACHE_HOME")}
    return subprocess.Popen(
        [sys.executable, "-c", SOLVE],
        env={**inherited, native.CACHE_VARIABLE: str(cache), **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def answer(process):
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return out.splitlines(), err


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """Return a cache folder that two processes filled at the same moment, and what they said."""
    cache = tmp_path_factory.mktemp("cache")
    processes = [solve_elsewhere(cache) for _ in range(2)]
    return cache, [answer(process) for process in processes]


def test_two_processes_at_once_build_once_and_agree(filled):
    cache, said = filled
    assert len(list(cache.glob("*.so"))) == 1
    assert not list(cache.glob("build-*"))
    first, second = (out[0].split()[:2] for out, _ in said)
    assert first[0] == "compiled" and first == second
    assert sum("compiling the solver" in err for _, err in said) == 1


def test_second_use_builds_nothing_and_starts_at_once(filled):
    out, err = answer(solve_elsewhere(filled[0]))
    assert "compiling" not in err
    assert float(out[0].split()[3]) < 0.5


@pytest.mark.parametrize("damage", ("cut", "changed", "empty"))
def test_damaged_binary_is_built_again(filled, damage):
    cache, said = filled
    (binary,) = cache.glob("*.so")
    content = binary.read_bytes()
    middle = len(content) // 2
    torn = {
        "cut": content[:middle],
        "changed": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
        "empty": b"",
    }[damage]
    replacement = binary.with_suffix(".torn")
    replacement.write_bytes(torn)
    replacement.replace(binary)
    out, err = answer(solve_elsewhere(cache))
    assert "compiling" in err
    assert out[0].split()[:2] == said[0][0][0].split()[:2]


def test_without_compiler_the_virtual_machine_takes_over(filled, tmp_path):
    began = time.perf_counter()
    out, _ = answer(solve_elsewhere(tmp_path, PATH=""))
    backend, cost, warnings, _ = out[0].split()
    assert time.perf_counter() - began < 30.0
    assert backend == "vm" and warnings == "1"
    assert "no C compiler found" in out[1] and "same results" in out[1]
    assert float(cost) == pytest.approx(float(filled[1][0][0][0].split()[1]), rel=1e-6)


def test_demanded_without_compiler_is_an_error(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(native.CompilerError, match="no C compiler found"):
        native.load_library()


def test_compiler_that_fails_is_told(monkeypatch, tmp_path):
    compiler = tmp_path / "broken"
    compiler.write_text('#!/bin/sh\n[ "$1" = --version ] && exit 0\necho no luck >&2\nexit 1\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    monkeypatch.setenv(native.CACHE_VARIABLE, str(tmp_path / "cache"))
    with pytest.raises(native.CompilerError, match="no luck"):
        native.load_library()
    assert not list((tmp_path / "cache").glob("*.so"))


def test_cache_folder_that_cannot_be_written_is_an_error(monkeypatch, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv(native.CACHE_VARIABLE, str(blocked / "cache"))
    with pytest.raises(native.CompilerError, match="cannot keep the compiled solver"):
        native.load_library()


def test_cache_folder_follows_the_environment(monkeypatch, tmp_path):
    monkeypatch.delenv(native.CACHE_VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert native.cache_folder() == tmp_path / "sphere_nmpc"
    monkeypatch.setenv(native.CACHE_VARIABLE, str(tmp_path / "mine"))
    assert native.cache_folder() == tmp_path / "mine"

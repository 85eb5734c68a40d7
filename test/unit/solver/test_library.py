# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled solver as it is loaded, the plain one in its place, and the sanitisers of C."""

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import sanitized_runs
from compiled_solver import compiled
from patience import PATIENCE

from sphere_nmpc.solver.native import layout, library
from sphere_nmpc.solver.native.layout import MEMBERS

SOLVE = """
import numpy as np
from solver_problems import make_problem
from sphere_nmpc.solver.problem import SolverSettings
from sphere_nmpc.solver.solve import solve
for _ in range(2):
    solution = solve(make_problem("terminal"), np.zeros((5, 2)), SolverSettings())
print(f"{solution.cost:.9e}")
"""


def solve(**environment):
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    done = subprocess.run(
        [sys.executable, "-c", SOLVE], env={**os.environ, **environment}, capture_output=True,
        text=True, check=True,
    )
    return float(done.stdout), done.stderr


def test_plain_solver_takes_the_place_of_the_compiled_one_with_one_warning():
    (cost, errors), (plain_cost, warning) = solve(), solve(**{library.VARIABLE: "plain"})
    assert errors == "" and plain_cost == pytest.approx(cost, rel=1e-6)
    assert len(warning.splitlines()) == 1 and "To cure this" in warning


def test_library_that_is_missing_or_of_another_layout_is_not_used(monkeypatch, tmp_path):
    assert compiled()
    with monkeypatch.context() as change, pytest.raises(OSError, match=f"{tmp_path}/solver.so"):
        change.setattr(library, "FOLDER", tmp_path)
        library._loaded()
    monkeypatch.setattr(layout, "MEMBERS", (MEMBERS[1], MEMBERS[0], *MEMBERS[2:]))
    with pytest.raises(OSError, match="another version"):
        library._loaded()


@pytest.mark.parametrize("share", [0.0, 0.5, 0.999999])
@pytest.mark.parametrize("name", ["solver.so", "fitting"])
def test_library_that_is_cut_off_is_named_before_it_is_used(monkeypatch, tmp_path, share, name):
    whole = sorted(library.FOLDER.glob("solver*.so"))
    assert compiled()
    cut = [one.name for one in whole if (one.name == "solver.so") == (name == "solver.so")]
    if not cut:
        pytest.skip("one instruction set")
    for one in whole:
        content = one.read_bytes()
        size = int(share * len(content)) if one.name in cut else len(content)
        (tmp_path / one.name).write_bytes(content[:size])
    monkeypatch.setattr(library, "FOLDER", tmp_path)
    with pytest.raises(OSError, match=f"{tmp_path}/solver.*(is cut off, given|too short)") as told:
        library._loaded()
    assert "\n" not in str(told.value)


@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
@pytest.mark.parametrize("exported", ["", "const long long hold_layout = 1;",
                                      'const char *hold_level(void) { return ""; }'])
def test_library_without_a_name_that_is_wanted_is_of_another_version(
    monkeypatch, tmp_path, exported
):
    (tmp_path / "old.c").write_text(exported)
    subprocess.run(
        ["cc", "-shared", "-fPIC", "old.c", "-o", "solver.so"], cwd=tmp_path, check=True
    )
    monkeypatch.setattr(library, "FOLDER", tmp_path)
    with pytest.raises(OSError, match=f"{tmp_path}/solver.so is of another version"):
        library._loaded()


def test_library_with_other_arguments_is_of_another_version(monkeypatch):
    assert compiled()
    result, *arguments = layout.FUNCTIONS["hold_clearance"]
    monkeypatch.setitem(layout.FUNCTIONS, "hold_clearance", (result, *arguments[:-1]))
    with pytest.raises(OSError, match="another version"):
        library._loaded()


def test_without_a_solver_and_casadi_a_controller_is_refused_with_the_cure():
    program = (
        "from sphere_nmpc.control.controller import Controller\n"
        "from sphere_nmpc.solver.native import library\n"
        "from sphere_nmpc.settings import ControllerSettings\n"
        "from sphere_nmpc.model.parameters import RobotParameters\n"
        "library.find_spec = lambda name: None\n"
        "try:\n    Controller(ControllerSettings(), RobotParameters())\n"
        "except library.MissingSolverError as error:\n    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], env={**os.environ, library.VARIABLE: "plain"},
        capture_output=True, text=True, check=False,
    )
    assert "needs CasADi: install" in done.stdout and not done.stderr, done.stderr


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
def test_every_processor_has_the_same_solutions(tmp_path):
    """Those of this processor's library are the ones of the library that needs no extensions.

    Some searches that end early amplify rounding; `replay.c` says how many may differ.
    """
    assert compiled()
    native = Path(__file__).parents[2] / "native"
    solves, replay = tmp_path / "solves", tmp_path / "replay"
    commands = (
        [sys.executable, native / "recorded_solves.py", solves],
        ["cc", "-O1", "-std=gnu11", "-I", sanitized_runs.SOURCES, native / "replay.c", "-o",
         replay, "-ldl", "-lm"],
        [replay, library.FOLDER / "solver.so", solves, "1e-9"],
    )
    for command in commands:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


RUNS = Path(sanitized_runs.__file__)
OPTIONS = (
    "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all -g -O0 -std=gnu11 "
    "-march=native -ffp-contract=fast -fno-math-errno -Wno-psabi -shared -fPIC"
)
RUNTIMES = {
    "libasan.so": OPTIONS,
    f"libclang_rt.asan-{platform.machine()}.so": f"{OPTIONS} -shared-libasan",
}
"""Runtime library of the address sanitiser of GCC and of Clang, and their options."""


@pytest.fixture(scope="module")
def sanitizers(tmp_path_factory):
    """Return a folder with the solver built with sanitisers, and the variables of a process."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler")
    folder = tmp_path_factory.mktemp("sanitizers")
    sanitized_runs.write_sources(folder)
    for name, options in RUNTIMES.items():
        printed = subprocess.run(
            [compiler, f"-print-file-name={name}"], capture_output=True, text=True, check=True
        )
        runtime = printed.stdout.strip()
        command = [compiler, *options.split(), "solver.c", "-o", "solver.so", "-lm"]
        if Path(runtime).is_absolute():
            subprocess.run(command, check=True, cwd=folder)
            # The interpreter frees little of its memory at its end.
            return folder, {"LD_PRELOAD": runtime, "ASAN_OPTIONS": "detect_leaks=0"}
    pytest.skip("the C compiler has no sanitisers")


@pytest.mark.slow
@pytest.mark.parametrize("is_faulty", [False, True], ids=["as it is", "with a fault put in"])
def test_solves_and_roll_outs_break_no_rule_of_the_language(sanitizers, is_faulty):
    folder, environment = sanitizers
    if is_faulty:
        environment = {**environment, "SOLVER_FAULT": "1"}
    done = subprocess.run(
        [sys.executable, str(RUNS), str(folder)], env={**os.environ, **environment},
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )
    is_told = "AddressSanitizer" in done.stderr or "runtime error" in done.stderr
    if is_faulty:
        assert done.returncode != 0 and is_told, done.stderr
    else:
        assert done.returncode == 0 and done.stdout.endswith("all done\n"), done.stderr

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import ctypes
import hashlib
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from other_user import as_user
from patience import PATIENCE

from sphere_nmpc import cache as places
from sphere_nmpc.control.goal_memory import GoalMemory
from sphere_nmpc.solver.native import compiler
from sphere_nmpc.solver.native import library as native
from sphere_nmpc.solver.native.codegen import kernel_source

SOLVE = """
import numpy as np
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import HoldProblem
problem = HoldProblem(
    np.array([0.3, -0.2, 1.0, 0, 0, 0]), np.array([0, 0, 1.0, 0, 0, 0]), np.zeros(2),
    np.full(4, 0.5), RobotParameters().lumped.as_array(), np.full((4, 2), -100.0),
    np.full((4, 2), 100.0), 100.0, input_weight=5e-5,
)
solver, another = HoldSolver(), HoldSolver()
solution = another.solve(problem, np.zeros((4, 2)))
print(solver.backend, f"{solution.cost:.12e}")
"""

WHERE_IT_IS_KEPT = """
import sphere_nmpc.solver.native.library as native
print(native.cache_folder())
print(native.load_library()._name)
"""
KEY_WITHOUT_PROC = """
from pathlib import Path
from sphere_nmpc.solver.native import compiler, library
compiler.PROCESSOR_FILE = Path("/nonexistent")
print(library._content_key(library.c_sources()))
"""
GOAL = np.array([1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
QUICK = Path(__file__).with_name("quick_cc.sh")
"""A compiler that does not optimise."""


def solve_elsewhere(cache, code=SOLVE, within=(), **environment):
    """Solve in a child process, whose solver is compiled without optimisation by default."""
    inherited = {k: v for k, v in os.environ.items() if k not in ("CC", "XDG_CACHE_HOME")}
    if "PATH" not in environment:
        inherited["CC"] = str(QUICK)
    return subprocess.Popen(
        [*within, sys.executable, "-c", code],
        env={
            **inherited, places.CACHE_VARIABLE: str(cache), "TMPDIR": str(cache.parent),
            **environment,
        },
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def answer(process):
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    return out.splitlines(), err


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """Return a cache folder that two processes filled at the same time, and their output."""
    cache = tmp_path_factory.mktemp("filled") / "cache"
    processes = [solve_elsewhere(cache) for _ in range(2)]
    return cache, [answer(process) for process in processes]


def test_two_processes_at_once_build_once_and_agree(filled):
    cache, outputs = filled
    assert len(list(cache.glob("*.so"))) == 1
    assert not list(cache.glob("build-*"))
    first, second = (out[0].split()[:2] for out, _ in outputs)
    assert first[0] == "compiled" and first == second
    assert sum("compiling the solver" in err for _, err in outputs) == 1


def test_second_use_neither_builds_nor_imports_the_code_generator(filled):
    generator = "import sys; print('sphere_nmpc.solver.native.codegen' in sys.modules)\n"
    out, err = answer(solve_elsewhere(filled[0], SOLVE + generator))
    assert "compiling" not in err and out[-1] == "False"


@pytest.mark.parametrize("damage", ("cut", "changed", "empty"))
def test_damaged_binary_is_built_again(filled, damage):
    cache, outputs = filled
    (binary,) = cache.glob("*.so")
    content = binary.read_bytes()
    middle = len(content) // 2
    contents = {
        "cut": content[:middle],
        "changed": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
        "empty": b"",
    }[damage]
    replacement = binary.with_suffix(".damaged")
    replacement.write_bytes(contents)
    replacement.replace(binary)
    out, err = answer(solve_elsewhere(cache))
    assert "compiling" in err
    assert out[0].split()[:2] == outputs[0][0][0].split()[:2]


@pytest.mark.parametrize("damage", ("a text", "of another machine"))
def test_sound_file_that_does_not_load_is_built_again(filled, damage, tmp_path):
    (good,) = filled[0].glob("*.so")
    body = b"not a library"
    if damage == "of another machine":
        # Byte 18 of an ELF file is the machine it is for.
        body = bytearray(good.read_bytes()[: -hashlib.sha256().digest_size])
        body[18:20] = b"\xff\xff"
    target = tmp_path / "cache" / good.name
    target.parent.mkdir(mode=0o700)
    target.write_bytes(bytes(body) + hashlib.sha256(body).digest())
    with pytest.raises(OSError):
        ctypes.CDLL(str(target))
    out, err = answer(solve_elsewhere(target.parent))
    assert out[0].startswith("compiled") and err.count("compiling the solver") == 1
    assert "compiling" not in answer(solve_elsewhere(target.parent))[1]


@pytest.mark.parametrize(
    "environment", [{"PATH": ""}, {"CC": "nonesuch"}, {"PATH": "/nonexistent", "CC": 'gcc "'}]
)
def test_kept_binary_needs_no_compiler(filled, environment):
    hide_ziglang = "import sys; sys.modules['ziglang'] = None\n"
    out, err = answer(solve_elsewhere(filled[0], hide_ziglang + SOLVE, **environment))
    assert out[0].split()[:2] == filled[1][0][0][0].split()[:2] and err == ""


def test_cache_folder_of_other_files_keeps_the_solver_whatever_the_umask(tmp_path):
    """Goals and best known times are written to the same folder, maybe before the solver."""
    cache = tmp_path / "cache"
    before = os.umask(0o002)
    try:
        GoalMemory(cache / "goals" / "0.controller.json", 60.0).save(GOAL, 1, False)
    finally:
        os.umask(before)
    assert "is kept in" not in answer(solve_elsewhere(cache))[1]
    out, err = answer(solve_elsewhere(cache, PATH=""))
    assert out[0].startswith("compiled") and err == ""


def test_without_compiler_the_reason_why_a_kept_binary_is_refused_is_reported(filled, tmp_path):
    cache = tmp_path / "cache"
    shutil.copytree(filled[0], cache)
    cache.chmod(0o775)
    out, err = answer(solve_elsewhere(cache, PATH=""))
    assert out[0].startswith("numpy") and len(err.splitlines()) == 1
    assert f"others can write to {cache} (chmod go-w {cache})" in err
    assert "no C compiler found" in err


def test_name_of_the_binary_does_not_depend_on_programs_in_path(tmp_path):
    """Where the processor's flags cannot be read, as in a sandbox without /proc."""
    program = tmp_path / "uname"
    program.write_text("#!/bin/sh\necho my_processor\n")
    program.chmod(0o755)
    keys = [
        answer(solve_elsewhere(tmp_path / "cache", KEY_WITHOUT_PROC, PATH=path))[0]
        for path in (str(tmp_path), "")
    ]
    assert keys[0] == keys[1]


@pytest.mark.parametrize(
    ("environment", "cause"),
    [
        ({"PATH": ""}, "no C compiler found (looked for cc, gcc, clang and the Python package"),
        ({"CC": "nonesuch -O2"}, "looked for nonesuch, which CC names"),
        ({"CC": 'gcc "'}, "CC: given 'gcc \"', expected a compiler and its options"),
    ],
)
def test_without_compiler_numpy_is_used_with_one_warning(filled, tmp_path, environment, cause):
    out, err = answer(solve_elsewhere(tmp_path / "cache", **environment))
    backend, cost = out[0].split()
    assert backend == "numpy"
    assert len(err.splitlines()) == 1, "one warning, of one line"
    assert cause in err and "same results" in err and "to cure this" in err
    assert float(cost) == pytest.approx(float(filled[1][0][0][0].split()[1]), rel=1e-6)


def test_compiled_solver_without_compiler_is_an_error(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv(places.CACHE_VARIABLE, str(tmp_path / "cache"))
    for name in ("temporary_folder", "temporary_path"):
        monkeypatch.setattr(native, name, lambda: tmp_path / "temporary")
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(native.CompilerError, match="no C compiler found"):
        native.load_library()


def test_warning_quotes_the_output_of_a_compiler_that_fails(tmp_path):
    compiler = tmp_path / "broken"
    compiler.write_text("#!/bin/sh\necho unknown option >&2\nexit 1\n")
    compiler.chmod(0o755)
    out, err = answer(solve_elsewhere(tmp_path / "cache", CC=str(compiler)))
    assert out[0].startswith("numpy")
    assert f"{compiler} fails: unknown option" in err and "another C compiler" in err
    assert not list((tmp_path / "cache").glob("*.so"))


def test_compiler_that_takes_too_long_is_ended(monkeypatch, tmp_path):
    slow = tmp_path / "slow"
    slow.write_text("#!/bin/sh\necho a note >&2\nexec sleep 3600\n")
    slow.chmod(0o755)
    monkeypatch.setattr(compiler, "_BUILD_SECONDS", 0.5)
    with pytest.raises(compiler.CompilerError, match=r"slow fails: it takes longer than 0.5 s;"):
        compiler.compile_library([[str(slow)]], {"solver.c": ""}, tmp_path)


def test_next_compiler_is_tried_where_the_first_fails(tmp_path):
    found = [name for name in ("gcc", "clang") if shutil.which(name)]
    if not found:
        pytest.skip("needs gcc or clang")
    broken = tmp_path / "cc"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    path = f"{tmp_path}:{os.environ['PATH']}"
    out, _ = answer(solve_elsewhere(tmp_path / "cache", PATH=path))
    assert out[0].startswith("compiled")


def blocked_folder(tmp_path):
    (tmp_path / "file").write_text("")
    return tmp_path / "file" / "cache", "Not a directory"


def full_disk(tmp_path):
    if os.geteuid() != 0:
        pytest.skip("only root can mount a small disk")
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("this machine does not allow to mount a small disk")
    return disk / "cache", "No space left on device"


@pytest.mark.parametrize("place", (blocked_folder, full_disk))
def test_where_the_cache_cannot_be_written_all_processes_share_one_build(place, tmp_path):
    cache, cause = place(tmp_path)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    try:
        out, err = answer(solve_elsewhere(cache, TMPDIR=str(temporary)))
        assert out[0].startswith("compiled")
        assert err.count("compiling the solver") == 1, "two solvers, one build"
        (folder,) = temporary.glob("sphere_nmpc-*")
        warning = err.splitlines()[-1]
        assert f"is kept in {folder}" in warning and f"{cache}: {cause}" in warning
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        out, err = answer(solve_elsewhere(cache, TMPDIR=str(temporary), PATH=""))
        assert out[0].startswith("compiled") and err == ""
    finally:
        if cache.parent.is_mount():
            subprocess.run(["umount", str(cache.parent)], check=True)


def test_where_files_may_not_be_large_the_warning_names_both_folders(tmp_path):
    code = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))\n" + SOLVE
    # Bytecode that the limit truncates would break each later import.
    environment = {"PYTHONDONTWRITEBYTECODE": "1"}
    out, err = answer(solve_elsewhere(tmp_path / "cache", code, **environment))
    assert out[0].startswith("numpy") and len(err.splitlines()) == 1
    assert err.count("File too large (errno 27)") == 2 and str(tmp_path / "cache") in err
    assert places.CACHE_VARIABLE in err and "compiler" not in err


@pytest.mark.parametrize("part", ("folder", "file"))
@pytest.mark.parametrize("fault", ("another user", "writable"))
def test_binary_that_other_users_could_have_written_is_not_loaded(filled, tmp_path, part, fault):
    cache = tmp_path / "cache"
    shutil.copytree(filled[0], cache)
    (binary,) = cache.glob("*.so")
    target = cache if part == "folder" else binary
    if fault == "writable":
        target.chmod(0o777)
    elif os.geteuid() == 0:
        os.chown(target, 54321, 54321)
    else:
        pytest.skip("only root can give a file away")
    before = binary.stat().st_ino
    out, err = answer(solve_elsewhere(cache))
    assert out[0].startswith("compiled") and err.count("compiling the solver") == 1
    if part == "folder":
        assert f"{cache} belongs to another user" in err or f"others can write to {cache}" in err
        assert binary.stat().st_ino == before
    else:
        assert binary.stat().st_ino != before, "built again in its place"


def test_temporary_folder_that_other_users_can_write_to_is_not_used(tmp_path):
    taken = tmp_path / f"sphere_nmpc-{os.geteuid()}"
    taken.mkdir()
    taken.chmod(0o777)
    (tmp_path / "file").write_text("")
    out, err = answer(solve_elsewhere(tmp_path / "file" / "cache", TMPDIR=str(tmp_path)))
    assert out[0].startswith("compiled") and not list(taken.iterdir())
    assert f"is kept in {tmp_path}/sphere_nmpc-" in err


def test_user_without_a_home_builds_in_the_temporary_folder(monkeypatch):
    user = as_user(54321)
    monkeypatch.delenv("HOME", raising=False)
    # Not in pytest's own folder, which only root may enter; the compiler too must be found here.
    with tempfile.TemporaryDirectory() as name:
        base = Path(name)
        base.chmod(0o1777)
        environment = {
            places.CACHE_VARIABLE: "", "XDG_CACHE_HOME": "", "TMPDIR": name,
            "CC": shutil.copy(QUICK, base),
        }
        out, err = answer(solve_elsewhere(base / "x", WHERE_IT_IS_KEPT, user, **environment))
        assert out[0] == str(base / "sphere_nmpc-54321")
        assert out[1].startswith(out[0]) and err.count("\n") == 1


def test_cache_folder_follows_the_environment(monkeypatch, tmp_path):
    monkeypatch.delenv(places.CACHE_VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert native.cache_folder() == tmp_path / "sphere_nmpc"
    monkeypatch.setenv(places.CACHE_VARIABLE, str(tmp_path / "mine"))
    assert native.cache_folder() == tmp_path / "mine"


def test_without_any_temporary_folder_every_use_of_the_path_is_an_error(monkeypatch):
    places.temporary_folder.cache_clear()
    monkeypatch.setattr(places.tempfile, "gettempdir", lambda: "/proc/self/nowhere")
    with pytest.raises(OSError):
        places.make_private(places.temporary_folder())
    places.temporary_folder.cache_clear()


def test_functions_without_drift_read_neither_momentum_nor_torques():
    without, _, with_drift = kernel_source().partition("static void nominal_step_with_drift")
    for name in ("torques[", "y[4]", "dy[4]", "wide_tangent"):
        assert name not in without and name in with_drift

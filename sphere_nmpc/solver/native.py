# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Builds the compiled solver at its first use and keeps it in the user's cache folder.

A binary is found again by a hash over everything it was made of: the sources, CasADi's version,
compiler, flags and processor. CasADi is asked for the kernels only when there is none.
"""

import contextlib
import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

import casadi as ca

from sphere_nmpc.errors import SphereNmpcError

CACHE_VARIABLE = "SPHERE_NMPC_CACHE"
"""Environment variable that names another cache folder than the user's."""

_C_SOURCES = ("driver.c", "vectors.h", "hold.h", "expansion.h", "step.h")
_GENERATORS = (
    ("sphere_nmpc.model", "dynamics.py"),
    ("sphere_nmpc.model", "integrator.py"),
    ("sphere_nmpc.solver", "shooting.py"),
    ("sphere_nmpc.solver", "kernels.py"),
)
"""What decides the text of ``kernels.h``."""

_FLAGS = ("-O3", "-std=gnu11", "-shared", "-fPIC", "-ffp-contract=fast", "-fno-math-errno")
_DIGEST_SIZE = hashlib.sha256().digest_size
_BUILD_SECONDS = 120.0


class CompilerError(SphereNmpcError):
    """There is no C compiler, or it cannot build the solver."""


def cache_folder() -> Path:
    """Return where binaries are kept; not created yet."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "sphere_nmpc"


def load_library() -> ctypes.CDLL:
    """Return the compiled solver, building it first if this machine has not done so yet.

    Raises
    ------
    CompilerError
        If it is not there and cannot be built.
    """
    command = _compiler()
    sources = {name: _text("sphere_nmpc.solver", name) for name in _C_SOURCES}
    key = _content_key(command, sources)
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        target = folder / f"hold_solver-{key}.so"
        if not _is_intact(target):
            with _locked(folder / f"hold_solver-{key}.lock"):
                # Another process may have built it while this one waited.
                if not _is_intact(target):
                    _build(command, sources, target)
        return ctypes.CDLL(str(target))
    except OSError as problem:
        raise CompilerError(f"cannot keep the compiled solver: {problem}") from problem


def _compiler() -> list[str]:
    named = shlex.split(os.environ.get("CC", ""))
    for candidate in [named] if named else [["cc"], ["gcc"], ["clang"]]:
        found = shutil.which(candidate[0])
        if found:
            return [found, *candidate[1:]]
    wanted = named[0] if named else "cc, gcc or clang"
    raise CompilerError(f"no C compiler found (looked for {wanted})")


def _processor() -> str:
    """Return what -march=native depends on."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith(("flags", "Features")):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor()


def _target_flags() -> list[str]:
    machine = platform.machine().lower()
    if machine not in ("x86_64", "amd64", "i686"):
        return ["-mcpu=native"] if machine in ("aarch64", "arm64") else []
    # Early scheduling overlaps the long chains of the step, a quarter faster, but it needs the 32
    # registers of AVX-512; with 16 it spills and gains nothing.
    early = ["-fschedule-insns", "-fsched-pressure"] if "avx512f" in _processor().split() else []
    return ["-march=native", *early]


def _content_key(command: list[str], sources: dict[str, str]) -> str:
    try:
        version = _run([*command, "--version"])
    except (OSError, subprocess.SubprocessError) as problem:
        raise CompilerError(f"{command[0]} does not run: {problem}") from problem
    parts = [ca.CasadiMeta.version(), platform.machine(), _processor(), version, *command]
    parts += [*_FLAGS, *_target_flags(), *sources.values()]
    parts += [_text(package, name) for package, name in _GENERATORS]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]


def _text(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")


def _run(command: list[str]) -> str:
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=_BUILD_SECONDS
    )
    return done.stdout


def _is_intact(binary: Path) -> bool:
    """Tell whether a binary ends with the digest of the rest: loading a torn one would crash."""
    try:
        content = binary.read_bytes()
    except OSError:
        return False
    body, digest = content[:-_DIGEST_SIZE], content[-_DIGEST_SIZE:]
    return bool(body) and hashlib.sha256(body).digest() == digest


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Let one process build at a time; the others find the result."""
    try:
        import fcntl
    except ImportError:
        # No such locks on this system: at worst the same file is built twice.
        yield
        return
    with open(path, "w", encoding="utf-8") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def _build(command: list[str], sources: dict[str, str], target: Path) -> None:
    # Here, not above: a process that finds its binary has no use for the code generator.
    from sphere_nmpc.solver.kernels import kernel_source

    print("sphere_nmpc: compiling the solver (once, about 3 s) ...", file=sys.stderr, flush=True)
    with tempfile.TemporaryDirectory(dir=target.parent, prefix="build-") as name:
        work = Path(name)
        for source, text in {**sources, "kernels.h": kernel_source()}.items():
            (work / source).write_text(text, encoding="utf-8")
        made = work / "solver.so"
        arguments = [str(work / "driver.c"), "-o", str(made), "-lm"]
        try:
            _run([*command, *_FLAGS, *_target_flags(), *arguments])
        except (OSError, subprocess.SubprocessError) as problem:
            told = (getattr(problem, "stderr", None) or str(problem)).strip()
            raise CompilerError(
                f"{command[0]} cannot build the solver: {told[-500:]}"
            ) from problem
        body = made.read_bytes()
        made.write_bytes(body + hashlib.sha256(body).digest())
        made.chmod(0o755)
        # In one go, so that nobody ever sees half a file.
        os.replace(made, target)

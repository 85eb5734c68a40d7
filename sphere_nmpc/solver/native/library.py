# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Compiled solver of this machine: loaded from the cache, built at its first use.

The name of a binary holds a hash over all that decides what it computes: the sources, CasADi's
version, flags and processor. The compiler is not part of it: a binary stays in use when the
compiler is removed or renewed. The code generator runs only where there is no binary.

The binary is kept in the user's cache folder or, where that is not possible, in a folder of the
user's own below the system's temporary one, which all processes of the user share.
"""

import contextlib
import ctypes
import hashlib
import logging
import os
import platform
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

import casadi as ca

from sphere_nmpc.cache import (
    CACHE_VARIABLE,
    cache_folder,
    distrust,
    make_private,
    temporary_folder,
    temporary_path,
)
from sphere_nmpc.solver.native.compiler import (
    FLAGS,
    CompilerError,
    compile_library,
    compilers,
    processor,
    target_flags,
)
from sphere_nmpc.solver.native.layout import problem_header

_C_SOURCES = (
    "solver.c", "vectors.h", "workspace.h", "steady.h", "models.h", "shooting.h", "objective.h",
    "bounded_step.h", "half_motions.h",
)
_GENERATORS = (
    ("sphere_nmpc.model", "symbolic_rotation.py"),
    ("sphere_nmpc.model", "drift.py"),
    ("sphere_nmpc.model", "dynamics.py"),
    ("sphere_nmpc.model", "integrator.py"),
    ("sphere_nmpc.solver.native", "codegen.py"),
)
"""Modules that decide the text of ``kernels.h``."""

_DIGEST_SIZE = hashlib.sha256().digest_size

_log = logging.getLogger("sphere_nmpc")


def load_library() -> ctypes.CDLL:
    """Return the compiled solver, building it first if this machine has not done so yet.

    Raises
    ------
    CompilerError
        If no binary can be loaded and none can be built or kept.
    """
    sources = c_sources()
    name = f"hold_solver-{_content_key(sources)}.so"
    refusals: list[str] = []
    # Absolute, as a name without a folder is looked for among the system's libraries.
    for folder in (cache_folder().absolute(), temporary_path().absolute()):
        try:
            return _loaded(folder / name)
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as problem:
            refusals.append(_cause(folder, problem))
    try:
        commands = compilers()
    except CompilerError as problem:
        if not refusals:
            raise
        kept = f"the compiled solver in the cache is not used: {', nor: '.join(refusals)}; "
        raise CompilerError(kept + problem.cause, f"mend that, or {problem.cure}") from None
    causes: list[str] = []
    # The second folder is not created unless the first one cannot be used.
    for find in (cache_folder, temporary_folder):
        folder = find().absolute()
        try:
            library = _built(folder / name, commands, sources)
        except OSError as problem:
            causes.append(_cause(folder, problem))
            continue
        if causes:
            _log.warning("sphere_nmpc: the compiled solver is kept in %s: %s", folder, causes[0])
        return library
    cause = "the compiled solver cannot be kept: " + ", nor: ".join(causes)
    cure = f"name a folder of your own with enough space in {CACHE_VARIABLE}"
    raise CompilerError(cause, cure)


def c_sources() -> dict[str, str]:
    """Return the C sources by file name, without the generated kernels, which take a while."""
    texts = {name: _text("sphere_nmpc.solver.native", name) for name in _C_SOURCES}
    return {**texts, "problem.h": problem_header()}


def _loaded(binary: Path) -> ctypes.CDLL:
    """Return a kept binary; OSError where it is missing, damaged or not to be trusted."""
    for place in (binary.parent, binary):
        reason = distrust(place)
        if reason is not None:
            raise PermissionError(reason)
    # Its end is the digest of the rest: loading an incomplete file would crash.
    content = binary.read_bytes()
    body, digest = content[:-_DIGEST_SIZE], content[-_DIGEST_SIZE:]
    if not body or hashlib.sha256(body).digest() != digest:
        raise OSError(f"{binary} is damaged")
    return ctypes.CDLL(str(binary))


def _built(binary: Path, commands: list[list[str]], sources: dict[str, str]) -> ctypes.CDLL:
    """Build a binary, keep it and return it; OSError where the folder does not allow it."""
    folder = binary.parent
    make_private(folder)
    reason = distrust(folder)
    if reason is not None:
        raise PermissionError(reason)
    with _locked(binary.with_suffix(".lock")):
        # Another process may have built it while this one waited.
        with contextlib.suppress(OSError):
            return _loaded(binary)
        # Imported here, as a process that finds its binary does not need the code generator.
        from sphere_nmpc.solver.native.codegen import kernel_source

        body = compile_library(commands, {**sources, "kernels.h": kernel_source()}, folder)
        made = binary.with_suffix(".new")
        try:
            made.write_bytes(body + hashlib.sha256(body).digest())
            made.chmod(0o755)
            # Atomic: no other process ever reads half a file.
            os.replace(made, binary)
        except OSError:
            made.unlink(missing_ok=True)
            raise
        return _loaded(binary)


def _cause(folder: Path, problem: OSError) -> str:
    """Return why a folder cannot keep the solver, with the folder's name."""
    if problem.strerror is None:
        return str(problem)
    return f"{folder}: {problem.strerror} (errno {problem.errno})"


def _content_key(sources: dict[str, str]) -> str:
    parts = [ca.CasadiMeta.version(), platform.machine(), processor(), *FLAGS, *target_flags()]
    parts += [*sources.values(), *(_text(package, name) for package, name in _GENERATORS)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]


def _text(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")


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

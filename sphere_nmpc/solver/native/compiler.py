# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""C compilers of this machine, and the build of the solver."""

import logging
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError

FLAGS = ("-O3", "-std=gnu11", "-shared", "-fPIC", "-ffp-contract=fast", "-fno-math-errno")
PROCESSOR_FILE = Path("/proc/cpuinfo")
_BUILD_SECONDS = 1200.0
"""Time after which a compiler is ended [s]: a small and busy computer takes minutes."""
_DISK_SPACE = 1 << 20
"""Space that a build takes on the disk [bytes], with its intermediate files."""
_MESSAGE_LENGTH = 300
"""Characters of a compiler's output that are quoted."""

_log = logging.getLogger("sphere_nmpc")


class CompilerError(SphereNmpcError):
    """The solver cannot be compiled or kept on this machine.

    Parameters
    ----------
    cause : str
        Why not.
    cure : str
        Remedy.
    """

    def __init__(self, cause: str, cure: str) -> None:
        super().__init__(f"{cause}; {cure}")
        self.cause = cause
        self.cure = cure


def compilers() -> list[list[str]]:
    """Return the commands of the C compilers on this machine, in the order to try them.

    CC if it is set, otherwise cc, gcc, clang and the one in the Python package ziglang.

    Raises
    ------
    CompilerError
        If there is none, or CC cannot be read as a command.
    """
    text = os.environ.get("CC", "")
    try:
        named = shlex.split(text)
    except ValueError as problem:
        cause = f"CC: given {text!r}, expected a compiler and its options ({problem})"
        raise CompilerError(cause, "name a C compiler in CC, or unset it") from None
    found: dict[str, list[str]] = {}
    for candidate in [named] if named else [["cc"], ["gcc"], ["clang"]]:
        path = shutil.which(candidate[0])
        if path:
            # cc is most often a second name of one of the others.
            found.setdefault(os.path.realpath(path), [path, *candidate[1:]])
    package = None if named else find_spec("ziglang")
    for folder in (package and package.submodule_search_locations) or ():
        if path := shutil.which("zig", path=folder):
            found["ziglang"] = [path, "cc"]
    if found:
        return list(found.values())
    if named:
        cause = f"no C compiler found (looked for {named[0]}, which CC names)"
        raise CompilerError(cause, "name one that is there, or unset CC")
    cause = "no C compiler found (looked for cc, gcc, clang and the Python package ziglang)"
    raise CompilerError(cause, "install one of them, for instance with 'pip install ziglang'")


def processor() -> str:
    """Return the instruction sets of the processor, on which ``-march=native`` depends."""
    try:
        for line in PROCESSOR_FILE.read_text(encoding="utf-8").splitlines():
            if line.startswith(("flags", "Features")):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    # Not `platform.processor`, which runs a program: its result would depend on PATH, and with it
    # the name under which a binary is kept.
    return ""


def target_flags() -> list[str]:
    """Return the flags that fit the processor."""
    machine = platform.machine().lower()
    if machine not in ("x86_64", "amd64", "i686"):
        return ["-mcpu=native"] if machine in ("aarch64", "arm64") else []
    # Scheduling before register allocation overlaps the long dependency chains of the step, which
    # is a quarter faster with the 32 registers of AVX-512; with 16 it spills and gains nothing.
    early = ["-fschedule-insns", "-fsched-pressure"] if "avx512f" in processor().split() else []
    return ["-march=native", *early]


def compile_library(commands: list[list[str]], sources: dict[str, str], folder: Path) -> bytes:
    """Return a shared library built from C sources by the first compiler that succeeds.

    Parameters
    ----------
    commands : list of list of str
        Compilers, see `compilers`.
    sources : dict
        Texts by file name; ``solver.c`` is compiled and includes the others.
    folder : Path
        Folder for intermediate files, which are removed again.

    Raises
    ------
    CompilerError
        If none does; with the end of the first one's output.
    OSError
        If the folder cannot be written or its disk is full.
    """
    failures: list[str] = []
    with tempfile.TemporaryDirectory(dir=folder, prefix="build-") as name:
        work = Path(name)
        # A full disk is detected here, as compilers report it in different ways.
        trial = work / "space"
        trial.write_bytes(bytes(_DISK_SPACE))
        trial.unlink()
        _log.warning("sphere_nmpc: compiling the solver (once, some seconds) ...")
        for source, text in sources.items():
            (work / source).write_text(text, encoding="utf-8")
        made = work / "solver.so"
        arguments = [str(work / "solver.c"), "-o", str(made), "-lm"]
        for command in commands:
            try:
                _run([*command, *FLAGS, *target_flags(), *arguments], work)
                return made.read_bytes()
            except (OSError, subprocess.SubprocessError) as problem:
                failures.append(f"{shlex.join(command)} fails: {_message(problem)}")
    raise CompilerError(failures[0], "name another C compiler in CC")


def _run(command: list[str], work: Path) -> None:
    variables = ("TMPDIR", "ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")
    subprocess.run(
        command, env={**os.environ, **dict.fromkeys(variables, str(work))}, check=True,
        capture_output=True, text=True, errors="replace", timeout=_BUILD_SECONDS,
    )


def _message(problem: Exception) -> str:
    """Return the end of a compiler's error output, or its exit status, in one line."""
    if isinstance(problem, subprocess.TimeoutExpired):
        # What it has printed by then are notes and warnings.
        return f"it takes longer than {problem.timeout:g} s"
    printed = " ".join((getattr(problem, "stderr", None) or "").split())
    if printed:
        return printed[-_MESSAGE_LENGTH:]
    status = getattr(problem, "returncode", None)
    return str(problem) if status is None else f"it ends with status {status}"

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""C compilers of this machine, and how they build the solver."""

import logging
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError

FLAGS = ("-O3", "-std=gnu11", "-shared", "-fPIC", "-ffp-contract=fast", "-fno-math-errno")
_BUILD_SECONDS = 120.0
_ROOM = 1 << 20
"""What a compiler needs on the disk [bytes], with its intermediate files."""
_LAST_WORDS = 300

_log = logging.getLogger("sphere_nmpc")


class CompilerError(SphereNmpcError):
    """The solver cannot be compiled or kept on this machine.

    Parameters
    ----------
    cause : str
        What is wrong.
    cure : str
        What helps.
    """

    def __init__(self, cause: str, cure: str) -> None:
        super().__init__(f"{cause}; {cure}")
        self.cause = cause
        self.cure = cure


def compilers() -> list[list[str]]:
    """Return the commands of the C compilers that are there, the first to try first.

    CC if it is set, otherwise cc, gcc, clang and the one in the Python package ziglang.

    Raises
    ------
    CompilerError
        If there is none, or CC is no command.
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
    if not named and find_spec("ziglang"):
        found["ziglang"] = [sys.executable, "-m", "ziglang", "cc"]
    if found:
        return list(found.values())
    if named:
        cause = f"no C compiler found (looked for {named[0]}, which CC names)"
        raise CompilerError(cause, "name one that is there, or unset CC")
    cause = "no C compiler found (looked for cc, gcc, clang and the Python package ziglang)"
    raise CompilerError(cause, "install one of them, for instance with 'pip install ziglang'")


def processor() -> str:
    """Return what -march=native depends on."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith(("flags", "Features")):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor()


def target_flags() -> list[str]:
    """Return the flags that fit the processor."""
    machine = platform.machine().lower()
    if machine not in ("x86_64", "amd64", "i686"):
        return ["-mcpu=native"] if machine in ("aarch64", "arm64") else []
    # Early scheduling overlaps the long chains of the step, a quarter faster, but it needs the 32
    # registers of AVX-512; with 16 it spills and gains nothing.
    early = ["-fschedule-insns", "-fsched-pressure"] if "avx512f" in processor().split() else []
    return ["-march=native", *early]


def compile_library(commands: list[list[str]], sources: dict[str, str], folder: Path) -> bytes:
    """Return a shared library built from C sources by the first compiler that can.

    Parameters
    ----------
    commands : list of list of str
        Compilers, see `compilers`.
    sources : dict
        Texts by file name; ``driver.c`` is compiled and includes the others.
    folder : Path
        Where the intermediate files are made and removed again.

    Raises
    ------
    CompilerError
        If none can; with the last words of the first.
    OSError
        If there is no room in the folder or it cannot be written.
    """
    told: list[str] = []
    with tempfile.TemporaryDirectory(dir=folder, prefix="build-") as name:
        work = Path(name)
        # Before the work, and not from what a compiler says in its own words and language.
        room = work / "room"
        room.write_bytes(bytes(_ROOM))
        room.unlink()
        _log.warning("sphere_nmpc: compiling the solver (once, some seconds) ...")
        for source, text in sources.items():
            (work / source).write_text(text, encoding="utf-8")
        made = work / "solver.so"
        arguments = [str(work / "driver.c"), "-o", str(made), "-lm"]
        for command in commands:
            try:
                _run([*command, *FLAGS, *target_flags(), *arguments], work)
                return made.read_bytes()
            except (OSError, subprocess.SubprocessError) as problem:
                told.append(f"{shlex.join(command)} fails: {_last_words(problem)}")
    raise CompilerError(told[0], "name another C compiler in CC")


def _run(command: list[str], work: Path) -> None:
    variables = ("TMPDIR", "ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")
    subprocess.run(
        command, env={**os.environ, **dict.fromkeys(variables, str(work))}, check=True,
        capture_output=True, text=True, errors="replace", timeout=_BUILD_SECONDS,
    )


def _last_words(problem: Exception) -> str:
    """Return the end of what a compiler printed, or else how it ended, in one line."""
    printed = " ".join((getattr(problem, "stderr", None) or "").split())
    if printed:
        return printed[-_LAST_WORDS:]
    status = getattr(problem, "returncode", None)
    return str(problem) if status is None else f"it ends with status {status}"

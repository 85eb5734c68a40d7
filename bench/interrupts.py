# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C at random moments of the long commands: what they say, leave behind and keep.

    python bench/interrupts.py --each 10 --seed 1

Each command is first timed to its end, then interrupted at moments drawn from that time. The
signal goes to the whole process group, as from a terminal. The first moments, in which the
interpreter itself starts, are left out: there Python prints a traceback of its own.
"""

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from sphere_nmpc.errors import SphereNmpcError
from sphere_sim.recording.run_reader import read_run

STARTED = 0.3
"""Earliest moment of a signal [s]; on an idle machine the interpreter is up after 0.1 s."""
LONGEST = 20.0
"""Latest moment of a signal [s]."""
GONE = 5.0
"""How long processes may take to be gone after their parent [s]."""
COMMANDS = {
    "demo": ["demo", "--no-viewer", "--case", "3", "--rtf", "2"],
    "study": ["study", "--draw", "10", "--seed", "1", "--duration", "4", "--jobs", "2"],
    "benchmark": ["benchmark", "--quick", "--cases", "3", "--duration", "5"],
    "report": ["report", "--animation", "--csv"],
}


@dataclass(frozen=True)
class Interrupted:
    """A command that was interrupted, or ended before."""

    code: int
    told: str
    seconds: float
    left: list[str]


def main() -> int:
    """Interrupt each command; return 0 when nothing is to be complained about."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--each", type=int, default=10, help="signals a command (default: 10)")
    parser.add_argument("--seed", type=int, default=1, help="of the moments (default: 1)")
    parser.add_argument("--command", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    given = parser.parse_args()
    moments = random.Random(given.seed)
    faults = 0
    with tempfile.TemporaryDirectory(prefix="interrupts_") as name:
        folder = Path(name)
        bag = folder / "recorded"
        os.environ["SPHERE_NMPC_CACHE"] = str(folder / "cache")
        command("demo", bag, folder).wait()
        for verb in given.command:
            duration = timed(verb, folder, bag / "bag")
            waits = []
            for i in range(given.each):
                out = folder / f"{verb}_{i}"
                moment = moments.uniform(STARTED, min(duration, LONGEST))
                found = interrupted(verb, out, bag / "bag", moment)
                complaints = judged(verb, found, out)
                waits.append(found.seconds)
                faults += bool(complaints)
                print(f"{verb} at {moment:5.2f} s: code {found.code}, ended {found.seconds:.2f} s "
                      f"later: {'; '.join(complaints) or 'nothing to complain of'}", flush=True)
            waits.sort()
            print(f"{verb}: {given.each} signals within {duration:.1f} s, ended after "
                  f"{waits[len(waits) // 2]:.2f} s (median), {waits[-1]:.2f} s (longest)")
    print(f"{faults} of {given.each * len(given.command)} with something to complain of")
    return 1 if faults else 0


def command(verb: str, out: Path, bag: Path, **options: object) -> subprocess.Popen[str]:
    """Start a command in a process group of its own."""
    words = [sys.executable, "-m", "sphere_sim.cli.child", str(os.getpid()), *COMMANDS[verb]]
    words += [str(bag)] if verb == "report" else []
    words += ["--json", str(out / "times.json")] if verb == "benchmark" else ["--out", str(out)]
    quiet: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
    quiet |= options
    return subprocess.Popen(words, start_new_session=True, **quiet)


def timed(verb: str, folder: Path, bag: Path) -> float:
    """Return how long a command takes when nobody interrupts it [s]."""
    began = time.monotonic()
    process = command(verb, folder / f"{verb}_whole", bag, stderr=subprocess.DEVNULL)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(LONGEST + 5.0)
    duration = time.monotonic() - began
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)
    process.wait()
    return duration


def interrupted(verb: str, out: Path, bag: Path, moment: float) -> Interrupted:
    """Interrupt a command after `moment` [s] and wait for its end."""
    mark = uuid.uuid4().hex
    with tempfile.TemporaryDirectory() as scratch, tempfile.TemporaryFile("w+") as told:
        environment = {**os.environ, "INTERRUPTS_MARK": mark, "TMPDIR": scratch}
        environment["PYTHONFAULTHANDLER"] = "1"
        process = command(verb, out, bag, stderr=told, env=environment)
        time.sleep(moment)
        began = time.monotonic()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGINT)
        try:
            process.wait(60.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        seconds = time.monotonic() - began
        left = left_behind(mark)
        left += [p.name for p in Path(scratch).iterdir() if not p.name.endswith(".lock")]
        told.seek(0)
        return Interrupted(process.returncode, told.read(), seconds, left)


def left_behind(mark: str) -> list[str]:
    """Return the processes that are still there some time after the end of their command."""
    end = time.monotonic() + GONE
    while True:
        found = []
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error):
                if process.environ().get("INTERRUPTS_MARK") == mark:
                    found.append(" ".join(process.cmdline()))
        if not found or time.monotonic() > end:
            return found
        time.sleep(0.2)


def judged(verb: str, found: Interrupted, out: Path) -> list[str]:
    """Return what there is to complain about."""
    complaints = [f"left behind: {name}" for name in found.left]
    if found.code not in (0, 130):
        complaints.append(f"exit code {found.code}: {found.told[-2000:]}")
    words = [line for line in found.told.splitlines() if line.strip()]
    if "Traceback" in found.told or "Exception ignored" in found.told:
        complaints.append(f"a traceback: {words[-1]}")
    if any(path.suffix in (".tmp", ".part") for path in out.rglob("*")):
        complaints.append("half a file")
    if verb == "study" and (out / "journal.jsonl").exists():
        lines = (out / "journal.jsonl").read_bytes().splitlines()[1:]
        if not all(line.endswith(b"}") for line in lines):
            complaints.append("a torn journal")
    if verb == "demo" and any((out / "bag").glob("*.mcap")):
        try:
            read_run(out / "bag")
        except SphereNmpcError as error:
            # Interrupted before the first pose.
            if not any(why in str(error) for why in ("no message on", "is empty")):
                complaints.append(str(error))
    return complaints


if __name__ == "__main__":
    sys.exit(main())

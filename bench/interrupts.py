# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C at random times of the long commands: exit codes, messages and what remains.

    python bench/interrupts.py --each 10 --seed 1

Each command is first timed to its end, then interrupted at random times before that. The signal
goes to the whole process group, as from a terminal. The start of the interpreter itself is left
out: during it Python prints a traceback of its own.
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
from sphere_sim.ros.session.child_process import ChildProcess, verb_command

STARTED = 0.3
"""Earliest time of a signal [s]; on an idle machine the interpreter has started after 0.1 s."""
LONGEST = 20.0
"""Latest time of a signal [s]."""
GONE = 5.0
"""How long processes may take to end after their parent [s]."""
TIMEOUT = 300.0
"""Longest duration of the run that is recorded first [s]."""
COMMANDS = {
    "demo": ["demo", "--no-viewer", "--case", "3", "--rtf", "2"],
    "study": ["study", "--draw", "10", "--seed", "1", "--duration", "4", "--jobs", "2"],
    "benchmark": ["benchmark", "--quick", "--cases", "3", "--duration", "5"],
    "report": ["report", "--animation", "--csv"],
}


@dataclass(frozen=True)
class Interrupted:
    """A command that was interrupted, or had ended before."""

    code: int
    errors: str
    seconds: float
    left: list[str]


def main() -> int:
    """Interrupt each command; return 0 if there is no complaint."""
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
        demo = command("demo", bag, folder)
        demo.start()
        demo.wait(TIMEOUT)
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
                      f"later: {'; '.join(complaints) or 'no complaint'}", flush=True)
            waits.sort()
            print(f"{verb}: {given.each} signals within {duration:.1f} s, ended after "
                  f"{waits[len(waits) // 2]:.2f} s (median), {waits[-1]:.2f} s (longest)")
    print(f"{faults} of {given.each * len(given.command)} with complaints")
    return 1 if faults else 0


def command(
    verb: str, out: Path, bag: Path, log: Path = Path(os.devnull), **options: Any
) -> ChildProcess:
    """Return a command, which is not started yet, with standard error in a file."""
    words = [*COMMANDS[verb], *([str(bag)] if verb == "report" else [])]
    words += ["--json", str(out / "times.json")] if verb == "benchmark" else ["--out", str(out)]
    return ChildProcess(
        verb, verb_command(*words), log, stdout=subprocess.DEVNULL, **options
    )


def timed(verb: str, folder: Path, bag: Path) -> float:
    """Return the duration of a command that is not interrupted [s]."""
    began = time.monotonic()
    process = command(verb, folder / f"{verb}_whole", bag)
    process.start()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(LONGEST + 5.0)
    duration = time.monotonic() - began
    process.stop()
    return duration


def interrupted(verb: str, out: Path, bag: Path, moment: float) -> Interrupted:
    """Interrupt a command after `moment` [s] and wait for its end."""
    mark = uuid.uuid4().hex
    with tempfile.TemporaryDirectory() as scratch, tempfile.TemporaryDirectory() as logs:
        environment = {**os.environ, "INTERRUPTS_MARK": mark, "TMPDIR": scratch}
        environment["PYTHONFAULTHANDLER"] = "1"
        process = command(verb, out, bag, Path(logs, "stderr"), env=environment)
        process.start()
        time.sleep(moment)
        began = time.monotonic()
        process.send(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(60.0)
        if process.running:
            process.kill()
        code = process.wait(0.0)
        seconds = time.monotonic() - began
        left = left_behind(mark)
        left += [p.name for p in Path(scratch).iterdir() if not p.name.endswith(".lock")]
        return Interrupted(code, process.output, seconds, left)


def left_behind(mark: str) -> list[str]:
    """Return the processes that still run some time after the end of their command."""
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
    """Return the complaints."""
    complaints = [f"left behind: {name}" for name in found.left]
    if found.code not in (0, 130):
        complaints.append(f"exit code {found.code}: {found.errors[-2000:]}")
    words = [line for line in found.errors.splitlines() if line.strip()]
    if "Traceback" in found.errors or "Exception ignored" in found.errors:
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

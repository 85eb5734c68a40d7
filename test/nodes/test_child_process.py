# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Child processes are killed, stopped, started again and ended together, or with their parent."""

import os
import re
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator

import psutil
import pytest
from children import wait_for_end
from patience import PATIENCE, until

from sphere_nmpc.process.child import END_SIGNALS, Child, ChildEndedError, python_command
from sphere_sim.ros.session.process_set import ProcessSet

pytestmark = pytest.mark.slow

WAITING = """
import signal, subprocess, sys, time
words = sys.argv[1:]
signal.signal(signal.SIGINT, lambda *_: sys.exit(7))
if "ignoring" in words:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
line = ["up", *words]
if "spawning" in words:
    line += ["child", str(subprocess.Popen(["sleep", "60"]).pid)]
sys.stdout.write(" ".join(line) + "\\n")  # in one piece, also where unbuffered
sys.stdout.flush()
time.sleep(60)
"""


@pytest.fixture
def process(tmp_path) -> Iterator[Child]:
    """Return a process that prints that it is up, and then waits."""
    process = Child([sys.executable, "-c", WAITING], "waiting", tmp_path / "waiting.log")
    yield process
    process.kill()


def start(process: Child, *extra: str) -> None:
    def lines() -> int:
        return len(re.findall(r"^up.*\n", process.output, re.MULTILINE))

    before = lines()
    process.start(*extra)
    until(lambda: lines() > before)


def test_killed_process_names_the_signal_and_can_be_started_again(process) -> None:
    start(process)
    assert process.running and process.code is None
    process.kill()
    assert process.ending == "waiting ended, SIGKILL"
    start(process, "again")
    assert process.running
    assert process.output.split() == ["up", "up", "again"]


def test_process_that_ignores_sigint_and_sigterm_is_killed(process) -> None:
    start(process, "ignoring")
    process.stop(0.2)
    assert process.code == -signal.SIGKILL


def test_kill_ends_what_the_process_has_started(process) -> None:
    start(process, "spawning")
    process.kill()
    wait_for_end([int(process.output.split()[-1])])


def test_unexpected_end_of_a_verb_quotes_its_output(tmp_path) -> None:
    with ProcessSet(tmp_path) as processes:
        node = processes.start("simulator", ["--nonsense"])
        processes.start("simulator", ["--help"], within=["nice"], name="helper")
        node.wait(PATIENCE)
        assert processes["helper"].wait(PATIENCE) == 0
        with pytest.raises(ChildEndedError, match=r"simulator ended, exit code 2.*\n.*--nonsense"):
            processes.check()


INTERRUPTED = """
import os, signal, sys
from pathlib import Path
from sphere_sim.ros.session.process_set import ProcessSet

with ProcessSet(Path(sys.argv[1])) as processes:
    process = processes.add("slow", [sys.executable, *sys.argv[2:]])
    process.start()
    while "up" not in process.output:
        pass
    print(process.pid, flush=True)
    {inside}
"""
SLOW = """
import os, signal, sys, time
def end(*_):
    for number in map(int, sys.argv[1:]):
        os.kill(os.getppid(), number)  # again, while the parent ends this one
    time.sleep(0.5)
    os._exit(7)
signal.signal(signal.SIGINT, end)
print("up", flush=True)
while True:  # a handler does not run while a sleep lasts that began just after the signal came
    time.sleep(0.05)
"""


@pytest.mark.parametrize(
    ("inside", "again"),
    [
        ("os.kill(os.getpid(), signal.SIGINT)", END_SIGNALS),
        ("processes.stop()", [signal.SIGINT]),
    ],
)
def test_no_process_survives_a_signal_while_it_is_being_ended(tmp_path, inside, again) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    program = textwrap.dedent(INTERRUPTED).format(inside=inside)
    numbers = [str(int(number)) for number in again]
    command = [sys.executable, "-c", program, str(tmp_path), str(tmp_path / "slow.py"), *numbers]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert "KeyboardInterrupt" in done.stderr
    assert not psutil.pid_exists(int(done.stdout)), "not waited for"


PARENTS = {
    "of a verb, which ignores signals": """
        import signal, sys
        from pathlib import Path
        from sphere_sim.ros.session.process_set import ProcessSet
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        node = ProcessSet(Path(sys.argv[1])).start("simulator")
        while "ROS domain" not in node.output: pass
        node.send(signal.SIGINT)
        node.wait(60.0)
        tell(node.start().pid)
    """,
    "of a worker": """
        from sphere_nmpc.worker.process import WorkerProcess
        worker = WorkerProcess(print)
        tell(worker.pid)
    """,
    "of a busy study": """
        import psutil
        from sphere_sim.study.workers import Workers
        runs = Workers(2).run(time.sleep, [(0, (0,)), (1, (3600,)), (2, (3600,))], "nap")
        next(runs)
        tell(*(child.pid for child in psutil.Process().children()))
    """,
}
TELL = """
import time
def tell(*pids):
    print(*pids, flush=True)
    time.sleep(3600)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a signal of Linux")
@pytest.mark.parametrize("parent", PARENTS)
def test_no_process_outlives_a_parent_that_is_killed(tmp_path, parent) -> None:
    program = f"exec({TELL + textwrap.dedent(PARENTS[parent])!r})"
    command = python_command(program, str(tmp_path))
    process = Child(command, log=tmp_path / "parent.log").start()
    until(lambda: process.output.endswith("\n") or not process.running)
    os.kill(process.pid, signal.SIGKILL)
    pids = list(map(int, process.output.split()))
    assert pids
    wait_for_end(pids)

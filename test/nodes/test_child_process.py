# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Child processes are killed, stopped, restarted and ended together, and their output is kept."""

import re
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator

import psutil
import pytest
from patience import PATIENCE

from sphere_nmpc.child import END_SIGNALS, Child, ChildEndedError
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
if "fail" in words:
    raise ValueError("on demand")
time.sleep(60)
"""


@pytest.fixture
def process(tmp_path) -> Iterator[Child]:
    """Return a process that prints that it is up, and then waits."""
    command = [sys.executable, "-c", WAITING]
    process = Child(command, "waiting", tmp_path / "waiting.log")
    yield process
    process.kill()


def until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "timed out"
        time.sleep(0.02)


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
    grandchild = psutil.Process(int(process.output.split()[-1]))
    process.kill()
    until(lambda: not grandchild.is_running() or grandchild.status() == psutil.STATUS_ZOMBIE)


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
    pid = int(done.stdout)
    assert not psutil.pid_exists(pid), "not waited for"


def test_verb_can_be_ended_though_its_parent_ignores_signals_and_ends_with_it(tmp_path) -> None:
    program = (
        "import signal, sys\nfrom pathlib import Path\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "from sphere_sim.ros.session.process_set import ProcessSet\n"
        "processes = ProcessSet(Path(sys.argv[1]))\n"
        "node = processes.start('simulator')\n"
        "while 'ROS domain' not in node.output: pass\n"
        "node.send(signal.SIGINT)\nnode.wait(60.0)\nnode.start()\n"
        "print(node.pid, flush=True)\n"
        "import os, signal; os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == -signal.SIGKILL
    node = psutil.Process(int(done.stdout)) if psutil.pid_exists(int(done.stdout)) else None
    until(lambda: node is None or not node.is_running()
          or node.status() == psutil.STATUS_ZOMBIE)

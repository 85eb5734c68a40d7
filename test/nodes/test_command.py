# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The command: one line and an exit code after any error, signal or lost output."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from patience import PATIENCE

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.process.child import END_SIGNALS
from sphere_sim.cli.exits import Signals, guarded, if_interrupted
from sphere_sim.output.error_text import in_words

pytestmark = pytest.mark.slow

COMMAND = """
import sys
from sphere_sim.cli import main as cli
cli.VERBS["roll"] = ("a_verb", "roll the sphere")
sys.path.insert(0, sys.argv.pop(1))
sys.exit(cli.main())
"""
WAITING = """
import time
def wait():
    print("up", flush=True)
    while True:  # a handler does not run while a sleep lasts that began just after the signal came
        time.sleep(0.05)
"""
Roll = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def roll(tmp_path) -> Iterator[Roll]:
    """Return a function that starts the verb `roll`, from its source; it ends with the test."""
    running = []

    def start(source: str, *arguments: str, **options) -> subprocess.Popen[str]:
        (tmp_path / "a_verb.py").write_text(source)
        command = [sys.executable, "-c", COMMAND, str(tmp_path), "roll", *arguments]
        options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **options}
        running.append(subprocess.Popen(command, **options))
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.wait()


def raising(error: BaseException) -> Callable[[], int]:
    def call() -> int:
        raise error

    return call


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (InvalidParameterError("x", 1, "2"), 2, "x: given 1, expected 2"),
        (FileNotFoundError(2, "No such file", "a.csv"), 1, "a.csv: No such file"),
        (MemoryError(), 1, "there is not enough memory"),
        (TypeError("two\nlines"), 1, "unexpected TypeError: two lines (--debug shows where)"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_every_exception_is_a_line_and_a_code(error, code, message, capsys) -> None:
    assert guarded("verb", raising(error), Signals()) == code
    assert capsys.readouterr().err == f"verb: {message}\n"


def test_message_of_an_interrupt_names_what_remains_whatever_the_exception(capsys) -> None:
    def verb() -> int:
        with if_interrupted(lambda: "all is kept"), if_interrupted(lambda: "a bag is left"):
            raise RuntimeError("of a library")

    signals = Signals()
    signals.received = signal.SIGTERM
    assert guarded("verb", verb, signals) == 143
    assert capsys.readouterr().err == "verb: interrupted; a bag is left\n"


def test_traceback_is_shown_on_request(roll) -> None:
    source = "def main(argv):\n    assert argv == ['--x', '--ros-args', '--debug']\n    int('a')\n"
    process = roll(source, "--debug", "--x", "--ros-args", "--debug")
    _, message = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "Traceback" in message and message.endswith("(--debug shows where)\n")


INTERRUPTED = "sphere_nmpc roll: interrupted\n"
IN_VERB = WAITING + "def main(argv): wait()"
IN_FINALISER = WAITING + """
class Slow:
    def __del__(self): wait()

def main(argv):
    x = Slow()
    del x
    wait()
"""


@pytest.mark.parametrize(
    ("source", "number", "message"),
    [(WAITING + "wait()", signal.SIGINT, ""), (IN_FINALISER, signal.SIGINT, INTERRUPTED),
     *((IN_VERB, number, INTERRUPTED) for number in END_SIGNALS)],
    ids=["while modules are loaded", "in a finaliser", *(number.name for number in END_SIGNALS)],
)
def test_signal_is_one_line_after_the_begin_of_the_work(roll, source, number, message) -> None:
    process = roll(source)
    assert process.stdout.readline() == "up\n"
    process.send_signal(number)
    assert process.communicate(timeout=PATIENCE)[1] == message
    assert process.returncode == 128 + number


COUNTING = """
import signal
{prepared}

def main(argv):
    while True:
        # The next signal is sent once this line is read; it must not arrive before the `try`.
        signal.pthread_sigmask(signal.SIG_BLOCK, {{signal.SIGINT}})
        print("up", flush=True)
        try:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {{signal.SIGINT}})
            while True:
                {call}
        except KeyboardInterrupt:
            pass
"""
STEPS = """
import numpy as np
from sphere_nmpc.model.integrator import step_function
state, speeds = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.ones(2)
constants = np.array([0.145, 0.5, 0.1, 0.2])
"""
POSES = """
import contextlib
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.ros.messages import message_object
raw = serialize_message(PoseStamped())
"""
REFUSED = "with contextlib.suppress(InvalidInputError): message_object(raw, PoseStamped)"


@pytest.mark.parametrize(("prepared", "call"), [
    (STEPS, "step_function()(state, speeds, speeds, 0.1, constants)"), (POSES, REFUSED),
], ids=["casadi", "messages"])
def test_no_signal_is_lost_in_bindings(roll, prepared: str, call: str) -> None:
    process = roll(COUNTING.format(prepared=prepared, call=call))
    for _ in range(8):
        assert process.stdout.readline() == "up\n"
        time.sleep(0.003)
        process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "up\n"
    process.kill()
    assert process.communicate()[1] == ""


PRINTING = """
def main(argv):
    print(1)
    print('x' * 100000)
    open(argv[0], 'w')
    return 0
"""


@pytest.mark.parametrize(
    ("disk", "code", "told"),
    [(False, 0, ""), (True, 1, "sphere_nmpc: standard output: No space left on device\n")],
    ids=["reader that has ended", "full disk"],
)
def test_output_that_is_lost_does_not_stop_the_work(roll, tmp_path, disk, code, told) -> None:
    inlet, outlet = os.pipe()
    os.close(inlet)
    with Path("/dev/full").open("w") as full, open(outlet, "w") as closed:
        process = roll(PRINTING, str(tmp_path / "result"), stdout=full if disk else closed)
    _, message = process.communicate(timeout=PATIENCE)
    assert (process.returncode, message) == (code, told)
    assert (tmp_path / "result").exists()


@pytest.mark.parametrize(
    ("absent", "words"),
    [("rclpy.node", "'rclpy' is not installed; it comes with pip install 'sphere_nmpc[ros]'"),
     ("geometry_msgs.msg", "'geometry_msgs' is not installed; it comes with pip install 'sphere_"),
     ("casadi", "'casadi' is not installed; it comes with pip install 'sphere_nmpc[benchmark]'"),
     ("scipy.no_such_module", "unexpected ModuleNotFoundError: ")],
)
def test_missing_package_is_named_with_its_source(absent, words, monkeypatch) -> None:
    monkeypatch.setattr("sphere_sim.output.error_text.find_spec", lambda name: name == "scipy")
    assert in_words(ModuleNotFoundError("it is not there", name=absent)).startswith(words)


def test_installed_command_exits_with_the_code() -> None:
    command = Path(sys.executable).with_name("sphere_nmpc")
    assert subprocess.run([command, "no-such-verb"], capture_output=True).returncode == 2

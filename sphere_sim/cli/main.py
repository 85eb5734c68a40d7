# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The ``sphere_nmpc`` command, which passes the arguments after a verb to its module.

Modules are imported only when their verb is called, so that the command starts quickly and
needs no more than what the verb needs. For ``ros2 run`` each verb is an executable of its own too,
in ``scripts/``, which starts the command. ``--debug``, before or after the verb, shows the
traceback of an error.
"""

import logging
import os
import sys
from collections.abc import Sequence
from importlib import import_module

from sphere_sim.cli.exits import Signals, guarded
from sphere_sim.cli.output import Output

VERBS = {
    "demo": ("sphere_sim.cli.demo", "run one of the paper's cases and watch it"),
    "simulator": ("sphere_sim.ros.simulator.node", "start the simulator node"),
    "controller": ("sphere_nmpc.ros.controller.node", "start the controller node"),
    "odometry": ("sphere_nmpc.ros.odometry.node", "start the node that estimates the pose"),
    "navigator": ("sphere_nmpc.ros.navigator.node", "start the node with the actions of Nav2"),
    "recorder": ("sphere_sim.ros.recorder.node", "start the recorder node"),
    "goal": ("sphere_sim.ros.session.goal_command", "publish a goal pose"),
    "viewer": ("sphere_sim.cli.viewer", "show a running or recorded sphere in the browser"),
    "markers": ("sphere_sim.ros.viewer.markers", "publish what RViz shows as markers"),
    "study": ("sphere_sim.cli.study", "run many scenarios and write tables of the outcome"),
    "benchmark": ("sphere_sim.cli.benchmark", "time the solver on this machine"),
    "report": ("sphere_sim.cli.report", "turn a recorded bag into figures and a summary"),
    "estimate": (
        "sphere_sim.cli.estimate", "estimate the poses of a bag from its IMU, or test the sensors",
    ),
    "identify": ("sphere_sim.cli.identify", "find the parameters of a robot from a recorded bag"),
}
_WITHOUT_ROS = ("study", "benchmark", "report", "identify")
_DEBUG = "--debug"
_ROS_ARGUMENTS = "--ros-args"


def main(argv: Sequence[str] | None = None) -> int:
    """Run a verb with its arguments; return its exit code, see `guarded`, or 2 for no such verb.

    By default they are those of the process, whose signals and standard streams are then the
    command's to handle.
    """
    signals, output = Signals(), Output()
    if argv is not None:
        return _run(argv, signals)
    signals.exit_immediately()
    output.install()
    # Figures are files. The kernel of a notebook names a backend that is installed with it, and
    # matplotlib cannot be imported without one that is named.
    os.environ["MPLBACKEND"] = "agg"
    # Without matplotlib's messages about its font cache.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    try:
        code = _run(sys.argv[1:], signals)
    finally:
        signals.exit_immediately()
    failure = output.failure()
    if failure:
        print(f"sphere_nmpc: {failure}", file=sys.stderr)
    return code or int(bool(failure))


def _run(argv: Sequence[str], signals: Signals) -> int:
    words, debug = _without_debug(argv)
    verb, *rest = words or ["--help"]
    if verb in ("-h", "--help"):
        print(_usage())
        return 0
    if verb == "--version":
        from importlib import metadata

        print(f"sphere_nmpc {metadata.version('sphere_nmpc')}")
        return 0
    if verb not in VERBS:
        print(f"sphere_nmpc: there is no '{verb}'\n\n{_usage()}", file=sys.stderr)
        return 2

    def call() -> int:
        if verb not in _WITHOUT_ROS:
            from sphere_nmpc.ros.network import check_middleware, check_shared_memory

            check_middleware()  # before rclpy is loaded, which ends the process otherwise
            check_shared_memory()
        module = import_module(VERBS[verb][0])
        signals.interrupt()
        code: int = module.main(rest)
        return code

    return guarded(f"sphere_nmpc {verb}", call, signals, debug)


def _without_debug(argv: Sequence[str]) -> tuple[list[str], bool]:
    """Return the words without ``--debug``, and whether it is there, ROS arguments apart."""
    words = list(argv)
    end = words.index(_ROS_ARGUMENTS) if _ROS_ARGUMENTS in words else len(words)
    ours = [word for word in words[:end] if word != _DEBUG]
    return ours + words[end:], len(ours) < end


def _usage() -> str:
    lines = (f"  {verb:<16} {purpose}" for verb, (_, purpose) in VERBS.items())
    return "\n".join(
        (
            "usage: sphere_nmpc [-h] [--version] [--debug] VERB ...",
            "",
            *lines,
            "",
            "'sphere_nmpc VERB --help' lists the arguments of a verb; with --debug any verb shows",
            "the traceback of an error.",
        )
    )

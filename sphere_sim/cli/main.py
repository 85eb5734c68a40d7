# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The ``sphere_nmpc`` command: hands the arguments after a verb to the module of that verb.

Modules are imported only when their verb is called, so that the command starts at once and
needs no more than what the verb needs. Each verb is an executable of its own too, for
``ros2 run``: started by the name of a verb, the command takes that for its first word.
"""

import sys
from collections.abc import Sequence
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path

VERBS = {
    "demo": ("sphere_sim.cli.demo", "run one of the paper's cases and watch it"),
    "simulator": ("sphere_sim.ros.simulator_node", "start the simulator node"),
    "controller": ("sphere_nmpc.ros.controller_node", "start the controller node"),
    "recorder": ("sphere_sim.ros.recorder_node", "start the recorder node"),
    "goal": ("sphere_sim.ros.goal_publisher", "publish a goal pose"),
    "viewer": ("sphere_sim.cli.viewer", "show a running or recorded sphere in the browser"),
    "markers": ("sphere_sim.ros.marker_node", "publish what RViz shows as markers"),
    "study": ("sphere_sim.cli.study", "run many scenarios and write tables of the outcome"),
    "benchmark": ("sphere_sim.cli.benchmark", "time the solver on this machine"),
    "report": ("sphere_sim.cli.report", "turn a recorded bag into figures and a summary"),
    "faults": ("sphere_sim.cli.faults", "inject faults and measure the recovery"),
}

# Extra of setup.py -> import names it brings, message packages apart.
_EXTRAS = {
    "ros": ("rclpy", "ament_index_python", "builtin_interfaces", "rcl_interfaces", "std_srvs"),
    "record": ("rosbags", "mcap", "mcap_ros2", "ruamel", "zstandard"),
    "sim": ("rich", "matplotlib"),
    "study": ("dask", "distributed"),
    "rigid": ("mujoco",),
    "viewer": ("viser",),
    "report": ("pyarrow",),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a verb.

    Parameters
    ----------
    argv : sequence of str, optional
        The verb and its arguments; by default those of the process, whose own name may be the
        verb.

    Returns
    -------
    int
        The verb's exit code; 1 when it needs a package that is not installed and 2 when there
        is no such verb.
    """
    verb, *rest = (_of_process() if argv is None else [*argv]) or ["--help"]
    if verb in ("-h", "--help"):
        print(_usage())
        return 0
    if verb == "--version":
        print(f"sphere_nmpc {metadata.version('sphere_nmpc')}")
        return 0
    if verb not in _available():
        print(f"sphere_nmpc: there is no '{verb}'\n\n{_usage()}", file=sys.stderr)
        return 2
    try:
        code: int = import_module(VERBS[verb][0]).main(rest)
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if not missing or find_spec(missing):  # a wrong import, not a missing package
            raise
        print(f"sphere_nmpc {verb}: {_advice(missing)}", file=sys.stderr)
        return 1
    return code


def _of_process() -> list[str]:
    """Return the words of this process: `report ...` stands for `sphere_nmpc report ...`."""
    name = Path(sys.argv[0]).stem  # on Windows a script has a suffix
    return [name, *sys.argv[1:]] if name in VERBS else sys.argv[1:]


def _available() -> list[str]:
    """Verbs whose module is part of this installation."""
    return [verb for verb, (module, _) in VERBS.items() if _is_present(module)]


def _is_present(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # a parent package is absent
        return False


def _usage() -> str:
    lines = (f"  {verb:<11} {VERBS[verb][1]}" for verb in _available())
    return "\n".join(
        (
            "usage: sphere_nmpc [-h] [--version] VERB ...",
            "",
            *lines,
            "",
            "'sphere_nmpc VERB --help' tells the arguments of a verb.",
        )
    )


def _advice(missing: str) -> str:
    if missing.endswith("_msgs"):
        missing_from = "ros"
    else:
        missing_from = next((e for e, names in _EXTRAS.items() if missing in names), "all")
    return f"'{missing}' is not installed; it comes with pip install 'sphere_nmpc[{missing_from}]'"

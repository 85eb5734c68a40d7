# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc demo``: a run from start to goal over ROS 2, recorded and drawn."""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from sphere_nmpc.errors import InvalidParameterError, InvalidStateError
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.cli.exits import if_interrupted
from sphere_sim.demo.plan import DemoPlan
from sphere_sim.demo.run import run_demo
from sphere_sim.output.arguments import assignment, finite, not_negative, positive, whole
from sphere_sim.output.files import prepare_folder
from sphere_sim.recording.bag_files import BagError
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.scenario.scenarios import PAPER_CASES


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo; return 0 when the sphere has arrived, 1 when it has not."""
    plan = parse(arguments)

    def remains() -> str:
        kept = f"; {plan.bag} keeps what was recorded" if plan.bag.exists() else ""
        return f"all nodes are stopped{kept}"

    with if_interrupted(remains), own_domain() as domain:
        if plan.bag.exists():
            reason = "exists already and is not overwritten; choose another --out"
            raise BagError(plan.bag, reason)
        prepare_folder(plan.folder)
        return 0 if run_demo(plan, domain, Console()) else 1


def parse(arguments: Sequence[str] | None) -> DemoPlan:
    """Return the plan of the command line; exits with 2 if the arguments are wrong."""
    parser = argparse.ArgumentParser(
        prog="sphere_nmpc demo",
        description="Run simulator, controller and recorder as separate ROS 2 nodes until the "
        "sphere is at its goal. Exits 0 when it has arrived there, 1 when it has not.",
    )
    parser.add_argument(
        "--case", type=int, choices=sorted(PAPER_CASES), default=1,
        help="case of the paper; 4 has noise and a robot with other parameters (default: 1)",
    )
    state = ("X", "Y", "QW", "QX", "QY", "QZ")
    parser.add_argument("--from", dest="start", nargs=6, type=finite, metavar=state,
                        help="start in place of the case's [m, -]")
    parser.add_argument("--goal", nargs=6, type=finite, metavar=state,
                        help="goal in place of the case's [m, -]")
    parser.add_argument(
        "--rtf", dest="real_time_factor", type=not_negative, default=1.0, metavar="F",
        help="simulated over wall time; 0: lockstep, as fast as the nodes can (default: 1)",
    )
    parser.add_argument("--lockstep", action="store_true",
                        help="let time wait for the controller, so that runs repeat to the bit")
    parser.add_argument("--strategy", metavar="NAME",
                        help="what the controller solves: " + " or ".join(STRATEGIES))
    parser.add_argument(
        "--set", dest="settings", type=assignment, nargs="+", action="extend", default=[],
        metavar="NAME=VALUE",
        help="other settings as of sphere_nmpc study, such as horizon=8, plant=rigid_body or "
        "robot.shell_mass=1.5",
    )
    parser.add_argument("--seed", type=whole(0), default=0,
                        help="of all that is random (default: 0)")
    parser.add_argument("--duration", type=positive, default=60.0, metavar="S",
                        help="simulated time after which to give up (default: 60)")
    parser.add_argument("--out", dest="folder", type=Path, metavar="DIR",
                        help="folder for bag, figure and summary (default: runs/<date and time>)")
    parser.add_argument("--no-compare", dest="compare", action="store_false",
                        help="leave out the other strategy, which is computed without ROS")
    parser.add_argument("--no-viewer", dest="viewer", action="store_false",
                        help="show nothing in the browser")
    given = parser.parse_args(arguments)
    out = given.folder or Path("runs") / time.strftime("demo_%Y-%m-%d_%H-%M-%S")
    given.folder = out.expanduser().absolute()
    given.strategy = given.strategy or ControllerSettings.strategy
    given.viewer = given.viewer and sys.stdout.isatty()
    try:
        return DemoPlan(**vars(given), interactive=sys.stdin.isatty())
    except InvalidStateError as error:
        parser.error(f"--from, --goal: {error}")
    except InvalidParameterError as error:
        parser.error(str(error))

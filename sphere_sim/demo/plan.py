# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the demo runs: arguments, scenario and the parameters of its nodes."""

import argparse
import dataclasses
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.errors import InvalidParameterError, InvalidStateError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import as_state
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.cli.arguments import finite, not_negative, positive, whole
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import PAPER_CASES, Scenario

DISTURBED_CASE = 4
PROCESS_NOISE = 3e-4
"""Standard deviation of W(k) in case 4 [m, -].

The paper does not print its own. With this one its controller does what the paper says, it keeps
the sphere near the goal; with 1e-3 it does not.
"""
PERTURBATION = 0.03
"""Largest relative error of a parameter in case 4."""
STAY = 10.0
"""For how long a disturbed run is watched after it has arrived [s]."""
NEIGHBOURHOOD = 0.05
"""A disturbed run has arrived when its error stays below this [mixed units]."""
ARRIVED = 1e-2
"""An undisturbed run has arrived when its error stays below this [mixed units]."""


@dataclass(frozen=True)
class DemoPlan:
    """One run to show.

    Attributes
    ----------
    scenario_title : str
        What it is, for people, whoever controls it.
    scenario : Scenario
        Start, goal and seed.
    folder : Path
        Where everything goes.
    tolerance : float
        Error below which the run has arrived [mixed units].
    hold : float
        For how long it has to stay below [s], simulated.
    duration : float
        Simulated time after which it is given up [s].
    simulator, controller, recorder : dict
        Parameters of the nodes.
    viewer : bool
        Whether to show it in the browser.
    stays : bool
        Whether to leave the sphere to who watches once the run is over.
    strategy, other_strategy : str
        What the controller solves, and what it is compared with.
    compare : bool
        Whether to compare.
    disturbed : bool
        Whether there is noise, which nobody can settle against.
    linger : float
        For how long the run goes on once it has arrived [s], simulated.
    """

    scenario_title: str
    scenario: Scenario
    folder: Path
    tolerance: float
    hold: float
    duration: float
    simulator: dict[str, Any]
    controller: dict[str, Any]
    recorder: dict[str, Any]
    viewer: bool
    stays: bool
    strategy: str
    other_strategy: str
    compare: bool
    disturbed: bool
    linger: float

    @property
    def title(self) -> str:
        """What it is, for people."""
        return f"{self.scenario_title}, strategy {self.strategy}"

    @property
    def bag(self) -> Path:
        """Where the recording goes."""
        return self.folder / "bag"


def parse(arguments: Sequence[str] | None) -> DemoPlan:
    """Return the plan behind the command line; exits with 2 when it is not understood."""
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
        "--rtf", type=not_negative, default=1.0, metavar="F",
        help="simulated over wall time; 0: lockstep, as fast as the nodes can (default: 1)",
    )
    parser.add_argument("--lockstep", action="store_true",
                        help="let time wait for the controller, so that runs repeat to the bit")
    parser.add_argument("--strategy", metavar="NAME",
                        help="what the controller solves: " + " or ".join(STRATEGIES))
    parser.add_argument("--seed", type=whole(0), default=0,
                        help="of all that is random (default: 0)")
    parser.add_argument("--duration", type=positive, default=60.0, metavar="S",
                        help="simulated time after which to give up (default: 60)")
    parser.add_argument("--out", type=Path, metavar="DIR",
                        help="folder for bag, figure and summary (default: runs/<date and time>)")
    parser.add_argument("--no-compare", action="store_true",
                        help="leave out the other strategy, which is computed without ROS")
    parser.add_argument("--no-viewer", action="store_true", help="show nothing in the browser")
    given = parser.parse_args(arguments)
    try:
        return make_plan(given)
    except InvalidStateError as error:
        parser.error(f"--from, --goal: {error}")
    except InvalidParameterError as error:
        parser.error(str(error))


def make_plan(given: argparse.Namespace) -> DemoPlan:
    """Return the plan behind parsed arguments.

    Raises
    ------
    InvalidStateError
        If start or goal is not a state.
    InvalidParameterError
        If there is no such strategy.
    """
    case = PAPER_CASES[given.case]
    start = case.start if given.start is None else as_state(given.start)
    goal = case.goal if given.goal is None else as_state(given.goal)
    own = given.start is not None or given.goal is not None
    disturbed = given.case == DISTURBED_CASE and not own
    lockstep = bool(given.lockstep or given.rtf == 0.0)
    strategy = given.strategy or ControllerSettings().strategy
    if strategy not in STRATEGIES:
        names = " or ".join(STRATEGIES)
        raise InvalidParameterError("--strategy", strategy, names)
    settings = ControllerSettings(strategy=strategy)
    simulator: dict[str, Any] = {
        "initial_state": start.tolist(),
        "real_time_factor": given.rtf,
        "lockstep": lockstep,
        "sample_period": settings.control_period,
        "seed": given.seed,
        "start_paused": True,
    }
    if disturbed:
        simulator["process_noise"] = PROCESS_NOISE
        robot = perturbed(RobotParameters(), PERTURBATION, np.random.default_rng(given.seed))
        simulator.update({f"robot.{k}": v for k, v in dataclasses.asdict(robot).items()})
    name = time.strftime("demo_%Y-%m-%d_%H-%M-%S")
    folder = (given.out or Path("runs") / name).expanduser().absolute()
    watched = not given.no_viewer and sys.stdout.isatty()
    what = "own start and goal" if own else f"case {given.case} of the paper"
    if disturbed:
        what += f" (noise {PROCESS_NOISE:g} a sample, parameters wrong by up to 3 %)"
    return DemoPlan(
        scenario_title=what,
        scenario=Scenario(start, goal, given.seed),
        folder=folder,
        tolerance=NEIGHBOURHOOD if disturbed else ARRIVED,
        hold=2.0,
        duration=given.duration,
        simulator=simulator,
        controller={"use_sim_time": True, "lockstep": lockstep, "strategy": strategy},
        recorder={"use_sim_time": True, "output": str(folder / "bag")},
        viewer=watched,
        stays=watched and not lockstep and sys.stdin.isatty(),
        strategy=strategy,
        other_strategy="paper" if strategy == "time_optimal" else "time_optimal",
        compare=not given.no_compare,
        disturbed=disturbed,
        linger=STAY if disturbed else 0.0,
    )

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc faults``: fault campaign on running nodes, with up to three faults at once."""

import argparse
import contextlib
import math
import os
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros.network import DOMAIN, RosEnvironmentError
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.cli.arguments import number, whole
from sphere_sim.cli.exits import if_interrupted
from sphere_sim.faults.catalogue import FAULTS, Fault, chosen, combined, name_of
from sphere_sim.faults.outcome import FaultRow, Outcome, read_outcomes, rows, write_json
from sphere_sim.output.result_folder import prepare_folder
from sphere_sim.ros.faults.fault_session import RATE, SessionSettings
from sphere_sim.ros.faults.machine_faults import MACHINE_FAULTS, MachineFault
from sphere_sim.ros.faults.trial_process import TrialPlan
from sphere_sim.ros.faults.trial_processes import run_trials
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.world.settings import PLANTS

_PAIRS = 12
_MOST_JOBS = 16
_IN_COMMON = ("seed", "rtf", "strategy", "plant", "rate")
"""Arguments that all trials in a file have in common."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign.

    Returns
    -------
    int
        0 when every trial was survived, 1 when one was not.

    Raises
    ------
    SphereNmpcError
        If the campaign cannot be run.
    """
    given = _parse(arguments)
    if given.jobs > 1 and (domain := os.environ.get(DOMAIN)):
        raise RosEnvironmentError(DOMAIN, domain, f"no value with --jobs {given.jobs}")
    console = Console()
    campaign = {name: getattr(given, name) for name in _IN_COMMON}
    prepare_folder(given.json.parent)
    outcomes = read_outcomes(given.json, campaign) if given.resume else []
    done = {(outcome.fault, outcome.repetition) for outcome in outcomes}
    plans = [p for p in _plans(given) if (name_of(p.faults), p.repetition) not in done]
    machines = [
        (fault, repetition)
        for repetition in range(given.repeat)
        for fault in chosen(MACHINE_FAULTS.values(), given.fault, given.quick)
        if (fault.name, repetition) not in done
    ]
    number_of_trials = len(outcomes) + len(plans) + len(machines)

    def remains() -> str:
        tried = f"{len(outcomes)} of {number_of_trials} trials"
        return f"all nodes are stopped after {tried}; --resume continues from {given.json}"

    with if_interrupted(remains), _folder(given.out, given.resume) as folder:
        settings = SessionSettings(
            folder, given.rtf, given.seed, given.strategy, given.plant, given.rate
        )
        for outcome in chain(
            _run_trials(plans, settings, given.jobs, console),
            _run_machine_faults(machines, console),
        ):
            outcomes.append(outcome)
            write_json(given.json, outcomes, campaign)
    table = rows(outcomes)
    _print(table, console)
    return 0 if all(row.survived == len(row.outcomes) for row in table) else 1


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    known = [*FAULTS, *MACHINE_FAULTS]
    groups = list(dict.fromkeys([*(fault.group for fault in FAULTS.values()), "machine"]))
    parser = argparse.ArgumentParser(
        prog="sphere_nmpc faults",
        description="Run simulator, controller and recorder as separate ROS 2 nodes, cause a "
        "fault during a run to a goal, and evaluate the recovery. Exits 0 when every trial was "
        "survived.",
        epilog="groups: " + ", ".join(groups) + "; faults: " + ", ".join(known),
    )
    parser.add_argument("--json", type=Path, required=True, metavar="FILE",
                        help="write the table to this file")
    parser.add_argument("--quick", action="store_true", help="one fault or two of each group")
    parser.add_argument("--fault", nargs="+", action="extend", default=[], metavar="NAME",
                        choices=[*groups, *known], help="only these faults or groups of faults")
    parser.add_argument("--pairs", nargs="?", type=whole(1), const=_PAIRS, default=0, metavar="N",
                        help="then N pairs of simultaneous faults, drawn by the seed "
                        f"(default: {_PAIRS})")
    parser.add_argument("--triples", type=whole(1), default=0, metavar="N",
                        help="then N triples likewise")
    parser.add_argument("--repeat", type=whole(1), default=1, metavar="N",
                        help="try each fault N times, each time with another goal")
    parser.add_argument("--seed", type=whole(0), default=0,
                        help="of all that is random (default: 0)")
    parser.add_argument("--rtf", type=float, default=2.0, metavar="F",
                        help="simulated over wall time (default: 2)")
    parser.add_argument("--strategy", choices=sorted(STRATEGIES),
                        default=ControllerSettings().strategy, help="what the controller solves")
    parser.add_argument("--plant", choices=PLANTS, default=PLANTS[0],
                        help="what the simulator simulates (default: %(default)s)")
    parser.add_argument("--rate", type=number(RATE, 500.0), default=RATE, metavar="HZ",
                        help="rate of poses, commands and, above the default, solves (default: "
                        "%(default)g Hz, and a solve at each sampling instant)")
    parser.add_argument("--jobs", type=whole(1, _MOST_JOBS), default=1, metavar="N",
                        help="run N trials at the same time, each in a ROS domain of its own")
    parser.add_argument("--resume", action="store_true",
                        help="keep the trials in --json and run those that it lacks")
    parser.add_argument("--out", type=Path, metavar="DIR",
                        help="keep logs and bags in this folder")
    given = parser.parse_args(arguments)
    if not 0.5 <= given.rtf <= 5.0:
        parser.error(f"--rtf: given {given.rtf:g}, expected 0.5 to 5")
    return given


def _plans(given: argparse.Namespace) -> list[TrialPlan]:
    """Return the trials: each fault, as often as wanted, then the combinations."""
    singles = chosen(FAULTS.values(), given.fault, given.quick)
    several: list[tuple[Fault, ...]] = [(fault,) for fault in singles] * given.repeat
    for size, wanted in ((2, given.pairs), (3, given.triples)):
        several += combined(singles, size, wanted, given.seed)
    tried: Counter[str] = Counter()
    plans = []
    for faults in several:
        plans.append(TrialPlan(faults, tried[name_of(faults)]))
        tried[name_of(faults)] += 1
    return plans


@contextlib.contextmanager
def _folder(given: Path | None, may_exist: bool) -> Iterator[Path]:
    """Yield the folder for logs and bags, a temporary one unless `given`."""
    if given is not None:
        folder = given.expanduser().absolute()
        if folder.exists() and any(folder.iterdir()) and not may_exist:
            raise SphereNmpcError(f"{folder}: is not empty; choose another --out")
        yield folder
        return
    folder = Path(tempfile.mkdtemp(prefix="sphere_nmpc_faults_"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _run_trials(
    plans: list[TrialPlan], settings: SessionSettings, jobs: int, console: Console
) -> Iterator[Outcome]:
    """Run the trials with a display of the progress."""
    with _progress(console) as progress:
        task = progress.add_task("starting nodes", total=len(plans), visible=bool(plans))

        def show(plan: TrialPlan) -> None:
            progress.update(task, description=name_of(plan.faults))

        for outcome in run_trials(plans, settings, jobs, show):
            progress.advance(task)
            progress.console.print(_line(outcome), highlight=False, soft_wrap=True)
            yield outcome


def _run_machine_faults(
    faults: list[tuple[MachineFault, int]], console: Console
) -> Iterator[Outcome]:
    """Run the commands under faults of the machine, each with its repetition."""
    with own_domain() if faults else contextlib.nullcontext(), _progress(console) as progress:
        task = progress.add_task("machines", total=len(faults), visible=bool(faults))
        for fault, repetition in faults:
            progress.update(task, description=fault.name)
            outcome = replace(fault.run(), repetition=repetition)
            progress.advance(task)
            progress.console.print(_line(outcome), highlight=False, soft_wrap=True)
            yield outcome


def _progress(console: Console) -> Progress:
    columns = (TextColumn("{task.description:<36}"), BarColumn(), MofNCompleteColumn(),
               TimeElapsedColumn())
    return Progress(*columns, console=console)


def _line(outcome: Outcome) -> str:
    if outcome.survived and math.isnan(outcome.recovery):
        return f"{outcome.fault}: survived"
    if outcome.survived:
        return f"{outcome.fault}: survived, at the goal {outcome.recovery:.2f} s after it"
    complaints = "; ".join(outcome.complaints)
    return f"[red]{escape(f'{outcome.fault}: {complaints}')}[/red]"


def _print(table: list[FaultRow], console: Console) -> None:
    robot = RobotParameters()
    shown = Table(
        "fault", "tried", "survived", "recovery [s]", "speed [rad/s]", "slew [rad/s^2]",
        title=f"limits: {robot.max_rotor_speed:g} rad/s, {robot.max_rotor_acceleration:g} rad/s^2",
        title_justify="left",
    )
    for row in table:
        style = "" if row.survived == len(row.outcomes) else "red"
        recovery = "-" if math.isnan(row.recovery) else f"{row.recovery:.2f}"
        worst = (max(o.worst_speed for o in row.outcomes), max(o.worst_slew for o in row.outcomes))
        shown.add_row(
            row.fault, str(len(row.outcomes)), str(row.survived), recovery,
            f"{worst[0]:.2f}", f"{worst[1]:.2f}", style=style,
        )
    console.print(shown)
    for row in table:
        for complaint in row.complaints:
            text = f"{row.fault}: {complaint}"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
    survived, tried = (sum(n) for n in zip(*((r.survived, len(r.outcomes)) for r in table),
                                           strict=True))
    console.print(f"{survived} of {tried} trials survived")

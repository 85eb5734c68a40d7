# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc faults``: fault campaign on running nodes, with single faults and pairs."""

import argparse
import contextlib
import math
import shutil
import tempfile
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
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.cli.arguments import whole
from sphere_sim.cli.exits import if_interrupted
from sphere_sim.faults.catalogue import FAULTS, Fault, chosen, name_of, pairs
from sphere_sim.faults.outcome import FaultRow, Outcome, rows, write_json
from sphere_sim.output.result_folder import prepare_folder
from sphere_sim.ros.faults.fault_session import SessionSettings, fault_session
from sphere_sim.ros.faults.machine_faults import MACHINE_FAULTS, MachineFault
from sphere_sim.ros.faults.trial import Trial
from sphere_sim.ros.session.domain import own_domain

_PAIRS = 12


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
    console = Console()
    singles = chosen(FAULTS.values(), given.fault, given.quick)
    trials = [(fault,) for fault in singles] * given.repeat
    if given.pairs:
        trials += pairs(singles, given.pairs, given.seed)
    machines = chosen(MACHINE_FAULTS.values(), given.fault, given.quick) * given.repeat
    prepare_folder(given.json.parent)
    outcomes: list[Outcome] = []

    def remains() -> str:
        done = f"{len(outcomes)} of {len(trials) + len(machines)} trials"
        return f"all nodes are stopped after {done}"

    try:
        with if_interrupted(remains), _folder(given.out) as folder, own_domain():
            for outcome in chain(
                _run_trials(
                    trials, SessionSettings(folder, given.rtf, given.seed, given.strategy), console
                ),
                _run_machine_faults(machines, console),
            ):
                outcomes.append(outcome)
    finally:
        table = rows(outcomes)
        if table:
            write_json(given.json, table)
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
    parser.add_argument("--repeat", type=whole(1), default=1, metavar="N",
                        help="try each fault N times, each time with another goal")
    parser.add_argument("--seed", type=whole(0), default=0,
                        help="of all that is random (default: 0)")
    parser.add_argument("--rtf", type=float, default=2.0, metavar="F",
                        help="simulated over wall time (default: 2)")
    parser.add_argument("--strategy", choices=sorted(STRATEGIES),
                        default=ControllerSettings().strategy, help="what the controller solves")
    parser.add_argument("--out", type=Path, metavar="DIR",
                        help="keep logs and bags in this folder")
    given = parser.parse_args(arguments)
    if not 0.5 <= given.rtf <= 5.0:
        parser.error(f"--rtf: given {given.rtf:g}, expected 0.5 to 5")
    return given


@contextlib.contextmanager
def _folder(given: Path | None) -> Iterator[Path]:
    """Yield the folder for logs and bags, a temporary one unless `given`."""
    if given is not None:
        folder = given.expanduser().absolute()
        if folder.exists() and any(folder.iterdir()):
            raise SphereNmpcError(f"{folder}: is not empty; choose another --out")
        yield folder
        return
    folder = Path(tempfile.mkdtemp(prefix="sphere_nmpc_faults_"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _run_trials(
    trials: list[tuple[Fault, ...]], settings: SessionSettings, console: Console
) -> Iterator[Outcome]:
    """Run the trials; after one that was not survived the nodes are restarted."""
    left = list(trials)
    sessions = 0
    with _progress(console) as progress:
        task = progress.add_task("starting nodes", total=len(trials), visible=bool(trials))
        while left:
            sessions += 1
            own = replace(
                settings,
                folder=settings.folder / f"session_{sessions}",
                seed=settings.seed + sessions - 1,
            )
            with fault_session(own) as session:
                while left:
                    faults = left.pop(0)
                    progress.update(task, description=name_of(faults))
                    outcome = Trial(session, faults).run()
                    progress.advance(task)
                    progress.console.print(_line(outcome), highlight=False, soft_wrap=True)
                    yield outcome
                    if not outcome.survived:
                        break


def _run_machine_faults(faults: list[MachineFault], console: Console) -> Iterator[Outcome]:
    """Run the commands under faults of the machine."""
    with _progress(console) as progress:
        task = progress.add_task("machines", total=len(faults), visible=bool(faults))
        for fault in faults:
            progress.update(task, description=fault.name)
            outcome = fault.run()
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

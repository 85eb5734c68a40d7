# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Trials that are run in several processes at the same time."""

import select
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError
from sphere_sim.faults.outcome import Outcome
from sphere_sim.recording.run_reader import read_run
from sphere_sim.ros.faults.fault_session import SessionSettings
from sphere_sim.ros.faults.trial_process import TrialPlan, TrialProcess


def run_trials(
    plans: Sequence[TrialPlan],
    settings: SessionSettings,
    jobs: int,
    on_begin: Callable[[TrialPlan], object],
) -> Iterator[Outcome]:
    """Yield the outcome of each trial as it is done.

    Parameters
    ----------
    plans : sequence of TrialPlan
        The trials.
    settings : SessionSettings
        Settings of all sessions; each process has a folder of its own in the given one.
    jobs : int
        Number of processes.
    on_begin : callable
        Called with each trial that begins.

    Raises
    ------
    TrialsError
        If nodes cannot be started, or a process has ended.
    """
    left = iter(plans)
    processes: list[TrialProcess] = []

    def go_on(process: TrialProcess) -> bool:
        """Begin the next trial; end the process and return False if there is none."""
        plan = next(left, None)
        if plan is not None:
            on_begin(plan)
        process.begin(plan)
        return plan is not None

    try:
        for number in range(1, min(jobs, len(plans)) + 1):
            folder = settings.folder / f"job_{number}"
            processes.append(TrialProcess(replace(settings, folder=folder)))
        busy = {process.link: process for process in processes if go_on(process)}
        while busy:
            for link in select.select(list(busy), [], [])[0]:
                process = busy[link]
                outcome, bags = process.outcome()
                if not go_on(process):
                    del busy[link]
                yield _with_bags(outcome, bags)  # while the next trial runs
    finally:
        for process in processes:
            process.close()


def _with_bags(outcome: Outcome, bags: tuple[Path, ...]) -> Outcome:
    """Return the outcome of a trial with a complaint about each bag that cannot be read.

    It is not done between two trials, as the proxy has to serve the nodes all the time.
    """
    complaints = list(outcome.complaints)
    for bag in bags:
        try:
            read_run(bag)
        except SphereNmpcError as error:
            complaints.append(str(error))
    return replace(outcome, complaints=tuple(complaints))

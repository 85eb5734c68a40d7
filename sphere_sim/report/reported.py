# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of a report, and which of their goals it has figures of."""

import dataclasses
from collections.abc import Iterator, Sequence
from functools import cached_property

from sphere_nmpc.model.state import STATE_NAMES
from sphere_sim.evaluation.metrics import Metrics
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.run import Run

COLUMNS = (
    "goal", "time_s", "duration_s",
    *(f"{which}_{name}" for which in ("start", "goal") for name in STATE_NAMES),
    *(field.name for field in dataclasses.fields(Metrics)),
)
"""Columns of the table of goals: its number, when it came into force and for how long, the states
at the start and at the goal, and the metrics of the run to it."""


@dataclasses.dataclass(frozen=True)
class Reported:
    """A recording with the goals that have figures.

    Attributes
    ----------
    recording : Run
        The whole recording.
    goals : sequence of int
        Numbers of these goals, from 1 on; empty where it has none.
    prefix : str
        Prefix of the names of its files.
    """

    recording: Run
    goals: Sequence[int]
    prefix: str = ""

    @cached_property
    def runs(self) -> dict[str, Run]:
        """The runs that have figures, by the prefix of their file names.

        One for each of `goals`; the recording itself where there are none.
        """
        if not self.goals:
            return {self.prefix: self.recording}
        several = len(self.goals) > 1
        return {
            f"{self.prefix}goal_{i}_" if several else self.prefix: self.recording.to_goal(i)
            for i in self.goals
        }

    @property
    def hint(self) -> str:
        """Says which goals have figures and how to get others; empty where all have."""
        number = len(self.recording.goals)
        if len(self.goals) == number:
            return ""
        drawn = f"goal{'s' * (len(self.goals) > 1)} {', '.join(map(str, self.goals))}"
        return f"{number} goals; figures of {drawn}; --goal 1 2 ... or --goal all for others"

    def rows(self) -> Iterator[tuple[dict[str, float], Run]]:
        """Yield for each goal of the recording its values of `COLUMNS`, and the run to it."""
        for i, time in enumerate(self.recording.goal_times, start=1):
            run = self.recording.to_goal(i)
            values = (
                i, float(time), float(run.times[-1]), *run.states[0].tolist(),
                *run.goals[0].tolist(), *metrics_of(run).values(),
            )
            yield dict(zip(COLUMNS, values, strict=True)), run


def select_goals(recording: Run, wanted: Sequence[int] | None) -> list[int]:
    """Return the numbers of the goals that have figures.

    Parameters
    ----------
    recording : Run
        The recording.
    wanted : sequence of int, or None
        Numbers from 1 on; empty for the last goal, None for all.

    Raises
    ------
    BagError
        If the recording does not have one of them.
    """
    number = len(recording.goals)
    if wanted is None:
        return list(range(1, number + 1))
    for i in wanted:
        if i > number:
            expected = f"1 to {number} or 'all'" if number else "none, as it holds no goal"
            raise BagError(recording.path, f"--goal: given {i}, expected {expected}")
    return sorted(set(wanted)) or [number][:number]


def metrics_of(run: Run) -> dict[str, float]:
    """Return the metrics of a run by name; empty where it has no goal."""
    metrics = run.metrics()
    return {} if metrics is None else dataclasses.asdict(metrics)


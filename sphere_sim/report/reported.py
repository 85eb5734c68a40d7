# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of a report, which of their goals it has figures of, and their tables."""

import dataclasses
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.state import POSE_NAMES, QUATERNION, Vector
from sphere_sim.evaluation.metrics import ERRORS, Metrics, touches
from sphere_sim.output.files import write_atomically
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.run import Run

COLUMNS = (
    "goal", "goal_orientation", "time_s", "duration_s",
    *(f"{which}_{name}" for which in ("start", "goal") for name in POSE_NAMES),
    *(field.name for field in dataclasses.fields(Metrics)),
)
"""Columns of the table of goals: its number, what it demands of the orientation, when it came into
force and for how long, the states at the start and at the goal, and the metrics of the run to it.
The quaternion of a goal that demands nothing of the orientation is nan."""


@dataclasses.dataclass(frozen=True)
class Reported:
    """A recording with the goals that have figures."""

    recording: Run
    goals: Sequence[int]
    """Numbers of these goals, from 1 on; empty where it has none."""
    prefix: str = ""
    """Prefix of the names of its files."""

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

    def rows(self) -> Iterator[tuple[dict[str, float | str], Run]]:
        """Yield for each goal of the recording its values of `COLUMNS`, and the run to it."""
        for i, time in enumerate(self.recording.goals.times, start=1):
            run = self.recording.to_goal(i)
            goal = run.goals.values[0]
            orientation, target = goal.orientation, goal.pose.copy()
            if orientation is Orientation.ANY:
                target[QUATERNION] = np.nan
            values = (
                i, orientation.value, float(time), float(run.times[-1]), *run.states[0].tolist(),
                *target.tolist(), *metrics_of(run).values(),
            )
            yield dict(zip(COLUMNS, values, strict=True)), run


def select_goals(recording: Run, wanted: Sequence[int] | None) -> list[int]:
    """Return the numbers of the goals that have figures, from 1 on.

    None in place of those wanted stands for all, an empty sequence for the last one. `BagError` is
    raised if the recording does not have one of them.
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


def floor_metrics(run: Run) -> dict[str, float]:
    """Return the least clearance of a run, how often it touched what is occupied, and when first.

    It is empty for a run on a free floor; the time [s] is nan without a touch. Touches are those
    that the simulator counted, as walls may stop the sphere before it reaches them, or those by
    the poses if there are more.
    """
    known = run.clearances[np.isfinite(run.clearances)]
    counted, begun = run.contacts.times, run.times[touches(run.clearances)]
    if not (known.size or counted.size):
        return {}
    return {
        "least_clearance_m": float(known.min()) if known.size else float("nan"),
        "contacts": max(counted.size, begun.size),
        "first_contact_s": float(min((*counted[:1], *begun[:1]), default=float("nan"))),
    }


def odometry_metrics(run: Run) -> dict[str, float]:
    """Return the errors of odometry at the end of a run; empty for one without estimates.

    They are those of `estimate_errors`, but for the heading without its sign and in degrees.
    """
    errors = run.estimate_errors.values
    known = errors[np.isfinite(errors[:, 0])].tolist()
    return {
        "odometry_position_error_m": known[-1][0],
        "odometry_heading_error_deg": abs(math.degrees(known[-1][1])),
    } if known else {}


def motion_table(run: Run) -> dict[str, Vector]:
    """Return the columns of a table with one row for each pose.

    They are times [s], states [m, -], errors, the clearance [m] where the floor is not free, and
    rotor speeds [rad/s] and torques [N m] interpolated at the poses; nan where not recorded.
    """
    table = {"time_s": run.times}
    table.update({name: run.states[:, i] for i, name in enumerate(POSE_NAMES)})
    table |= dict(zip(ERRORS, run.goal_errors.T, strict=True))
    if run.has_floor:
        table["clearance_m"] = run.clearances
    for name, unit, values in (
        ("rotor_speed", "rad_s", run.rotor_speeds),
        ("rotor_torque", "nm", run.rotor_torques),
    ):
        columns = values.interpolated(run.times, math.nan).T
        table |= {f"{name}_{i}_{unit}": column for i, column in enumerate(columns, start=1)}
    return table


def solve_table(run: Run) -> dict[str, Vector]:
    """Return the columns of a table with one row for each solve: times, durations [s], values."""
    solves = run.solves
    return {"time_s": solves.times, "solve_time_s": solves.column("duration"),
            "cost": solves.column("cost")}


def goal_table(one: Reported) -> dict[str, NDArray[Any]]:
    """Return the columns of a table with one row for each goal; see `COLUMNS`."""
    rows = [values for values, _ in one.rows()]
    return {
        name: np.array([row[name] for row in rows], str if name == "goal_orientation" else float)
        for name in COLUMNS
    }


def write_csv(table: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write a table of numbers and words with a header line, exact to the last bit."""
    columns = [
        column if column.dtype.kind == "U" else np.char.mod("%.17g", column)
        for column in table.values()
    ]
    text = io.StringIO()
    np.savetxt(text, np.column_stack(columns), "%s", ",", header=",".join(table), comments="")
    write_atomically(path, text.getvalue())

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Outcomes of trials, and the JSON file and the tables made of them."""

import json
import math
import statistics
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.foreign_text import shown
from sphere_sim.output.files import write_atomically


@dataclass(frozen=True)
class Outcome:
    """Outcome of one trial."""

    fault: str
    """Name of the fault, or of several."""
    recovery: float = math.nan
    """Time from the end of the fault to settling at the goal [s, simulated]; nan if it did not."""
    worst_speed: float = 0.0
    """Largest rotor speed, commanded or measured [rad/s]."""
    worst_slew: float = 0.0
    """Largest rotor acceleration, commanded or measured [rad/s^2]."""
    complaints: tuple[str, ...] = ()
    """Reasons why it does not count as survived."""
    repetition: int = 0
    """Number of the trial among those of the same fault, from 0 on."""

    @property
    def survived(self) -> bool:
        """Whether there is no complaint."""
        return not self.complaints

    def __str__(self) -> str:
        if not self.survived:
            return f"{self.fault}: {'; '.join(self.complaints)}"
        return f"{self.fault}: survived, at the goal {self.recovery:.2f} s after it"


def row(fault: str, outcomes: list[Outcome]) -> dict[str, Any]:
    """Return what the file and the tables hold of all trials of a fault."""
    recoveries = [outcome.recovery for outcome in outcomes if outcome.recovery >= 0.0]
    return {
        "fault": fault,
        "tried": len(outcomes),
        "survived": sum(outcome.survived for outcome in outcomes),
        "recover_s": round(max(recoveries), 3) if recoveries else None,
        "recover_median_s": round(statistics.median(recoveries), 3) if recoveries else None,
        "worst_speed": max(outcome.worst_speed for outcome in outcomes),
        "worst_slew": max(outcome.worst_slew for outcome in outcomes),
    }


def rows(outcomes: Iterable[Outcome]) -> list[dict[str, Any]]:
    """Return a row for each fault, in order of their first trial."""
    found: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        found.setdefault(outcome.fault, []).append(outcome)
    return [row(fault, tried) for fault, tried in found.items()]


def table(outcomes: Iterable[Outcome]) -> Iterator[str]:
    """Yield the lines of a table in Markdown: the faults, then all by their number at once."""
    outcomes = list(outcomes)
    at_once = [
        row(f"all, {number} at once", several) for number in (1, 2, 3)
        if (several := [o for o in outcomes if o.fault.count(" + ") == number - 1])
    ]
    yield ("| fault | survived | recovery, median [s] | longest [s] | speed [rad/s] "
           "| slew [rad/s²] |")
    yield "|---" * 6 + "|"
    for one in rows(outcomes) + at_once:
        median, longest = (
            "-" if seconds is None else f"{seconds:.1f}"
            for seconds in (one["recover_median_s"], one["recover_s"])
        )
        yield (f"| {one['fault']} | {one['survived']} of {one['tried']} | {median} | {longest} "
               f"| {one['worst_speed']:.2f} | {one['worst_slew']:.2f} |")


def write_json(path: Path, outcomes: Iterable[Outcome], campaign: Mapping[str, Any]) -> None:
    """Write the settings in common, the table of faults, and all trials to a file, at once."""
    outcomes = list(outcomes)
    trials = [
        asdict(o) | {"recovery": None if math.isnan(o.recovery) else o.recovery} for o in outcomes
    ]
    content = {"campaign": dict(campaign), "faults": rows(outcomes), "trials": trials}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def read_outcomes(path: Path, campaign: Mapping[str, Any]) -> list[Outcome]:
    """Return the trials in a file of the same campaign; none if there is no file."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        given = content["campaign"]
        trials = [
            Outcome(**{
                **trial, "complaints": tuple(trial["complaints"]),
                "recovery": math.nan if trial["recovery"] is None else trial["recovery"],
            })
            for trial in content["trials"]
        ]
    except FileNotFoundError:
        return []
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SphereNmpcError(f"{path}: cannot be continued: {error!r}") from None
    if given != dict(campaign):
        raise SphereNmpcError(
            f"{path}: given trials of the campaign {shown(given)}, expected {dict(campaign)}"
        )
    return trials

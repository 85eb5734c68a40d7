# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Outcomes of trials, and the table and the JSON file made of them."""

import json
import math
import statistics
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.foreign_text import shown
from sphere_sim.output.atomic_write import write_atomically


class OutcomesUnreadableError(SphereNmpcError):
    """A file does not hold outcomes of the campaign that is to be continued."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of one trial.

    Attributes
    ----------
    fault : str
        Name of the fault, or of several.
    recovery : float
        Time from the end of the fault to settling at the goal [s, simulated]; nan if it was not
        reached.
    worst_speed : float
        Largest rotor speed, commanded or measured [rad/s].
    worst_slew : float
        Largest rotor acceleration, commanded or measured [rad/s^2].
    complaints : tuple of str
        Reasons why it does not count as survived; empty if it does.
    repetition : int
        Number of the trial among those of the same fault, from 0 on.
    """

    fault: str
    recovery: float = math.nan
    worst_speed: float = 0.0
    worst_slew: float = 0.0
    complaints: tuple[str, ...] = ()
    repetition: int = 0

    @property
    def survived(self) -> bool:
        """Whether there is no complaint."""
        return not self.complaints

    def as_json(self) -> dict[str, Any]:
        """Return the outcome as it is written to the file."""
        recovery = None if math.isnan(self.recovery) else self.recovery
        return asdict(self) | {"recovery": recovery}


@dataclass
class FaultRow:
    """All trials of one fault.

    Attributes
    ----------
    fault : str
        Its name.
    outcomes : list of Outcome
        One per trial.
    """

    fault: str
    outcomes: list[Outcome] = field(default_factory=list)

    @property
    def survived(self) -> int:
        """Number of trials that were survived."""
        return sum(outcome.survived for outcome in self.outcomes)

    @property
    def recovery(self) -> float:
        """The longest recovery [s]; nan if the goal was never reached."""
        return max(self._recoveries, default=math.nan)

    @property
    def median_recovery(self) -> float:
        """The median of the recoveries [s]; nan if the goal was never reached."""
        return statistics.median(self._recoveries) if self._recoveries else math.nan

    @property
    def _recoveries(self) -> list[float]:
        return [outcome.recovery for outcome in self.outcomes if outcome.recovery >= 0.0]

    @property
    def complaints(self) -> list[str]:
        """All different complaints."""
        return list(dict.fromkeys(c for outcome in self.outcomes for c in outcome.complaints))

    def as_json(self) -> dict[str, Any]:
        """Return the row as it is written to the file."""
        return {
            "fault": self.fault,
            "tried": len(self.outcomes),
            "survived": self.survived,
            "recover_s": _rounded(self.recovery),
            "recover_median_s": _rounded(self.median_recovery),
            "worst_speed": max(outcome.worst_speed for outcome in self.outcomes),
            "worst_slew": max(outcome.worst_slew for outcome in self.outcomes),
        }


def rows(outcomes: Iterable[Outcome]) -> list[FaultRow]:
    """Return the outcomes by fault, in order of their first trial."""
    found: dict[str, FaultRow] = {}
    for outcome in outcomes:
        found.setdefault(outcome.fault, FaultRow(outcome.fault)).outcomes.append(outcome)
    return list(found.values())


def write_json(path: Path, outcomes: Iterable[Outcome], campaign: Mapping[str, Any]) -> None:
    """Write the table of faults, and all trials, to a file, which is replaced at once.

    Parameters
    ----------
    path : Path
        The file.
    outcomes : iterable of Outcome
        The trials so far.
    campaign : mapping
        Settings that all of them have in common.
    """
    outcomes = list(outcomes)
    content = {
        "campaign": dict(campaign),
        "faults": [row.as_json() for row in rows(outcomes)],
        "trials": [outcome.as_json() for outcome in outcomes],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def read_outcomes(path: Path, campaign: Mapping[str, Any]) -> list[Outcome]:
    """Return the trials in a file of the same campaign; none if there is no file.

    Raises
    ------
    OutcomesUnreadableError
        If it holds something else, or the trials of another campaign.
    """
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
        raise OutcomesUnreadableError(f"{path}: cannot be continued: {error!r}") from None
    if given != dict(campaign):
        raise OutcomesUnreadableError(
            f"{path}: given trials of the campaign {shown(given)}, expected {dict(campaign)}"
        )
    return trials


def _rounded(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 3)

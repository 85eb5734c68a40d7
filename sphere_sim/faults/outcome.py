# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Outcomes of trials, and the table and the JSON file made of them."""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


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
    """

    fault: str
    recovery: float = math.nan
    worst_speed: float = 0.0
    worst_slew: float = 0.0
    complaints: tuple[str, ...] = ()

    @property
    def survived(self) -> bool:
        """Whether there is no complaint."""
        return not self.complaints


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
        return max((o.recovery for o in self.outcomes if o.recovery >= 0.0), default=math.nan)

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
            "recover_s": None if math.isnan(self.recovery) else round(self.recovery, 3),
            "worst_speed": max(outcome.worst_speed for outcome in self.outcomes),
            "worst_slew": max(outcome.worst_slew for outcome in self.outcomes),
        }


def rows(outcomes: Iterable[Outcome]) -> list[FaultRow]:
    """Return the outcomes by fault, in order of their first trial."""
    found: dict[str, FaultRow] = {}
    for outcome in outcomes:
        found.setdefault(outcome.fault, FaultRow(outcome.fault)).outcomes.append(outcome)
    return list(found.values())


def write_json(path: Path, table: Iterable[FaultRow]) -> None:
    """Write the table to a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"faults": [row.as_json() for row in table]}, indent=2, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")

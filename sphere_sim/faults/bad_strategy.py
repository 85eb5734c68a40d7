# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A strategy that fails in the ways in which a solver can, on demand."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import SearchingStrategy, Situation, Strategy
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.worker.contract import Worker

_LATENESS = 0.4
"""Additional wall time of a late plan [s]."""
_WILD = 1e6
"""Speed of a wild plan [rad/s]."""


class BadStrategy:
    """Wrapper of a strategy that fails while a file names a failure mode.

    Parameters
    ----------
    inner : Strategy
        The strategy that makes the plans.
    mode_file : Path
        A file with one word: raise, nan, wild, nothing or late; missing or empty for no failure.
    """

    def __init__(self, inner: Strategy, mode_file: Path) -> None:
        self._inner = inner
        self._mode_file = mode_file

    def plan(self, situation: Situation) -> Plan:
        """Return a plan, or fail in the mode that the file names."""
        mode = self._mode_file.read_text().strip() if self._mode_file.exists() else ""
        if mode == "raise":
            raise RuntimeError("the solver was made to fail")
        if mode == "nothing":
            return None  # type: ignore[return-value]
        if mode == "late":
            time.sleep(_LATENESS)
        plan = self._inner.plan(situation)
        if mode == "nan":
            return replace(plan, states=np.full_like(plan.states, np.nan))
        if mode == "wild":
            knots = situation.time + np.array([0.0, 1e-6, 0.1, 0.2, 5.0])
            signs = np.array([[1.0, -1.0]] * 5) * np.array([[1, -1, 1, -1, 1]]).T
            return replace(plan, hold=FirstOrderHold(knots, _WILD * signs))
        return plan

    def change(self, settings: ControllerSettings) -> None:
        """Pass the settings on."""
        self._inner.change(settings)

    def reset(self) -> None:
        """Reset the inner strategy."""
        self._inner.reset()


class BadSearchingStrategy(BadStrategy):
    """The same for a strategy that can search beside the control loop.

    Parameters
    ----------
    inner : Strategy and SearchingStrategy
        The strategy that makes the plans.
    mode_file : Path
        See `BadStrategy`.
    """

    _inner: Any  # both a Strategy and a SearchingStrategy

    def search_beside(self, worker: Worker) -> None:
        """Pass the worker on."""
        self._inner.search_beside(worker)

    @property
    def searches(self) -> bool:
        """Whether the inner strategy searches while the robot waits."""
        return bool(self._inner.searches)

    def is_due(self, now: float) -> bool:
        """Return whether the inner strategy has a plan that begins at `now` [s] or before."""
        return bool(self._inner.is_due(now))


def failing_on_demand(inner: Strategy, mode_file: Path) -> BadStrategy:
    """Return a wrapper of a strategy that searches beside the control loop if the strategy can."""
    is_searching = isinstance(inner, SearchingStrategy)
    return (BadSearchingStrategy if is_searching else BadStrategy)(inner, mode_file)

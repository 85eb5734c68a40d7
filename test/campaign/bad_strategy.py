# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller node with strategies that fail on demand in the ways in which a solver can."""

import time
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.settings import STRATEGIES

_LATENESS = 0.4
"""Additional wall time of a late plan [s]."""
_WILD = 1e6
"""Speed of a wild plan [rad/s]."""


def failing(kind: type, mode_file: Path) -> type:
    """Return a subclass of a strategy that fails while a file names a failure mode.

    The mode is raise, nan, wild, nothing or late; the file is missing or empty for no failure.
    """

    class FailingStrategy(kind):
        def plan(self, situation: Any) -> Any:
            """Return a plan, or fail in the mode that the file names."""
            mode = mode_file.read_text().strip() if mode_file.exists() else ""
            if mode == "raise":
                raise RuntimeError("the solver was made to fail")
            if mode == "nothing":
                return None
            if mode == "late":
                time.sleep(_LATENESS)
            plan = super().plan(situation)
            if mode == "nan":
                return replace(plan, states=np.full_like(plan.states, np.nan))
            if mode == "wild":
                knots = situation.time + np.array([0.0, 1e-6, 0.1, 0.2, 5.0])
                signs = np.outer([1.0, -1.0, 1.0, -1.0, 1.0], [1.0, -1.0])
                return replace(plan, hold=FirstOrderHold(knots, _WILD * signs))
            return plan

    return FailingStrategy


def main(arguments: Sequence[str]) -> int:
    """Run the controller node, given the file of the mode, and its own arguments."""
    from sphere_nmpc.ros.controller.node import main as run_controller

    mode_file, *rest = arguments
    # In the table of strategies, as any other strategy is.
    for name, entry in STRATEGIES.items():
        module, _, own = entry.path.partition(":")
        globals()[name] = failing(getattr(import_module(module), own), Path(mode_file))
        STRATEGIES[name] = replace(entry, path=f"{__name__}:{name}")
    return run_controller(rest)

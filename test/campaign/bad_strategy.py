# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller node with strategies that fail on demand, as solvers and foreign code can.

Those of the package fail while a file says how; beside them the table has one for each way, which
always fails in it, as if a package had brought it.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn, cast

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.settings import STRATEGIES
from sphere_nmpc.strategy.plan import Plan

_LATENESS = 0.4
"""Additional wall time of a late plan [s]."""
_BLOCKED = 10.0
"""Wall time for which a strategy does not return [s]."""
_WILD = 1e6
"""Speed of a wild plan [rad/s]."""
_KNOTS = 1_000_000
"""Knots of a plan that nobody can follow."""


class OtherPlan(Plan):
    """Plan whose class is not that of the package."""


def _raise(error: BaseException) -> NoReturn:
    raise error


def _after(duration: float, plan: Plan) -> Plan:
    time.sleep(duration)
    return plan


def _wild(situation: Any, plan: Plan) -> Plan:
    knots = situation.time + np.array([0.0, 1e-6, 0.1, 0.2, 5.0])
    signs = np.outer([1.0, -1.0, 1.0, -1.0, 1.0], [1.0, -1.0])
    return replace(plan, hold=FirstOrderHold(knots, _WILD * signs))


def _long(situation: Any, plan: Plan) -> Plan:
    times = situation.time + np.linspace(0.0, 5.0, _KNOTS)
    return replace(plan, hold=FirstOrderHold(times, np.zeros((_KNOTS, 2))))


def _written(situation: Any, plan: Plan) -> Plan:
    situation.state[:] = np.nan
    return plan


def _claimed(situation: Any, plan: Plan) -> Plan:
    """Return a plan that rolls straight on, whatever is there, and says that it keeps clear."""
    times = situation.time + np.array([0.0, 1.0, 3.0])
    speeds = np.vstack((situation.speeds, np.full((2, 2), 50.0)))
    states = np.tile(situation.state, (3, 1))
    return Plan(FirstOrderHold(times, speeds), states, clearance=1.0)


PLANS: dict[str, Callable[[Any, Plan], Any]] = {
    "raise": lambda now, plan: _raise(RuntimeError("the solver was made to fail")),
    "nothing": lambda now, plan: None,
    "late": lambda now, plan: _after(_LATENESS, plan),
    "nan": lambda now, plan: replace(plan, states=np.full_like(plan.states, np.nan)),
    "wild": _wild,
    "exit": lambda now, plan: sys.exit(3),
    "interrupt": lambda now, plan: _raise(KeyboardInterrupt()),
    "deep": lambda now, plan: _raise(RecursionError("too deep")),
    "memory": lambda now, plan: _raise(MemoryError()),
    "block": lambda now, plan: _after(_BLOCKED, plan),
    "knots": _long,
    "write": _written,
    "claim": _claimed,
    "other": lambda now, plan: OtherPlan(**vars(plan)),
    "endless": lambda now, plan: replace(plan, states=cast(Any, iter(int, 1))),
}
"""What becomes of a plan in each way of failing."""
FOREIGN = (*PLANS, "import", "made", "reset")
"""Ways of failing of the strategies that are beside those of the package: ``foreign_exit``."""


def failing(kind: type, mode: Callable[[], str]) -> type:
    """Return a subclass of a strategy that fails in the ways that `mode` returns, one at a time.

    It is empty for no failure.
    """

    class FailingStrategy(kind):
        def __init__(self, *arguments: Any) -> None:
            if mode() == "made":
                sys.exit(3)
            super().__init__(*arguments)

        def plan(self, situation: Any) -> Any:
            """Return a plan, or fail."""
            plan, change = super().plan(situation), PLANS.get(mode())
            return plan if change is None else change(situation, plan)

        def reset(self) -> None:
            """Forget all, or fail."""
            if mode() == "reset":
                sys.exit(3)
            super().reset()

    return FailingStrategy


def __getattr__(name: str) -> NoReturn:
    """Fail as an import can: by ending the process."""
    if name == "foreign_import":
        sys.exit(3)
    raise AttributeError(name)


def main(arguments: Sequence[str]) -> int:
    """Run the controller node, given the file of the mode, and its own arguments."""
    from sphere_nmpc.ros.controller.node import main as run_controller

    mode_file, rest = Path(arguments[0]), arguments[1:]

    def of_file() -> str:
        return mode_file.read_text().strip() if mode_file.exists() else ""

    # In the table of strategies, as any other strategy is.
    for name, entry in list(STRATEGIES.items()):
        module, _, own = entry.path.partition(":")
        globals()[name] = failing(getattr(import_module(module), own), of_file)
        STRATEGIES[name] = replace(entry, path=f"{__name__}:{name}")
    from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy

    for way in FOREIGN:
        name = f"foreign_{way}"
        STRATEGIES[name] = replace(STRATEGIES["time_optimal"], path=f"{__name__}:{name}")
        if way != "import":
            globals()[name] = failing(TimeOptimalStrategy, way.__str__)
    return run_controller(rest)

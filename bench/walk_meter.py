# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Recorder of the calls and records of instants, whose counts `walk.py` prints."""

import os
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, is_dataclass
from statistics import median_low
from types import FrameType
from typing import Any

import numpy as np

import sphere_nmpc
from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.sending import REACH
from sphere_nmpc.reporting.conditions import Kind

FOLLOWED, REPORTED, RESTING = "tick, followed", "tick, with a status", "tick, resting"
SOLVED, NEARLY = "tick, solved", "tick, solved near the end"
"""Solved ones differ by the stop that ends each command: a plan that ends earlier has it."""
_ROOT = os.path.dirname(sphere_nmpc.__file__) + os.sep
_INLINED = "<listcomp>", "<setcomp>", "<dictcomp>"
"""Frames that not every version of Python makes."""


@dataclass
class Walk:
    """Calls and records of one instant, and the time that it took [thousands of operations]."""

    calls: list[tuple[str, str]] = field(default_factory=list)
    records: set[str] = field(default_factory=set)
    time: float = 0.0


class Meter:
    """Recorder of walks, by calls or by time, each sorted by its kind when it is over.

    The walk to a first decision ends with it, within a callback.
    """

    def __init__(self, counts: bool) -> None:
        self._counts = counts
        self._now = Walk()
        self._cut_at: float | None = None
        self._cuts = False
        self._makers: set[FrameType] = set()
        self.decision: Any = None
        """The newest decision in the present walk."""
        self.walks: dict[str, list[Walk]] = defaultdict(list)
        self._unit = _operations()

    def of(self, controller: Controller) -> None:
        """Take note of the decisions of a node's controller."""
        def note(decision: Decision) -> None:
            self.decision = decision
            if self._cuts:
                sys.setprofile(None)
                self._cut_at = time.perf_counter()

        after(controller, "decide", note)

    def run(self, function: Callable[..., Any], *arguments: Any, cuts: bool = False) -> Any:
        """Call a function as part of the present walk, which ends at a decision with `cuts`."""
        self._cuts, self._cut_at = cuts, None
        if self._counts:
            threading.setprofile(self._record)
            sys.setprofile(self._record)
        self._makers.clear()
        began = time.perf_counter()
        try:
            return function(*arguments)
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
            self._now.time += ((self._cut_at or time.perf_counter()) - began) / self._unit

    def note(self, kind: str) -> None:
        """Count what there is of the present walk as one of this kind; it goes on."""
        self.walks[kind].append(deepcopy(self._now))

    def end(self, kind: str | None) -> None:
        """End the present walk, which is of this kind; None forgets it."""
        if kind == FOLLOWED and any(file == "ros/diagnostics.py" for file, _ in self._now.calls):
            kind = REPORTED
        if kind is not None:
            self.walks[kind].append(self._now)
            if len(self.walks[kind]) % 50 == 0:
                self._unit = _operations()
        self._now, self.decision = Walk(), None

    def end_tick(self) -> None:
        """End the walk of a sampling instant."""
        decision, kind = self.decision, None
        if decision is not None and decision.mode is Kind.AT_GOAL:
            kind = RESTING
        elif decision is not None and decision.mode is Kind.TRACKING:
            kind = SOLVED if decision.is_new else FOLLOWED
            hold = decision.plan.hold
            if kind == SOLVED and hold.end - hold.start < REACH:
                kind = NEARLY
        self.end(kind)

    def take(self, other: "Meter") -> None:
        """Append the present walk of another meter to that of this one."""
        self._now.calls += other._now.calls
        self._now.records |= other._now.records
        self._now.time += other._now.time

    def _record(self, frame: FrameType, event: str, argument: Any) -> None:
        """Count a call, and what a function makes: by `__init__`, or by `__new__` and returned."""
        code = frame.f_code
        if event == "call":
            if code.co_filename.startswith(_ROOT) and code.co_name not in _INLINED:
                name = getattr(code, "co_qualname", code.co_name)  # from Python 3.11 on
                self._now.calls.append((code.co_filename[len(_ROOT):], name))
            if code.co_name == "__init__":
                self._made(frame.f_locals.get(code.co_varnames[0]))
        elif event == "c_call":
            if getattr(argument, "__name__", "") == "__new__":
                self._makers.add(frame)
        elif event == "return" and frame in self._makers:
            self._makers.remove(frame)
            self._made(argument)

    def _made(self, value: Any) -> None:
        """Count a value if it is a record of the package."""
        made = type(value)
        is_record = is_dataclass(made) or (issubclass(made, tuple) and hasattr(made, "_fields"))
        if is_record and made.__module__.startswith(sphere_nmpc.__name__):
            self._now.records.add(made.__name__)


def _operations() -> float:
    """Return the time of a thousand additions of small arrays [s]."""
    one, other = np.arange(9.0), np.ones(9)
    took = []
    for _ in range(5):
        began = time.perf_counter()
        for _ in range(200):
            one + other
        took.append(5.0 * (time.perf_counter() - began))
    return min(took)  # what else the processor does is none of it


def after(owner: Any, name: str, then: Callable[[Any], object]) -> None:
    """Have a function called with each result of a method of an object."""
    method = getattr(owner, name)

    def call(*arguments: Any) -> Any:
        result = method(*arguments)
        then(result)
        return result

    setattr(owner, name, call)


def counts_of(walks: list[Walk]) -> list[int]:
    """Return the numbers of calls, functions, files and kinds of records of a typical instant.

    Of each function it has the median number of calls, and of records those of most instants.
    """
    calls = _medians([walk.calls for walk in walks])
    records = _medians([walk.records for walk in walks])
    return [sum(calls.values()), len(calls), len({file for file, _ in calls}), len(records)]


def _medians(walks: Sequence[Iterable[Any]]) -> dict[Any, int]:
    """Return what is in most of these walks, with the median of how often it is in one."""
    counts = [Counter(walk) for walk in walks]
    found = {one: median_low(count[one] for count in counts) for one in set().union(*counts)}
    return {one: number for one, number in found.items() if number}

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of documents, what several of them judge runs by, and runs in several processes."""

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from sphere_nmpc.model.state import Vector
from sphere_sim.evaluation.metrics import angle_errors, position_errors

NEAR, NEAR_ANGLE = 0.03, float(np.radians(3.0))
"""Errors below which a sphere with noisy poses is at its goal [m, rad]."""


def row(*cells: object) -> str:
    """Return a row of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"


def header(*cells: str) -> str:
    """Return the first two lines of a Markdown table."""
    return f"{row(*cells)}\n{'|---' * len(cells)}|"


def median_and_worst(values: Sequence[float] | Vector, how: str) -> str:
    """Return the median and, in brackets, the largest value; a dash where there is none."""
    known = np.asarray(values, dtype=float)
    return f"{np.median(known):{how}} ({known.max():{how}})" if known.size else "-"


def errors_in_words(position: Vector, angle: Vector) -> str:
    """Return median and largest errors, given in m and rad, in cm and degrees."""
    p, a = 100.0 * position, np.degrees(angle)
    return f"{np.median(p):.1f} cm, {np.median(a):.1f}° ({np.max(p):.1f} cm, {np.max(a):.1f}°)"


def last_arrival(states: Vector, goal: Vector) -> int:
    """Return the index from which on states, (n, 6), are near the goal, n if the last is not."""
    away = (position_errors(states, goal) > NEAR) | (angle_errors(states, goal) > NEAR_ANGLE)
    far = np.flatnonzero(away)
    return int(far[-1]) + 1 if far.size else 0


def in_processes(
    call: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], jobs: int | None = None
) -> list[Any]:
    """Return the results of calls with the arguments of each task, made in new processes.

    They are no copies of this one, whose libraries (DDS, an engine, a browser) may be half way
    through something in another thread.
    """
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        results = pool.map(call, *zip(*tasks, strict=True))
        console = Console(stderr=True)
        return list(track(results, "runs", len(tasks), transient=True, console=console))

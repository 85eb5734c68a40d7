# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A recorded run as a source of frames, with a time that can be set."""

import time
from collections.abc import Sequence

import numpy as np

from sphere_nmpc.model.integrator import integrate
from sphere_nmpc.model.state import Vector
from sphere_sim.recording.run import Run
from sphere_sim.viewer.frame import Frame, Offers, Pause, Request, Reset, Seek, SetSpeed

_REACH = 60.0
"""How far back lines are drawn after a jump [s]."""
_STEP = 0.05
"""Longest time between two frames that lines go through [s]."""


class Replay:
    """Plays a run, in a loop of its own time.

    Parameters
    ----------
    run : Run
        The run.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._goals = run.goals_in_force
        self._duration = float(run.times[-1])
        self._constants = run.robot.lumped.as_array()
        self._time = 0.0
        self._speed = 1.0
        self._paused = False
        self._jumped = True
        self._wall = time.monotonic()
        self._plan_index = -1
        self._plan = np.empty((0, 6))

    def frames(self) -> Sequence[Frame]:
        """Return the frames since the last call; after a jump, those that lead there."""
        wall = time.monotonic()
        elapsed, self._wall = wall - self._wall, wall
        start = self._time
        if not self._paused:
            self._time = min(self._time + elapsed * self._speed, self._duration)
            # At the end it waits to be started anew.
            self._paused = self._time >= self._duration
        fresh, self._jumped = self._jumped, False
        if fresh:
            start = max(0.0, self._time - _REACH)
        number = max(1, int(np.ceil((self._time - start) / _STEP)))
        times = np.linspace(start, self._time, number + 1)[(0 if fresh else 1) :]
        frames = [self._frame(float(t), fresh and i == 0) for i, t in enumerate(times[:-1])]
        return [*frames, self._frame(float(times[-1]), fresh and len(times) == 1, newest=True)]

    def handle(self, request: Request) -> str:
        """Go to a time, stop and go on, or change the speed."""
        if isinstance(request, Pause):
            if not request.paused and self._time >= self._duration:
                self._time, self._jumped = 0.0, True
            self._paused = request.paused
        elif isinstance(request, SetSpeed):
            self._speed = max(0.0, request.factor)
        elif isinstance(request, Seek):
            self._time, self._jumped = min(max(0.0, request.time), self._duration), True
        elif isinstance(request, Reset):
            self._time, self._jumped = 0.0, True
        else:
            return "a recording cannot be changed"
        return ""

    def _frame(self, moment: float, fresh: bool, newest: bool = False) -> Frame:
        run = self._run
        at = int(np.searchsorted(run.times, moment, side="right")) - 1
        joint = int(np.searchsorted(run.joint_times, moment, side="right")) - 1
        solve = int(np.searchsorted(run.solves.times, moment, side="right")) - 1
        to_go = self._to_go(solve)
        goal = self._goals[at]
        unknown = np.full(2, np.nan)
        return Frame(
            time=moment,
            state=run.states[at],
            radius=run.robot.shell_radius,
            rotor_speeds=run.rotor_speeds[joint] if joint >= 0 else unknown,
            rotor_torques=run.rotor_torques[joint] if joint >= 0 else unknown,
            goal=goal if np.all(np.isfinite(goal)) else None,
            plan=self._plan_at(moment) if newest else np.empty((0, 6)),
            solve_time=float(run.solves.durations[solve]) if solve >= 0 else float("nan"),
            cost=float(run.solves.costs[solve]) if solve >= 0 and np.isnan(to_go) else np.nan,
            to_go=to_go,
            mode=run.solves.statuses[solve] if solve >= 0 else "",
            fresh=fresh,
            offers=Offers(
                pause=True, reset=True, paused=self._paused, speed=self._speed,
                duration=self._duration,
            ),
        )

    def _to_go(self, solve: int) -> float:
        """Return in what time the plan of a solve arrives [s]; one that holds has."""
        solves = self._run.solves
        if solve < 0 or not solves.to_go.size:
            return float("nan")
        return 0.0 if solves.statuses[solve] == "holding" else float(solves.to_go[solve])

    def _plan_at(self, moment: float) -> Vector:
        """Return the plan in force as the model predicts it from the state where it begins."""
        plans = self._run.plans
        starts = [plan.start for plan in plans]
        index = int(np.searchsorted(starts, moment, side="right")) - 1
        if index == self._plan_index:
            return self._plan
        self._plan_index, self._plan = index, np.empty((0, 6))
        if index < 0:
            return self._plan
        hold = plans[index]
        at = max(0, int(np.searchsorted(self._run.times, hold.start, side="right")) - 1)
        states = [self._run.states[at]]
        for i, duration in enumerate(np.diff(hold.times)):
            ends = hold.speeds[i], hold.speeds[i + 1]
            states.append(integrate(states[-1], *ends, float(duration), self._constants))
        self._plan = np.array(states)
        return self._plan

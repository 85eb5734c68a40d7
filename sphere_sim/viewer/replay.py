# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Recorded run as a source of frames, with pause, speed and seek."""

import time
from collections.abc import Sequence

import numpy as np

from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.model.state import POSE, Vector, are_states
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.recording.message_fields import HOLDING
from sphere_sim.recording.run import Run, newest
from sphere_sim.viewer.source import (
    Capabilities,
    Frame,
    Pause,
    Request,
    Reset,
    Seek,
    SetSpeed,
)

_LINE_DURATION = 60.0
"""Length of the lines that are drawn after a seek [s]."""
_STEP = 0.05
"""Longest time between two frames that lines pass through [s]."""
_LONGEST_PLAN = 100.0
"""Part of a plan that is drawn [s]: each step of it is integrated."""


class Replay:
    """`Source` of the frames of a run; it stops at the end."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._duration = float(run.times[-1])
        self._constants = run.robot.lumped.as_array()
        self._time = 0.0
        self._speed = 1.0
        self._paused = False
        self._sought = True
        self._wall = time.monotonic()
        self._plan_index = -1
        self._plan = np.empty((0, 6))

    def frames(self) -> Sequence[Frame]:
        """Return the frames since the last call; after a seek, those before the new time."""
        wall = time.monotonic()
        elapsed, self._wall = wall - self._wall, wall
        start = self._time
        if not self._paused:
            self._time = min(self._time + elapsed * self._speed, self._duration)
            self._paused = self._time >= self._duration
        restarted, self._sought = self._sought, False
        if restarted:
            start = max(0.0, self._time - _LINE_DURATION)
        number = max(1, int(np.ceil((self._time - start) / _STEP)))
        times = np.linspace(start, self._time, number + 1)[(0 if restarted else 1) :]
        frames = [self._frame(float(t), restarted and i == 0) for i, t in enumerate(times[:-1])]
        final = self._frame(float(times[-1]), restarted and len(times) == 1, last=True)
        return [*frames, final]

    def handle(self, request: Request) -> str:
        """Pause, resume, seek, or change the speed."""
        if isinstance(request, Pause):
            if not request.paused and self._time >= self._duration:
                self._seek(0.0)
            self._paused = request.paused
        elif isinstance(request, SetSpeed):
            self._speed = max(0.0, request.factor)
        elif isinstance(request, Seek):
            self._seek(min(max(0.0, request.time), self._duration))
        elif isinstance(request, Reset):
            self._seek(0.0)
        else:
            return "a recording cannot be changed"
        return ""

    def _seek(self, moment: float) -> None:
        self._time, self._sought = moment, True

    def _frame(self, moment: float, restarted: bool, last: bool = False) -> Frame:
        run = self._run
        at, joint = newest(run.times, moment), newest(run.joint_times, moment)
        solve = newest(run.solves.times, moment)
        to_go = self._to_go(solve)
        unknown = np.full(2, np.nan)
        estimate, estimate_error = run.estimates.at(moment)
        return Frame(
            time=moment,
            state=run.states[at],
            radius=run.robot.shell_radius,
            robot=run.robot,
            rotor_speeds=run.rotor_speeds[joint] if joint >= 0 else unknown,
            rotor_torques=run.rotor_torques[joint] if joint >= 0 else unknown,
            goal=run.goal_at(moment),
            estimate=estimate,
            estimate_error=estimate_error,
            floor=run.floors.at(moment),
            clearance=run.floors.clearance_at(moment),
            plan=self._plan_at(moment) if last else np.empty((0, 6)),
            solve_time=float(run.solves.durations[solve]) if solve >= 0 else float("nan"),
            cost=float(run.solves.costs[solve]) if solve >= 0 and np.isnan(to_go) else np.nan,
            to_go=to_go,
            progress=self._progress(moment, solve, to_go),
            momentum=run.momentum.at(moment),
            mode=run.solves.statuses[solve] if solve >= 0 else "",
            setup=run.setup,
            restarted=restarted,
            capabilities=Capabilities(
                pause=True, reset=True, paused=self._paused, speed=self._speed,
                duration=self._duration,
            ),
        )

    def _to_go(self, solve: int) -> float:
        """Return the time until the plan of a solve reaches the goal [s]; 0 if it holds there."""
        solves = self._run.solves
        if solve < 0:
            return float("nan")
        return 0.0 if solves.statuses[solve] == HOLDING else float(solves.to_go[solve])

    def _progress(self, moment: float, solve: int, to_go: float) -> GoalReport:
        """Return what is left of the way by the plan of a solve."""
        since = moment - float(self._run.solves.times[solve]) if solve >= 0 else 0.0
        return GoalReport(time_left=float(np.maximum(to_go - since, 0.0)))

    def _plan_at(self, moment: float) -> Vector:
        """Return the predicted states (n, 6) of the plan in force at its knots.

        They begin at the pose that the controller had at its start; empty before the first plan.
        """
        plans = self._run.plans
        index = newest(np.array([plan.start for plan in plans]), moment)
        if index == self._plan_index:
            return self._plan
        self._plan_index, self._plan = index, np.empty((0, 6))
        if index < 0:
            return self._plan
        hold = plans[index]
        times = hold.times[hold.times < hold.start + _LONGEST_PLAN]
        run = self._run
        momentum = np.nan_to_num(run.momentum.at(hold.start)) / run.robot.rotor_axial_inertia
        estimate, _ = run.estimates.at(hold.start)
        pose = run.states[max(0, newest(run.times, hold.start))] if estimate is None else estimate
        plan = roll_out(
            np.concatenate((pose, momentum)), hold.speeds[: times.size], np.diff(times),
            self._constants, disturbance=run.momentum.disturbance_at(hold.start),
        )[:, POSE]
        self._plan = plan[np.logical_and.accumulate(are_states(plan))]
        return self._plan

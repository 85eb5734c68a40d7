# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Recorded run as a source of frames, with pause, speed and seek."""

import math
import time
from collections.abc import Sequence

import numpy as np

from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.model.disturbance import UNDISTURBED
from sphere_nmpc.model.state import POSE, Vector, are_states
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.recording.message_fields import NO_SOLVE
from sphere_sim.recording.run import Run
from sphere_sim.viewer.source import (
    Capabilities,
    Frame,
    Pause,
    Request,
    Reset,
    Seek,
    SetSpeed,
    values_of_solve,
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
        run, unknown = self._run, np.full(2, np.nan)
        solve = run.solves.at(moment, NO_SOLVE)
        values = values_of_solve(solve)
        # What is left of the way by the plan of the solve.
        index = run.solves.newest(moment)
        since = moment - float(run.solves.times[index]) if index >= 0 else 0.0
        left = float(np.maximum(values["to_go"] - since, 0.0))
        return Frame(
            time=moment,
            state=run.poses.at(moment),
            radius=run.robot.shell_radius,
            robot=run.robot,
            rotor_speeds=run.rotor_speeds.at(moment, unknown),
            rotor_torques=run.rotor_torques.at(moment, unknown),
            goal=run.goals.at(moment),
            estimate=run.estimates.at(moment),
            estimate_error=run.estimate_errors.at(moment, unknown),
            floor=run.floors.at(moment),
            clearance=run.planned_clearances.at(moment, math.nan),
            plan=self._plan_at(moment) if last else np.empty((0, 6)),
            progress=GoalReport(time_left=left),
            momentum=run.momentum.at(moment, np.full(3, np.nan)),
            mode=solve.plan,
            setup=run.setup,
            restarted=restarted,
            capabilities=Capabilities(
                pause=True, reset=True, paused=self._paused, speed=self._speed,
                duration=self._duration,
            ),
            **values,
        )

    def _plan_at(self, moment: float) -> Vector:
        """Return the predicted states (n, 6) of the plan in force at its knots.

        They begin at the pose that the controller had at its start; empty before the first plan.
        """
        run = self._run
        index = run.plans.newest(moment)
        if index == self._plan_index:
            return self._plan
        self._plan_index, self._plan = index, np.empty((0, 6))
        if index < 0:
            return self._plan
        hold = run.plans.values[index]
        times = hold.times[hold.times < hold.start + _LONGEST_PLAN]
        momentum = run.momentum.at(hold.start, np.zeros(3)) / run.robot.rotor_axial_inertia
        pose = run.estimates.at(hold.start, run.poses.at(hold.start, run.states[0]))
        plan = roll_out(
            np.concatenate((pose, momentum)), hold.speeds[: times.size], np.diff(times),
            self._constants, disturbance=run.disturbances.at(hold.start, UNDISTURBED),
        )[:, POSE]
        self._plan = plan[np.logical_and.accumulate(are_states(plan))]
        return self._plan

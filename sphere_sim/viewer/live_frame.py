# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Newest values of a live robot, updated by its messages; arrival times [s; steady clock]."""

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.rotation import nearer_sign
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_sim.evaluation.metrics import estimate_errors
from sphere_sim.evaluation.series import Series
from sphere_sim.recording.message_fields import (
    CLEARANCE,
    known,
    number,
    reported_momentum,
    reported_orientation,
    reported_solve,
)
from sphere_sim.viewer.source import Frame, radius_at, values_of_solve

POSE_TIMEOUT = 0.5
"""Age from which on a pose is missed [s]; a paused simulator repeats its pose at 5 Hz."""
CONTROLLER_TIMEOUT = 0.8
"""Age from which on the controller is missed [s]; it always publishes diagnostics at 2 Hz."""
_PAUSE_TIMEOUT = 0.5
"""Time without a newer stamp after which the robot's clock counts as paused [s]."""
_MAX_SPEED = 20.0
"""Speed above which a change of position is a restart at another place [m/s]."""
_TRUE_POSES = 20
"""True poses that are kept for the estimate of their time."""
_POSITION_TOLERANCE = 0.1
"""Change of position that is never a restart [m]."""


class LiveFrame:
    """Frame that each message updates, with the alerts of missing messages and the controller."""

    def __init__(self, now: float) -> None:
        self.frame = Frame()
        """Newest values, without alerts."""
        self._stamp_changed_at = now
        self._pose_at: float | None = None
        self._true_at, self._estimate_stamp = -np.inf, 0.0
        self._true: deque[tuple[float, Vector]] = deque(maxlen=_TRUE_POSES)
        self.controller_at: float | None = None
        """Time at which the newest message of the controller arrived [s]."""
        self.refused = ""
        """Why the newest pose cannot be shown; empty otherwise."""
        self.floor_refused = ""
        """Why the newest floor cannot be shown; empty otherwise."""
        self._reported: tuple[str, ...] = ()
        self._has_goal = self._has_floor = True
        self._goal_message: tuple[str, Vector | None] = "", None
        self._demanded: tuple[str | None, Orientation] = None, Orientation.FULL

    @property
    def paused(self) -> bool:
        """Whether poses arrive, or arrived last, but all with the same stamp."""
        at = self._pose_at
        return at is not None and at - self._stamp_changed_at > _PAUSE_TIMEOUT

    def take(self, now: float, controllers: int) -> Frame:
        """Return the frame with its alerts, where the graph has so many controllers now [s].

        The next frame is not marked as restarted.
        """
        self._update_error()
        frame, self.frame = self.frame, replace(self.frame, restarted=False)
        alerts = (self._pose_alert(now), self._controller_alert(now, controllers))
        # One that has been cancelled is kept: a status may be older than a new goal.
        goal = frame.goal if self._has_goal else None
        floor = frame.floor if self._has_floor else None
        refused = f"floor refused: {self.floor_refused}" if self.floor_refused else ""
        reported = *filter(None, (*alerts, refused)), *self._reported
        return replace(frame, goal=goal, floor=floor, alerts=reported)

    def add_pose(self, stamp: float, state: Vector, height: float, now: float) -> None:
        """Update the state, shape (6,), by a pose that arrived now [s].

        Its stamp [s] is on the robot's clock; for its height [m] see `radius_at`.
        """
        self.refused, self._pose_at = "", now
        if now - self._true_at > POSE_TIMEOUT:
            self.update(estimate=None)
            self._show_pose(stamp, state, height, now)
            return
        self._estimate_stamp = stamp
        self.update(estimate=state)

    def add_true_pose(self, stamp: float, state: Vector, height: float, now: float) -> None:
        """Update the state by a true pose, likewise; other poses are then estimates of it."""
        if self._true and stamp < self._true[-1][0]:
            self._true.clear()
        if self._true:
            state[QUATERNION] = nearer_sign(state[QUATERNION], self._true[-1][1][QUATERNION])
        self._true_at = now
        self._true.append((stamp, state))
        self._show_pose(stamp, state, height, now)

    def _update_error(self) -> None:
        """Update the error of the estimate, where there are true poses before and after it.

        Of an estimate and the true pose of its time either may arrive first.
        """
        if self.frame.estimate is not None:
            times, states = map(np.array, zip(*self._true, strict=True))
            estimate = Series(np.array([self._estimate_stamp]), self.frame.estimate[None])
            error = estimate_errors(estimate, Series(times, states))[0]
            if np.isfinite(error[0]):
                self.update(estimate_error=error)

    def _show_pose(self, stamp: float, state: Vector, height: float, now: float) -> None:
        last = self.frame
        if stamp != last.time:
            self._stamp_changed_at = now
        self.frame = replace(
            last, time=stamp, state=state, radius=radius_at(height),
            restarted=last.restarted or _is_restart(last, stamp, state),
        )

    def add_rotors(self, speeds: Vector, torques: Vector) -> None:
        """Update rotor speeds, shape (2,) [rad/s], and torques, shape (2,) [N m]."""
        self.update(rotor_speeds=np.array([*map(known, speeds)]),
                    rotor_torques=np.array([*map(known, torques)]))

    def update(self, **values: Any) -> None:
        """Update values of the frame by their names."""
        self.frame = replace(self.frame, **values)

    def add_goal(self, stamp: str, pose: Vector) -> None:
        """Update the goal in force by a message with this stamp and a pose, shape (6,)."""
        self._goal_message = stamp, pose
        self._update_goal()

    def _update_goal(self) -> None:
        """Show the newest goal once a status says what it demands, where the statuses do so."""
        named, orientation = self._demanded
        stamp, pose = self._goal_message
        if pose is not None and named in (None, stamp):
            self.update(goal=Goal(pose, orientation))

    def add_status(self, values: Mapping[str, str]) -> None:
        """Update the values of the newest solve from those of a status message."""
        try:
            progress = GoalReport.of(values)
        except InvalidInputError:  # of a controller of another version
            progress = GoalReport()
        given_up, missing = values.get("giving_up", ""), values.get("no_progress", "")
        # The reason for which there is no progress may be what is given up.
        given_up = "" if given_up in missing else f"the strategy gives up {given_up}"
        missing = f"no progress: {missing}" if missing else ""
        self._reported = tuple(filter(None, (given_up, missing)))
        self._has_goal = values.get("goal_stamp") != ""
        self._demanded = values.get("active_goal_stamp"), reported_orientation(values)
        self._update_goal()
        # One that is restarted without a floor publishes none.
        self._has_floor = CLEARANCE in values
        self.update(
            progress=progress,
            clearance=number(values, CLEARANCE),
            momentum=reported_momentum(values),
            strategy=values.get("strategy", ""),
            mode=values.get("mode", ""),
            **values_of_solve(reported_solve(values)),
        )

    def _pose_alert(self, now: float) -> str:
        if self.refused:
            return f"pose refused: {self.refused}"
        if self._pose_at is None:
            return "no pose yet"
        age = now - self._pose_at
        return f"no pose for {age:.1f} s" if age > POSE_TIMEOUT else ""

    def _controller_alert(self, now: float, controllers: int) -> str:
        if self.controller_at is None:
            return "no controller yet"
        age = now - self.controller_at
        if age <= CONTROLLER_TIMEOUT:
            # A node that ends normally leaves the graph immediately.
            return "" if controllers or age < POSE_TIMEOUT else "controller gone"
        return f"controller silent for {age:.1f} s"


def _is_restart(last: Frame, stamp: float, state: Vector) -> bool:
    """Return whether time went back, or the sphere moved faster than it can."""
    if last.state is None:
        return False
    elapsed = stamp - last.time
    distance = float(np.linalg.norm(state[POSITION] - last.state[POSITION]))
    return elapsed < 0.0 or distance > _MAX_SPEED * elapsed + _POSITION_TOLERANCE

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Judge of commands, rotors and contacts, and of the run to a goal; the reports of the nodes."""

import math
import time
from collections import deque
from contextlib import suppress
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hostile import RADIUS, ROBOT
from rcl_interfaces.msg import Log
from rclpy.node import Node

from sphere_nmpc.errors import InvalidInputError, InvalidValueError
from sphere_nmpc.floor.floor import exact_distance
from sphere_nmpc.floor.occupancy import Grid, InvalidMapError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros.cdr import (
    WORLD_FRAME,
    Numbers,
    Pose,
    Trajectory,
    clock_stamp,
    hold_and_stamp,
    read,
    rotor_speeds_and_stamp,
)
from sphere_nmpc.ros.floor_messages import map_of_message
from sphere_sim.evaluation.metrics import GoalRun

TOO_EARLY = "a command was sent too early"
_TOLERANCE = 1e-3
"""Relative excess up to which a limit does not count as violated."""
_CONTINUITY = 1e-3
"""Largest jump of the commanded speeds from one command to the next [rad/s]."""
_RESOLUTION = 2e-9
"""Largest error of a duration between two stamps that were rounded to nanoseconds [s]."""
_MOST_AHEAD = 0.5
"""Largest time from the true clock to the start of a command [s]."""
_LONGEST = 10.0
"""Longest duration of a command [s]: for so long the rotors turn after a controller was killed."""
_GRACE = NANOSECONDS
"""Wall time that a controller has to notice that the true clock went back [ns]."""
_LATE = 0.01
"""Delay of a command beyond which the drives have to catch up with it [s]."""
_AT_REST = 1e-3
"""Speed below which a rotor rests [rad/s]."""
STOPPING = 0.5
"""Way [m] that a stop takes at most: a sampling period and the ramp of the rotors at the largest
speed, 0.742 m/s, and what the controller and this judge learn late."""
_TOUCH = 5e-3
"""Distance [m] below which the sphere counts as in contact: walls of the plant stop it millimetres
before, and any plan keeps more."""
_NEARER = 1e-2
"""Decrease of the distance by which a new floor has come nearer to the sphere [m]."""


class LimitCheck:
    """Check of trajectories, rotor commands and joint states.

    The servos' speed error that the load causes changes by at most `servo_error` [rad/s], by which
    measured speeds may change more than commanded ones.
    """

    def __init__(self, servo_error: float = 0.0) -> None:
        self._servo_error = servo_error
        self.continuous = True
        """Whether a command has to start from the speeds in force."""
        self.restart()
        self.begin()

    def begin(self) -> None:
        """Reset the results, at the beginning of a trial."""
        self.worst_speed = 0.0
        """Largest speed, commanded or measured [rad/s]."""
        self.worst_slew = 0.0
        """Largest slew rate, commanded or measured [rad/s^2]."""
        self.broken: list[str] = []
        """The first violations, in words."""

    def restart(self) -> None:
        """Discard the previous command and speeds, as when simulated time restarts."""
        self._hold: FirstOrderHold | None = None
        self._left: FirstOrderHold | None = None
        self._measured: tuple[int, Vector] | None = None

    def complain(self, what: str) -> None:
        """Keep a violation, unless there are many."""
        if len(self.broken) < 20:
            self.broken.append(what)

    def sent(self, hold: FirstOrderHold) -> None:
        """Check a commanded hold by itself."""
        self.speed("rotor_trajectory", hold.speeds)
        if hold.times.size > 1:
            changes = np.abs(np.diff(hold.speeds, axis=0))
            durations = np.diff(hold.times)[:, None] + _RESOLUTION
            self._slew("rotor_trajectory", float(np.max(changes / durations)))

    def delivered(self, hold: FirstOrderHold, now: float = -np.inf) -> None:
        """Check a hold that reaches the drives by `now` [s] against the one that it replaces.

        After a hold that was late the rotors are still between the one that they left and that.
        A copy of the hold in force replaces nothing.
        """
        before, left = self._hold, self._left
        if before is not None and np.array_equal(hold.times, before.times) and \
                np.array_equal(hold.speeds, before.speeds):
            return
        self._hold, self._left = hold, before if now > hold.start + _LATE else None
        if before is None or hold.start < before.start or not self.continuous:
            return
        in_force = [one.at(hold.start) for one in (before, left) if one is not None]
        within = np.clip(hold.speeds[0], np.min(in_force, axis=0), np.max(in_force, axis=0))
        jump = float(np.max(np.abs(hold.speeds[0] - within)))
        if jump > _CONTINUITY + ROBOT.max_rotor_acceleration * _RESOLUTION:
            self.complain(f"rotor_trajectory starts {jump:.4g} rad/s away from the one in force "
                          f"at t = {hold.start:.3f} s")

    def joints(self, stamp: int, speeds: Vector) -> None:
        """Check the measured rotor speeds, shape (2,), at `stamp` [ns]."""
        self.speed("joint_states", speeds)
        before, self._measured = self._measured, (stamp, speeds)
        if before is not None and stamp > before[0]:
            duration = (stamp - before[0]) * 1e-9 + _RESOLUTION
            change = float(np.max(np.abs(speeds - before[1])))
            self._slew("joint_states", change / duration, self._servo_error / duration)

    def speed(self, topic: str, speeds: Vector) -> None:
        """Check rotor speeds of a topic [rad/s]."""
        if not np.all(np.isfinite(speeds)):
            self.complain(f"{topic} holds {np.asarray(speeds).tolist()}")
            return
        speed = float(np.max(np.abs(speeds), initial=0.0))
        self.worst_speed = max(self.worst_speed, speed)
        if speed > ROBOT.max_rotor_speed * (1.0 + _TOLERANCE):
            self.complain(f"{topic} has {speed:.6g} rad/s")

    def _slew(self, topic: str, slew: float, allowance: float = 0.0) -> None:
        self.worst_slew = max(self.worst_slew, slew)
        if slew > ROBOT.max_rotor_acceleration * (1.0 + _TOLERANCE) + allowance:
            self.complain(f"{topic} has {slew:.6g} rad/s^2")


class ContactCheck:
    """Check that the sphere rolls into nothing that is in force.

    Where something comes into force nearer than the way of a stop, or over the sphere, a contact
    cannot be prevented; there it must not roll on for longer than that way.
    """

    def __init__(self) -> None:
        self.grid: Grid | None = None
        """What is occupied on the floor in force; None if nothing is."""
        self.excused = False
        """Whether something has come into force too near to be avoided."""
        self.place: Vector | None = None
        """Newest place of the sphere; None where it is put elsewhere."""
        self._left = 0.0

    def floor(self, grid: Grid | None) -> None:
        """Take a floor that has come into force."""
        before, self.grid = self._distance(), grid
        now = self._distance()
        if now < RADIUS + STOPPING and now < before - _NEARER:
            self._left, self.excused = STOPPING, True

    def observe(self, place: Vector) -> str:
        """Return what is wrong about a place of the sphere, shape (2,) [m]; empty if nothing."""
        rolled = 0.0 if self.place is None else float(np.linalg.norm(place - self.place))
        self.place = place
        distance = self._distance()
        if distance >= RADIUS + STOPPING:
            self._left = 0.0
        if distance >= RADIUS + _TOUCH:
            return ""
        before, self._left = self._left, self._left - rolled
        if before < 0.0 or self._left >= 0.0:
            return ""  # once for each contact
        return (f"it rolled on in contact at {np.round(place, 3).tolist()} m, {distance:.3f} m "
                "from what is occupied")

    def _distance(self) -> float:
        if self.grid is None or self.place is None:
            return float("inf")
        return exact_distance(self.grid, self.place, 2.0 * (RADIUS + STOPPING))


class Judge:
    """Judge by the simulator's own messages, which nobody disturbs.

    All messages are given serialised, with the wall time of their publication [ns] and the shift
    of the robot's clock to the simulator's [ns], see `Relay`; for `servo_error` see `LimitCheck`.
    """

    def __init__(self, servo_error: float = 0.0) -> None:
        self.limits = LimitCheck(servo_error)
        self.contacts = ContactCheck()
        self.run: GoalRun | None = None
        """The run to the goal."""
        self.now = 0
        """Newest time of the simulator [ns]."""
        self.state: Vector | None = None
        """Newest state, shape (6,); None if it is none that can be."""
        self.pose_stamp = 0
        """Stamp of that state [ns]."""
        self.speeds: Vector = np.zeros(2)
        """Measured rotor speeds [rad/s]."""
        self.moving_until = 0.0
        """Time at which a rotor last turned, as `time` [s]."""
        self.goal: Vector | None = None
        """Goal that the controller confirmed last, shape (6,)."""
        self.lenient_until = 0.0
        """Wall time until which `is_lenient` holds [s; steady]."""
        self._before = self._spacing = 0
        self._true_times: deque[tuple[int, int]] = deque(maxlen=500)
        self._back_until = 0

    @property
    def time(self) -> float:
        """Simulated time of the newest pose, continued where a simulator is restarted [s]."""
        return (self._before + self.pose_stamp) / NANOSECONDS

    @property
    def turning(self) -> float:
        """Speed of the faster rotor [rad/s]."""
        return float(np.max(np.abs(self.speeds)))

    @property
    def is_lenient(self) -> bool:
        """Whether resets, pushes to anywhere and the system clock are allowed now."""
        return time.monotonic() < self.lenient_until

    def begin(self, goal: Vector) -> GoalRun:
        """Begin a trial and return its run to a goal, shape (6,)."""
        self.run = GoalRun(goal)
        self.limits.begin()
        self.contacts.excused = False
        return self.run

    def restarted(self) -> None:
        """Expect the time of a new simulator, which begins at zero."""
        self._before += self.pose_stamp
        self.pose_stamp = 0
        self.limits.restart()

    def clock(self, raw: bytes, wall: int, shift: int) -> None:
        """Take the time of the simulator."""
        self.now = clock_stamp(raw)
        shifted = self.now + shift
        if self._true_times and shifted < self._true_times[-1][1]:
            self._back_until = wall + _GRACE
        self._true_times.append((wall, shifted))

    def pose(self, raw: bytes, wall: int, shift: int) -> None:
        """Take a pose of the simulator, unless it comes late, from a slow sensor."""
        with suppress(InvalidInputError):  # sent in the fuzzing
            stamp = read(raw, Pose).stamp
            if stamp >= self.pose_stamp:
                self._newest_pose(raw, stamp)

    def _newest_pose(self, raw: bytes, stamp: int) -> None:
        self.pose_stamp, self._spacing, self.state = stamp, stamp - self.pose_stamp, None
        try:
            self.state = read(raw, Pose).in_frame(WORLD_FRAME)
        except InvalidValueError as error:
            if not self.is_lenient:  # otherwise it may have been pushed away too far
                self.limits.complain(f"the undisturbed pose is wrong: {error}")
            return
        if self.is_lenient:
            self.contacts.place = None
        elif touched := self.contacts.observe(self.state[POSITION]):
            self.limits.complain(touched)
        if self.run is not None:
            self.run.observe(self.time, self.state)

    def joints(self, raw: bytes, wall: int, shift: int) -> None:
        """Take joint states of the simulator."""
        speeds, stamp = rotor_speeds_and_stamp(raw)
        if speeds is None:
            self.limits.complain("joint_states without finite speeds")
            return
        self.speeds = speeds
        if self.is_lenient:
            self.limits.restart()
        self.limits.joints(stamp, speeds)
        if self.turning > _AT_REST:
            self.moving_until = (self._before + stamp) / NANOSECONDS

    def command(self, raw: bytes, wall: int, shift: int) -> None:
        """Take rotor speeds of a controller."""
        self.limits.speed("rotor_commands", read(raw, Numbers).numbers)

    def trajectory(self, raw: bytes, wall: int, shift: int) -> None:
        """Take a trajectory of a controller, of times on its shifted clock."""
        try:
            stamp = read(raw, Trajectory).stamp
            hold, _ = hold_and_stamp(raw, 0, stamp)  # relative to its stamp, hence exact
        except InvalidValueError as error:
            self.limits.complain(f"rotor_trajectory is wrong: {error}")
            return
        self.limits.sent(hold)
        if np.any(hold.speeds[-1] != 0.0):
            self.limits.complain(f"a command ends at {hold.speeds[-1].tolist()} rad/s")
        if hold.end > _LONGEST:
            self.limits.complain(f"a command lasts {hold.end:.3f} s")
        true = next((then for at, then in reversed(self._true_times) if at <= wall), None)
        if true is None or wall < self._back_until:
            return
        ahead = (stamp - true) / NANOSECONDS
        if self.is_lenient:
            ahead = min(ahead, (stamp - wall) / NANOSECONDS)
        if ahead > _MOST_AHEAD:
            self.limits.complain(f"{TOO_EARLY}: {ahead:.3f} s before its time")

    def delivered(self, raw: bytes) -> None:
        """Take a trajectory that reaches the drives, of times on the simulator's clock."""
        with suppress(InvalidValueError):  # reported when it was sent
            # Between two poses time is known no better than to their spacing.
            latest = (self.pose_stamp + self._spacing) / NANOSECONDS
            self.limits.delivered(hold_and_stamp(raw, 0)[0], latest)

    def floor(self, raw: bytes) -> None:
        """Take the floor that the controller has in force."""
        grid = None
        with suppress(InvalidInputError):  # sent in the fuzzing, not by the controller
            with suppress(InvalidMapError):  # of no cells
                grid = map_of_message(raw, "world")(1.0, False)
            self.contacts.floor(grid)

    def confirmed(self, raw: bytes) -> None:
        """Take the goal in force, as far as it can be read."""
        with suppress(InvalidValueError):
            self.goal = read(raw, Pose).in_frame(WORLD_FRAME)


class Reports:
    """What the nodes report: log lines, messages of diagnostics, counters that rose."""

    def __init__(self, node: Node) -> None:
        self.messages: list[str] = []
        """Reports so far; among the numbers that rose those of interest are counters."""
        self._counters: dict[str, float] = {}
        for kind, topic, take in (
            (DiagnosticArray, "/diagnostics", self._take_diagnostics),
            (DiagnosticStatus, "controller/status", self._take_status),
            (Log, "/rosout", self._take_log),
        ):
            node.create_subscription(kind, topic, take, 1000)

    def name(self, words: tuple[str, ...]) -> bool:
        """Return whether one of some words is in a report."""
        return any(word in line for line in self.messages for word in words)

    def _take_diagnostics(self, message: Any) -> None:
        for status in message.status:
            self._take_status(status)

    def _take_status(self, message: Any) -> None:
        if message.level != DiagnosticStatus.OK or message.message == "paused":
            self.messages.append(f"{message.name}: {message.message}")
        for pair in message.values:
            with suppress(ValueError):  # of texts
                value, place = float(pair.value), f"{message.name} {pair.key}"
                if value > self._counters.get(place, math.inf):
                    # The keys of the status have underscores, those of diagnostics have not.
                    self.messages.append(f"{pair.key.replace('_', ' ')} rose ({pair.key})")
                self._counters[place] = value

    def _take_log(self, message: Any) -> None:
        self.messages.append(f"{message.name}: {message.msg}")

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Reading of bags, of the recorder or of ``ros2 bag record``, as the arrays of a `Run`."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.errors import InvalidInputError, InvalidParameterError, cut, shown
from sphere_nmpc.floor.occupancy import Grid, InvalidMapError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE_SIZE, QUATERNION, Vector, are_states
from sphere_nmpc.quantities import LARGEST, NANOSECONDS, known, stamp_text
from sphere_nmpc.ros.cdr import JOINT_NAMES
from sphere_nmpc.ros.floor_messages import floor_of
from sphere_sim.evaluation.metrics import estimate_errors
from sphere_sim.evaluation.series import Series
from sphere_sim.output.files import printable
from sphere_sim.recording.bag_clock import BagClock, stand_still
from sphere_sim.recording.bag_files import BagError, storage_name
from sphere_sim.recording.message_fields import (
    CLEARANCE,
    CONTACTS,
    number,
    reported_disturbance,
    reported_momentum,
    reported_orientation,
    reported_solve,
)
from sphere_sim.recording.messages import Messages, read_messages
from sphere_sim.recording.node_parameters import bag_parameters, with_parameters
from sphere_sim.recording.poses import read_poses
from sphere_sim.recording.run import Run, setup_text, without_sign_jumps
from sphere_sim.recording.topic_roles import Robot, find_robot, is_read

_LONGEST_STRATEGY = 100
"""Characters of the name of a strategy or plant that are shown."""
_LONGEST_SOLVE = 1e5
"""Duration that no solve has [s]."""
_MOST_CONTACTS = 1000.0
"""Contacts that are believed between two messages."""


def read_run(
    path: Path, namespace: str | None = None, name: str | None = None,
    pose_topic: str | None = None,
) -> Run:
    """Read the run of one robot from a bag.

    Parameters
    ----------
    path : Path
        Folder or file, see `read_messages`.
    namespace, name : str, optional
        Namespace of the robot, as in ``/left``, needed only if the bag has several robots; name of
        the run in legends, that of the bag by default.
    pose_topic : str, optional
        Topic of its poses, needed only where neither the run nor its messages say which it is.

    Raises
    ------
    BagError
        If there is no bag, it is empty or of another robot, it has several robots or topics of
        poses and none is given, or the files are of several bags.
    """
    messages = read_messages(path, is_read)
    robot = find_robot(messages, namespace, pose_topic)
    clock, poses = read_poses(messages, robot.pose)
    reader = TopicReader(messages, robot, clock)
    speeds, torques = reader.joint_states()
    goals = reader.goals(poses.times)
    known_parameters = bag_parameters(messages.custom_data, robot.controller)
    parameters = RobotParameters()
    with suppress(InvalidParameterError):
        parameters = with_parameters(parameters, known_parameters, "robot.")
    solves, plans = reader.solves(), reader.plans()
    momentum, disturbances = reader.momentum(parameters)
    pushes, floors = reader.pushes(), reader.floors()
    poses = replace(poses, values=without_sign_jumps(poses.values))
    estimates = reader.estimates(robot.estimate)
    errors = estimate_errors(estimates, poses)
    messages.notes += clock.notes("the poses")
    return Run(
        poses, speeds, torques, printable(name or Path(storage_name(path)).stem), path, goals,
        plans, solves, momentum, disturbances, pushes, floors, reader.planned_clearances(),
        reader.contacts(), estimates, replace(estimates, values=errors), parameters,
        reader.setup(known_parameters, parameters), tuple(messages.notes),
    )


class TopicReader:
    """Reader of the other topics of one robot; its notes say what is missing or ignored."""

    def __init__(self, messages: Messages, robot: Robot, clock: BagClock) -> None:
        self._messages, self._robot, self._clock = messages, robot.namespace, clock
        self._notes = messages.notes
        self._joint_states, self._trajectory = robot.joint_states, robot.rotor_trajectory

    def setup(self, parameters: Mapping[str, str], robot: RobotParameters) -> str:
        """Return strategy, robot and plant in words, given the controller's parameters."""
        used = [values.get("strategy", "") for _, values in self._statuses]
        strategies = list(dict.fromkeys(filter(None, used))) or [parameters.get("strategy", "")]
        simulator = f"{self._robot}/simulator"
        plant = bag_parameters(self._messages.custom_data, simulator).get("plant", "")
        radius, speed = (
            getattr(robot, name) if f"robot.{name}" in parameters else math.nan
            for name in ("shell_radius", "max_rotor_speed")
        )
        strategy = cut(", then ".join(strategies), _LONGEST_STRATEGY)
        return setup_text(strategy, radius, speed, cut(plant, _LONGEST_STRATEGY))

    def joint_states(self) -> tuple[Series, Series]:
        """Return the rotor speeds [rad/s] and torques [N m]."""
        topic = self._joint_states
        entries = self._messages.decoded.get(topic, [])
        # Other joints, such as grippers, may use the same topic ...
        found = [(received, message, rotors) for received, message in entries
                 if (rotors := message.of_rotors()) is not None]
        if entries and not found:
            names = entries[0][1].names
            raise BagError(
                self._messages.path,
                f"{topic} names {shown(names)}, not {list(JOINT_NAMES)}: a bag of another robot",
            )
        # ... and publishers of angles alone, for the display of the robot.
        moving = [one for one in found if len(one[1].speeds)]
        if not found:
            self._notes.append(f"{topic} is missing; no rotor speeds and torques")
        elif len(moving) < len(found):
            self._notes.append(
                f"{topic}: {len(found) - len(moving)} of {len(found)} messages have no velocities"
            )
        used = moving or found
        values = [list(map(known, rotors[1:].ravel().tolist())) for _, _, rotors in used]
        both = self._series(topic, used, values, 4)
        speeds, torques = np.split(both.values, 2, axis=1)
        return Series(both.times, speeds), Series(both.times, torques)

    def estimates(self, topic: str) -> Series:
        """Return the estimates of poses on a topic, which is empty without them."""
        entries = self._messages.decoded.get(topic, [])
        if topic and not entries:
            self._notes.append(f"{topic} is missing; no estimates of the poses")
        found = self._series(topic, entries, [it.state for _, it in entries], POSE_SIZE)
        return found.where(are_states(found.values))

    def plans(self) -> Series:
        """Return the plans that the controller sent, knot times in the run's time [s]."""
        topic = self._trajectory
        entries = self._messages.decoded.get(topic, [])
        if not entries:
            self._notes.append(f"{topic} is missing; no plans")
        plans = []
        for received, message in entries:
            start = self._clock.time_of_message(message.stamp, received, latched=True)
            try:
                after, speeds = message.knots()
                speeds[np.abs(speeds) > LARGEST] = np.nan
                plans.append(FirstOrderHold(start + after / NANOSECONDS, speeds))
            except InvalidInputError:
                continue  # the simulator refuses it as well
        if len(plans) < len(entries):
            count = len(entries) - len(plans)
            self._notes.append(f"{topic}: {count} invalid trajectories were ignored")
        return Series.of((plan.start, plan) for plan in plans)

    def goals(self, poses: Vector) -> Series:
        """Return the goals, from when they came into force.

        A goal demands what the statuses say that name its message, or else a whole pose. Goals
        that were in force at none of the `poses`, times [s], are ignored.
        """
        # Goals that the controller accepted are preferred to those that were requested.
        accepted = self._topics("/active_goal")
        topic = accepted[0] if accepted else f"{self._robot}/goal_pose"
        given = self._messages.decoded.get(topic)
        if given is None:
            self._notes.append(
                f"{self._robot}/goal_pose and active_goal are missing; no errors can be computed"
            )
            return Series(lasting=True)
        if len(accepted) > 1:
            self._notes.append(f"{', '.join(accepted[1:])}: ignored, goals are those of {topic}")
        if not accepted:
            self._notes.append("active_goal is missing; goal_pose is used instead")
        demanded = {
            values.get("active_goal_stamp"): reported_orientation(values)
            for _, values in self._statuses
        } if accepted else {}
        entries = []
        for received, message in given:
            state = np.array(message.state)
            if not are_states(state[None])[0]:
                continue
            state[QUATERNION] /= np.linalg.norm(state[QUATERNION])
            # The controller stamps a goal when it accepts it; stamps set by users mean nothing.
            time = (
                self._clock.time_of_record(topic, received, message, latched=True)
                if accepted else self._clock.time_of_log(received)
            )
            orientation = demanded.get(stamp_text(message.stamp), Orientation.FULL)
            entries.append((time, Goal(state, orientation)))
        if len(entries) < len(given):
            self._notes.append(f"{topic}: {len(given) - len(entries)} invalid goals were ignored")
        entries.sort(key=lambda entry: entry[0])
        # A goal that is sent again while it is in force stays in force from the first time on.
        changes = [
            entry for previous, entry in zip([None, *entries], entries, strict=False)
            if previous is None or not previous[1].equals(entry[1])
        ]
        return self._within_run(changes, topic, poses)

    def _within_run(
        self, entries: list[tuple[float, Goal]], topic: str, poses: Vector
    ) -> Series:
        """Return the goals that were in force at any pose."""
        end = float(poses[-1])
        late = ", ".join(f"{time:.6g}" for time, _ in entries if time > end)
        entries = [entry for entry in entries if entry[0] <= end]
        if late:
            result = (
                "ignored" if entries else
                "no goal falls inside the recording, nothing to measure"
            )
            self._notes.append(f"{topic}: goal at {late} s, poses from 0 to {end:.6g} s: {result}")
        given = Series.of(entries, lasting=True)
        # The first pose of each goal: where two goals share it, only the second was in force.
        kept = np.diff(np.searchsorted(poses, given.times), append=len(poses)) > 0
        during = np.count_nonzero(~kept & (given.times >= 0.0))
        if during:
            self._notes.append(
                f"{topic}: {during} goals were replaced before the next pose: ignored"
            )
        return given.where(kept)

    def solves(self) -> Series:
        """Return the solves that the controller reported."""
        # At the other samples nothing was solved.
        solves = [
            (time, solve) for time, values in self._statuses
            if 0.0 < (solve := reported_solve(values)).duration < _LONGEST_SOLVE
            and "plan" in values
        ]
        if not solves:
            self._notes.append("no status of the controller reports a solve; no solve times")
        return Series.of(solves)

    def momentum(
        self, parameters: RobotParameters
    ) -> tuple[Series, Series]:
        """Return the momentum and the disturbances that the controller reported.

        The parameters are those of the controller, which define the units of the model.
        """
        reports = [
            (time, reported_momentum(values), disturbance) for time, values in self._statuses
            if (disturbance := reported_disturbance(values, parameters)) is not None
            and np.all(np.isfinite(reported_momentum(values)))
        ]
        times = np.array([time for time, _, _ in reports])
        momentum = np.array([momentum for _, momentum, _ in reports]).reshape(-1, 3)
        return Series(times, momentum), Series(times, tuple(one for _, _, one in reports))

    def pushes(self) -> Series:
        """Return the pushes of the robot's simulator."""
        pushes = [
            (self._clock.time_of_record(topic, *entry), *map(known, entry[1].vector[:2]))
            for topic in self._topics("/pushed") for entry in self._messages.decoded[topic]
        ]
        pushed: Vector = np.array(pushes, dtype=float).reshape(-1, 3)
        pushed = pushed[np.all(np.isfinite(pushed), axis=1)]
        return Series(pushed[:, 0], pushed[:, 1:])

    def floors(self) -> Series:
        """Return the floors that the controller reported."""
        found: list[tuple[float, Grid | None]] = []
        for topic in self._topics("/floor"):
            invalid = []
            for received, message in self._messages.decoded[topic]:
                time = self._clock.time_of_record(topic, received, message, latched=True)
                try:
                    found.append((time, floor_of(message)))
                except InvalidMapError as error:
                    invalid.append(str(error))
            if invalid:
                self._notes.append(
                    f"{topic}: {len(invalid)} invalid floors were ignored; {invalid[0]}"
                )
        found.sort(key=lambda entry: entry[0])
        return Series.of(found, lasting=True)

    def planned_clearances(self) -> Series:
        """Return the clearances of plans that the controller reported."""
        return Series.of(
            (time, number(values, CLEARANCE)) for time, values in self._statuses
            if CLEARANCE in values
        )

    def contacts(self) -> Series:
        """Return the contacts that the robot's simulator had counted, by when it had."""
        ending, key = CONTACTS
        place, times, before = f"{self._robot}/".lstrip("/"), list[float](), 0.0
        for received, message in self._messages.decoded.get("/diagnostics", ()):
            for status in message.statuses:
                node = status.name.removeprefix(place).removesuffix(ending)
                if status.name != f"{place}{node}{ending}" or "/" in node:
                    continue
                count = number(status.values, key) if key in status.values else 0.0
                if not math.isfinite(count):
                    continue
                time = self._clock.time_of_message(message.stamp, received)
                # A simulator that is started again counts from 0.
                times += [time] * round(np.clip(count - before, 0.0, _MOST_CONTACTS))
                before = count
        return Series.of((time, i) for i, time in enumerate(times, start=1))

    def _series(
        self, topic: str, entries: Sequence[tuple[Any, ...]], rows: Sequence[Any], size: int
    ) -> Series:
        """Return what messages hold, `size` numbers each, given with their log times."""
        values: Vector = np.array(rows, dtype=float).reshape(-1, size)
        return Series.of_numbers(self._times(topic, entries, values), values)

    def _times(self, topic: str, entries: Sequence[tuple[Any, ...]], values: Vector) -> Vector:
        """Return the times [s] of messages, given with their log times and what they hold."""
        logs, stamps = np.array(
            [(entry[0], entry[1].stamp) for entry in entries], dtype=np.int64
        ).reshape(-1, 2).T
        if stand_still(logs, stamps, values):
            self._clock.undated[topic] += len(entries)
            return np.array([self._clock.time_of_log(log) for log in logs.tolist()])
        return np.array([self._clock.time_of_record(topic, *entry[:2]) for entry in entries])

    def _topics(self, ending: str) -> list[str]:
        """Return the topics of the robot with an ending, whatever the name of the node is."""
        return sorted(
            topic for topic in self._messages.decoded
            if topic.endswith(ending)
            and topic.removesuffix(ending).rpartition("/")[0] == self._robot
        )

    @cached_property
    def _statuses(self) -> list[tuple[float, dict[str, str]]]:
        """Time [s] and key-value pairs of each status of the controller."""
        return [
            self._status(received, message) for topic in self._topics("/status")
            for received, message in self._messages.decoded[topic]
        ]

    def _status(self, received: int, message: Any) -> tuple[float, dict[str, str]]:
        values = message.values
        time = number(values, "time_s")
        if not math.isfinite(time):
            return self._clock.time_of_log(received), values
        # Without simulated time the controller counts from its own start.
        return self._clock.time_of_message(round(time * NANOSECONDS), received), values

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitor, status and diagnostics of the odometry node."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import Imu, JointState

from sphere_nmpc.control.pose_stream import StampWatch
from sphere_nmpc.errors import Description, InvalidInputError
from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry.sensor_faults import LOST
from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.quantity import NANOSECONDS
from sphere_nmpc.reporting.conditions import OK, STALE, Condition, Kind, Severity
from sphere_nmpc.reporting.fault_log import FaultLog
from sphere_nmpc.reporting.recent import Recent
from sphere_nmpc.ros.cdr import seconds
from sphere_nmpc.ros.control_clock import ControlClock
from sphere_nmpc.ros.diagnostics import Diagnostics, status, status_name
from sphere_nmpc.ros.graph_monitor import names_of
from sphere_nmpc.ros.guarded_node import LATCHED, GuardedNode
from sphere_nmpc.ros.input_monitor import OTHER_CLOCK_AGE, InputMonitor, Source, StampedInput

_SOURCES = (
    Source(
        Imu, Kind.IMU_SILENT, "readings of the IMU", "100 Hz or more",
        "start the driver of the IMU or the simulator", "imu", "readings of several are mixed up",
    ),
    Source(
        JointState, Kind.ENCODERS_SILENT, "rotor speeds", "the rate of the IMU",
        "start the driver of the rotors", "joint_states", "",
    ),
)
_TOPICS = {Kind.IMU_SILENT: ("imu", Imu), Kind.ENCODERS_SILENT: ("joint_states", JointState)}
"""Names and types of the topics of sensors, by the condition of their silence."""
_PASSING = (OK, STALE)
"""Severities of conditions that are no faults: an event, and what has to be waited for."""
_LATE = 0.5
"""Age of a reading from which on its stamp counts as one of another clock [s]: the `pose_timeout`
at which a controller gives its poses up."""


class Stream:
    """Stamps of a sensor's messages."""

    def __init__(self, clock: ControlClock, messages: StampedInput) -> None:
        self._clock, self._messages = clock, messages
        self.watch = StampWatch(messages.source.plural)
        """Stamps that cannot be times of measurement."""
        self._gaps = Recent()
        self.newest = 0
        """Newest stamp [ns]."""
        self._outdated = -1
        self._seen = 0

    def begin_anew(self) -> None:
        """Leave out what was measured until now, which may not have been received yet."""
        self._outdated, self.newest = self._clock.stamp(), 0

    def received(self, stamp: int, numbers: Vector) -> bool:
        """Record a message with a stamp [ns]; return whether that may be a time of measurement.

        It is 0 where a driver does not set it, and at the start of simulated time; before the
        clock is known it may be any. One ahead of the clock, which would make all before it
        outdated, is refused; where it is of another kind of clock, the monitor reports it.
        `numbers` are what was measured.
        """
        now = self._clock.stamp()
        age = (now - stamp) / NANOSECONDS
        self._messages.received(age, stamp)
        if self._clock.now() is None or age < -OTHER_CLOCK_AGE or stamp <= self._outdated:
            return False
        if age < -_LATE:
            given = Description(f"{-age:.6g} s ahead of this node's clock")
            raise InvalidInputError(
                "stamp", given, f"at most {_LATE:g} s ahead; are the clocks synchronised?"
            )
        self.watch.received(seconds(stamp), numbers)
        if stamp > self.newest:
            if self.newest:
                self._gaps.append((stamp - self.newest) / NANOSECONDS)
            self.newest = stamp
        return bool(stamp) or (self._clock.simulated and now < _LATE * NANOSECONDS)

    def heard_until(self) -> int:
        """Return the stamp [ns] up to which messages have come; now, if none since the last call.

        Others may wait behind the newest one where the machine is busy.
        """
        before, self._seen = self._seen, self.newest
        return self.newest if self.newest > before else self._clock.stamp()

    @property
    def rate(self) -> float:
        """Mean rate of the newest messages [Hz]; nan where there are none."""
        return 1.0 / self._gaps.mean

    @property
    def age(self) -> float:
        """Age of the newest message [s]."""
        return (self._clock.stamp() - self.newest) / NANOSECONDS if self.newest else math.inf


class OdometryReports:
    """Publisher of the status, source of the diagnostics, and log of what is wrong."""

    def __init__(
        self, node: GuardedNode, clock: ControlClock, fault_log: FaultLog, event_log: FaultLog,
    ) -> None:
        self._node, self._clock, self._event_log = node, clock, event_log
        self._monitor = InputMonitor(node, fault_log, *_SOURCES)
        self.imu, self.joints = (Stream(clock, one) for one in self._monitor.inputs)
        """Streams of the sensors."""
        self.pose: Vector | None = None
        """Last pose that was published, shape (6,)."""
        self._told: set[str] = set()
        self._last: tuple[Severity, str, Mapping[str, Any]] = STALE, "no reading yet", {}
        self._name = status_name(node)
        self._status = node.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        Diagnostics(node, clock.stamp, {"estimate": lambda: self._last})

    def update(self, odometry: Odometry) -> None:
        """Look for faults, and publish the status; call it at intervals."""
        clock, conditions = self._clock, odometry.conditions
        lasting = [
            self._located(one) for one in conditions if one.kind.severity not in _PASSING
        ]
        further = self._monitor.graph.further_publishers(clocked=False)
        inexact = [one for one in (self.imu.watch.fault(), self.joints.watch.fault()) if one]
        self._monitor.update(
            clock.now(), clock.simulated, _LATE, [*further, *lasting, *inexact[:1]]
        )
        passing = [one for one in conditions if one.kind.severity in _PASSING]
        self._tell(odometry, passing)
        # What is wrong first: it may be what the calibration waits for.
        told = (*self._monitor.faults, *passing)
        level, message = STALE, "no reading yet"
        if told:
            level, message = max(one.kind.severity for one in told), str(told[0])
        elif odometry.estimate is not None:
            level, message = OK, "estimating"
        self._last = level, message, self._values(odometry, told)
        self._status.publish(status(self._name, *self._last))

    def _tell(self, odometry: Odometry, passing: Sequence[Condition]) -> None:
        """Log what is no fault, once: what has begun, and the result of the calibration."""
        now = {one.name: one.text for one in passing}
        if odometry.is_calibrated:
            now["calibrated"] = odometry.calibration
        for name in now.keys() - self._told:
            self._event_log.report(name, now[name])
        self._told = set(now)

    def _located(self, one: Condition) -> Condition:
        """Return a condition, that of a silent sensor with what the graph shows of its topic.

        That of a position which is not known has the last one that was published.
        """
        if one.kind in LOST:
            place = "" if self.pose is None else (
                f" after that at {self.pose[POSITION].round(2).tolist()} m"
            )
            return Condition(one.kind, f"{one.text}; no pose is published{place}")
        if one.kind not in _TOPICS:
            return one
        name, message = _TOPICS[one.kind]
        topic = self._node.resolve_topic_name(name)
        senders = self._monitor.graph.publishers(topic, message)
        there = f"without a publisher: start its driver, or remap, -r {name}:=/its/topic"
        if senders:
            there = f"published by {names_of(senders)}"
        return Condition(one.kind, f"{one.text}; {topic} is {there}")

    def _values(self, odometry: Odometry, told: Sequence[Condition]) -> dict[str, Any]:
        estimate = odometry.estimate
        position = heading = math.nan
        if estimate is not None:
            position, heading, _ = estimate.deviations
        return {
            "calibrated": odometry.is_calibrated,
            "calibration": odometry.calibration,
            "gyro_bias_rad_s": odometry.gyro_bias.round(7).tolist(),
            "position_deviation_m": position,
            "heading_deviation_deg": math.degrees(heading),
            "imu_age_s": self.imu.age,
            "imu_rate_hz": self.imu.rate,
            "joint_states_rate_hz": self.joints.rate,
            "fixes_used": odometry.fixes_used,
            "fixes_left_out": odometry.fixes_left_out,
            "conditions": ", ".join(one.name for one in told),
        }

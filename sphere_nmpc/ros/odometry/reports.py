# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitor, status and diagnostics of the odometry node."""

from collections.abc import Sequence

from sensor_msgs.msg import Imu, JointState

from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry.sensor_faults import LOST
from sphere_nmpc.estimation.odometry.status import MOST_AHEAD, SensorStream, status_values
from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.reporting.conditions import (
    OK,
    STALE,
    Condition,
    Kind,
    Report,
    with_conditions,
)
from sphere_nmpc.reporting.fault_log import FaultLog
from sphere_nmpc.ros.cdr import seconds
from sphere_nmpc.ros.control_clock import ControlClock
from sphere_nmpc.ros.diagnostics import Diagnostics
from sphere_nmpc.ros.graph_monitor import names_of
from sphere_nmpc.ros.guarded_node import LATCHED, GuardedNode
from sphere_nmpc.ros.input_monitor import InputMonitor, Source

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
_PASSING = (OK, STALE)
"""Severities of conditions that are no faults: an event, and what has to be waited for."""


class OdometryReports:
    """Publisher of the status, source of the diagnostics, and log of what is wrong."""

    def __init__(
        self, node: GuardedNode, clock: ControlClock, fault_log: FaultLog, event_log: FaultLog,
    ) -> None:
        self._clock, self._event_log = clock, event_log
        streams = {source: SensorStream(source.plural) for source in _SOURCES}
        self.imu, self.joints = streams.values()
        """Messages of the sensors."""
        self._monitor = InputMonitor(node, fault_log, streams)
        self.pose: Vector | None = None
        """Last pose that was published, shape (6,)."""
        self._logged: set[str] = set()
        self.report: Report = STALE, "no reading yet", {}
        """The newest status."""
        self._diagnostics = Diagnostics(
            node, clock.stamp, {"estimate": lambda: self.report}, LATCHED
        )

    def received(self, stream: SensorStream, stamp: int, measured: Vector) -> bool:
        """Record a message with a stamp [ns]; return whether that may be a time of measurement.

        Before the clock is known it may be any. One of another kind of clock is reported by the
        monitor.
        """
        clock, now = self._clock, self._clock.stamp()
        stream.heard(seconds(now, stamp), stamp)
        return clock.now() is not None and stream.accepts(stamp, measured, now, clock.simulated)

    def update(self, odometry: Odometry) -> None:
        """Look for faults, and publish the status; call it at intervals."""
        clock, conditions = self._clock, odometry.conditions
        lasting = [
            self._located(one) for one in conditions if one.kind.severity not in _PASSING
        ]
        further = self._monitor.graph.further_publishers(clocked=False)
        self._monitor.update(
            clock.now(), clock.simulated, MOST_AHEAD,
            [*further, *lasting, *self._monitor.inexact_stamps],
        )
        passing = [one for one in conditions if one.kind.severity in _PASSING]
        self._log(odometry, passing)
        # What is wrong first: it may be what the calibration waits for.
        conditions = (*self._monitor.graph.faults, *passing)
        values = status_values(odometry, self.imu, self.joints, clock.stamp(), conditions)
        is_begun = conditions or odometry.estimate is not None
        severity, message = (OK, "estimating") if is_begun else (STALE, "no reading yet")
        self.report = with_conditions((severity, message, values), conditions)
        self._diagnostics.status.publish(self._diagnostics.message(self.report))

    def _log(self, odometry: Odometry, passing: Sequence[Condition]) -> None:
        """Log what is no fault, once: what has begun, and the result of the calibration."""
        now = {one.name: one.text for one in passing}
        if odometry.is_calibrated:
            now["calibrated"] = odometry.calibration
        for name in now.keys() - self._logged:
            self._event_log.report(name, now[name])
        self._logged = set(now)

    def _located(self, one: Condition) -> Condition:
        """Return a condition, that of a silent sensor with what the graph shows of its topic.

        That of a position which is not known has the last one that was published.
        """
        if one.kind in LOST:
            place = "" if self.pose is None else (
                f" after that at {self.pose[POSITION].round(2).tolist()} m"
            )
            return Condition(one.kind, f"{one.text}; no pose is published{place}")
        source = next((source for source in _SOURCES if source.missing is one.kind), None)
        if source is None:
            return one
        topic = self._monitor.topics[source]
        senders = self._monitor.graph.publishers(topic, source.message)
        there = f"without a publisher: start its driver, or remap, -r {source.topic}:=/its/topic"
        if senders:
            there = f"published by {names_of(senders)}"
        return Condition(one.kind, f"{one.text}; {topic} is {there}")

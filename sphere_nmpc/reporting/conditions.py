# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Conditions: how things stand and what is wrong, in one vocabulary for plan, loop, nodes, viewer.

The table is `Kind`. From it follow the level of status and diagnostics, the error code of an
action, and the words of log and status, which `docs/when_it_does_not_move.md` explains.
"""

from collections.abc import Iterable, Mapping, Sequence
from enum import Enum, IntEnum
from typing import Any, NamedTuple


class Severity(IntEnum):
    """Level of diagnostics, from the best to the worst."""

    OK = 0
    WARN = 1
    STALE = 2
    """What is needed has not been there yet."""
    ERROR = 3
    """The robot cannot be controlled."""


OK, WARN, STALE, ERROR = Severity


Report = tuple[Severity, str, Mapping[str, Any]]
"""How a node, or one of its tasks, stands: how severe it is, a message, and values by name."""


class Condition(NamedTuple):
    """How one thing stands; its severity is that of its kind."""

    kind: "Kind"  #: Subject, which does not vary.
    text: str = ""
    """What was given, what was expected and what helps; it varies."""
    subject: str = ""
    """Which topic or node it is about, where there may be several."""

    @property
    def name(self) -> str:
        """Words of log and message, which do not vary."""
        return self.kind.log.replace("…", self.subject)

    def __str__(self) -> str:
        return f"{self.name}: {self.text}" if self.text else self.name


class Kind(Enum):
    """What a condition is about.

    Each has its text as a value of the status and its severity; where they differ the words of
    log and message, in which `…` stands for what varies; and the error code of Nav2 for an action
    that ends by it: of the results of ComputePathToPose and FollowPath in nav2_msgs, which its own
    navigator passes on.
    """

    NO_CLOCK = "no clock yet", STALE
    CLOCK_STOPPED = "the clock stands still", WARN
    CLOCK_JUMPED = "the clock jumps, nothing is sent", ERROR, "clock jumped"
    NO_POSE = "no pose yet", STALE, "", 102
    NO_GOAL = "no goal", OK
    DISABLED = "disabled", OK
    NO_FRESH_POSE = "no fresh pose, stopping", ERROR, "", 102
    POSE_JUMPED = "the pose has jumped, stopping", WARN, "pose jumped"
    TRACKING = "on the way to the goal", OK
    AT_GOAL = "at the goal", OK
    NO_PROGRESS = "no progress towards the goal", WARN, "no progress", 105
    SATURATED = "the rotors cannot hold the momentum", ERROR
    FALLBACK = "solve failed, following the previous plan", WARN, "solve failed"

    START_OUTSIDE = "start outside", OK, "", 203
    START_OCCUPIED = "start occupied", OK, "", 205
    GOAL_OUTSIDE = "goal outside", OK, "", 204
    GOAL_OCCUPIED = "goal occupied", OK, "", 206
    """The goal is occupied, or too near to what is."""
    NO_WAY = "no way", OK, "", 208

    PLANNED = "planned", OK
    """What a plan does, or why it does no more."""
    GIVEN_UP = "given up", OK
    """What a plan gives up of the goal, for now."""

    ROTORS_AT_LIMIT = "rotors at their limit", WARN
    ROTORS_NEAR_LIMIT = "rotors near their limit", WARN
    CONTROLLER_FAILED = "controller failed", WARN
    POSE_LEFT_OUT = "pose left out", WARN
    SPEEDS_CONTRADICTED = "rotor speeds contradicted", WARN
    OTHER_ROBOT = "other robot", WARN

    CALIBRATING = "calibrating at rest", STALE
    IMU_SILENT = "no IMU", ERROR
    IMU_STUCK = "IMU stuck", ERROR
    GYRO_SATURATED = "gyro saturated", WARN
    ENCODERS_SILENT = "no rotor speeds", WARN
    ENCODERS_STUCK = "rotor speeds stuck", WARN
    ENCODERS_LATE = "rotor speeds late", WARN
    PUSHED = "pushed", OK
    SLIPPED = "slipped", WARN
    LIFTED = "lifted", ERROR
    POSITION_UNKNOWN = "position not known", ERROR
    NO_GRAVITY = "no gravity", ERROR
    LARGE_BIAS = "large gyro bias", WARN
    FIX_LEFT_OUT = "fix left out", WARN
    TILT_REPLACED = "tilt replaced", WARN

    CLOCK_MISSING = "no clock", ERROR
    CLOCK_ENDED = "clock stopped", ERROR
    POSE_MISSING = "no pose", ERROR
    WRONG_CLOCK = "wrong clock", ERROR
    UNKNOWN_CLOCK = "unknown clock", ERROR
    NO_STAMP = "no stamp", ERROR
    INEXACT_STAMPS = "inexact stamps", WARN
    MISSED_SAMPLES = "missed samples", WARN
    FLOOR_LATE = "floor late", WARN
    OTHER_PUBLISHER = "other publisher of …", WARN
    OTHER_TYPE = "other type on …", WARN
    INCOMPATIBLE_QOS = "incompatible QoS on …", WARN
    NETWORK = "network", WARN
    LIMITS = "limits", ERROR
    LIMITS_OF = "limits of …", ERROR
    NOTHING_TO_RECORD = "nothing to record", ERROR

    severity: Severity
    log: str
    code: int
    conditions: "tuple[Condition, ...]"
    """One condition of this kind, without a text."""

    def __new__(cls, value: str, severity: Severity, log: str = "", code: int = 0) -> "Kind":
        """Return the kind of a row."""
        kind = object.__new__(cls)
        kind._value_, kind.severity, kind.log, kind.code = value, severity, log or value, code
        kind.conditions = (Condition(kind),)
        return kind

    @property
    def is_unreachable(self) -> bool:
        """Whether no plan can lead to the goal, which is an error of planning in Nav2."""
        return self.code >= 200


def worst_first(conditions: Iterable[Condition]) -> tuple[Condition, ...]:
    """Return conditions by severity, those of the same one in the order given."""
    return tuple(sorted(conditions, key=lambda condition: -condition.kind.severity))


def with_conditions(report: Report, found: Sequence[Condition]) -> Report:
    """Return a report with conditions, the first of which takes precedence over its message."""
    if not found:
        return report
    severity, _, values = report
    return max(severity, *(one.kind.severity for one in found)), str(found[0]), values

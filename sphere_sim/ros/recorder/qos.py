# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of the recorder's subscriptions, and of topics as a bag stores it."""

from collections.abc import Sequence

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

from sphere_nmpc.quantity import NANOSECONDS

_DEPTH = 2000
"""Queue length of a subscription: a simulation in lockstep does not wait for the recorder."""


def compatible_qos(offered: Sequence[QoSProfile], latched: bool = False) -> QoSProfile:
    """Return the strictest profile that is compatible with all publishers of a topic.

    Parameters
    ----------
    offered : sequence of QoSProfile
        Profiles that the publishers offer; may be empty.
    latched : bool, optional
        Whether to request kept messages while there is no publisher.
    """
    reliable = all(qos.reliability is ReliabilityPolicy.RELIABLE for qos in offered)
    kept = all(qos.durability is DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL
            if (kept if offered else latched)
            else DurabilityPolicy.VOLATILE
        ),
    )


def is_latched(profile: QoSProfile) -> bool:
    """Return whether a subscription receives messages that publishers keep."""
    return profile.durability is DurabilityPolicy.TRANSIENT_LOCAL


def same_requests(one: QoSProfile, other: QoSProfile) -> bool:
    """Return whether two subscriptions are compatible with the same publishers."""
    return one.reliability is other.reliability and one.durability is other.durability


def qos_for_bag(profile: QoSProfile) -> Qos:
    """Return a profile in the form in which a bag stores it."""
    deadline, lifespan, lease = (
        QosTime(*divmod(duration.nanoseconds, NANOSECONDS))
        for duration in (profile.deadline, profile.lifespan, profile.liveliness_lease_duration)
    )
    return Qos(
        history=QosHistory.__members__.get(profile.history.name, QosHistory.UNKNOWN),
        depth=profile.depth,
        reliability=QosReliability.__members__.get(
            profile.reliability.name, QosReliability.UNKNOWN
        ),
        durability=QosDurability.__members__.get(profile.durability.name, QosDurability.UNKNOWN),
        deadline=deadline,
        lifespan=lifespan,
        liveliness=QosLiveliness.__members__.get(profile.liveliness.name, QosLiveliness.UNKNOWN),
        liveliness_lease_duration=lease,
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service that fits whatever the publishers of a topic offer."""

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

_DEPTH = 2000
"""Messages a topic may be behind; a simulation in lockstep does not wait for its listeners."""
_NANOSECONDS = 1_000_000_000


def fitting_qos(offered: Sequence[QoSProfile], latched: bool = False) -> QoSProfile:
    """Return what to ask for, so that every publisher is heard.

    Parameters
    ----------
    offered : sequence of QoSProfile
        What the publishers offer, possibly nothing yet.
    latched : bool, optional
        Whether to expect kept messages while there is no publisher.
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


def same_demand(one: QoSProfile, other: QoSProfile) -> bool:
    """Tell whether two subscriptions would hear the same publishers."""
    return one.reliability is other.reliability and one.durability is other.durability


def qos_for_bag(profile: QoSProfile) -> Qos:
    """Return a profile in the form in which it is stored with a bag."""
    deadline, lifespan, lease = (
        QosTime(*divmod(duration.nanoseconds, _NANOSECONDS))
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

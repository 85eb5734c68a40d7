# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is wrong around a node, with its cause and its cure: clocks, publishers, silence.

Pure functions of what a node sees; `sphere_nmpc.ros.watch` looks and tells.
"""

from collections.abc import Sequence
from dataclasses import dataclass

PATIENCE = 1.25
"""Silence after which something is missing [s, wall]; with a look every half second it is told
within two seconds, and nodes that start together have found each other by then."""
NO_POSE = "no pose"
OTHER_CLOCK = 1e6
"""Age of a pose beyond which its stamp is of another kind of clock, not merely late [s]."""
_OWN_NAMESPACE = "a further robot takes a namespace of its own, -r __ns:=/second"
_KILLED = "a node that was killed counts for up to 20 s"


@dataclass(frozen=True)
class Complaint:
    """One thing that is wrong.

    Attributes
    ----------
    kind : str
        What, in a few words that stay the same.
    message : str
        What was given, what was expected, and what helps.
    severe : bool
        Whether the node cannot do its work because of it.
    """

    kind: str
    message: str
    severe: bool = True


@dataclass(frozen=True)
class Surroundings:
    """What a controller sees of its surroundings at one moment.

    Attributes
    ----------
    follows_clock : bool
        Whether the node runs with ``use_sim_time``.
    time : float
        Control time [s]; nan before the first message on /clock.
    clock_silence, pose_silence : float
        Wall time since control time went on, and since a pose arrived [s].
    pose_age : float
        Age of the newest pose on the node's clock when it arrived [s], positive for an old one;
        nan before the first pose.
    pose_timeout : float
        Age up to which a pose will do [s].
    clocks, poses : sequence of str
        Names of the nodes that publish the clock and the pose.
    clock_topic, pose_topic : str
        Full names of the topics.
    other_clocks : sequence of str
        Other topics on which somebody publishes a clock.
    """

    follows_clock: bool
    time: float
    clock_silence: float
    pose_silence: float
    pose_age: float
    pose_timeout: float
    clocks: Sequence[str]
    poses: Sequence[str]
    clock_topic: str = "/clock"
    pose_topic: str = "/pose"
    other_clocks: Sequence[str] = ()


def several(topic: str, nodes: Sequence[str], harm: str) -> list[Complaint]:
    """Return the complaint about a topic that more than one node publishes, if so."""
    if len(nodes) < 2:
        return []
    return [
        Complaint(
            f"other publisher of {topic}",
            f"given {len(nodes)} ({', '.join(sorted(nodes))}), expected one; {harm}; "
            f"{_OWN_NAMESPACE}; {_KILLED}",
            severe=False,
        )
    ]


def rivals(
    pose_topic: str, poses: Sequence[str], clock_topic: str, clocks: Sequence[str]
) -> list[Complaint]:
    """Return the complaints about further publishers of the clock and of the pose."""
    return [
        *several(clock_topic, clocks, "time jumps between them"),
        *several(pose_topic, poses, "the pose jumps between them"),
    ]


def incompatible(topic: str, node: str, reason: str) -> Complaint:
    """Return the complaint about another node's end of a topic, through which nothing passes.

    Parameters
    ----------
    topic : str
        Full name of the topic.
    node : str
        Full name of the other node.
    reason : str
        What does not fit, in the words of the middleware.
    """
    return Complaint(
        f"incompatible QoS on {topic}",
        f"given {reason.removeprefix('ERROR: ').rstrip(';').lower()} ({node}), expected qualities "
        f"of service that fit; no message passes; 'ros2 topic info -v {topic}' shows both sides",
        severe=False,
    )


def complaints(seen: Surroundings) -> list[Complaint]:
    """Return what is wrong around a controller, the gravest first."""
    found = _standing_still(seen) or _no_pose(seen) or _wrong_clock(seen)
    clocks = seen.clocks if seen.follows_clock else ()
    return found + rivals(seen.pose_topic, seen.poses, seen.clock_topic, clocks)


def _standing_still(seen: Surroundings) -> list[Complaint]:
    """Return the complaint about a clock that nobody publishes or that has stopped."""
    if not seen.follows_clock or seen.clock_silence < PATIENCE:
        return []
    topic, known = seen.clock_topic, seen.time == seen.time
    if not known and not seen.clocks:
        cure = "start a simulator, or on a real robot -p use_sim_time:=false"
        if seen.other_clocks:
            cure = f"-r /clock:={seen.other_clocks[0]} follows the clock that is there, or {cure}"
        return [
            Complaint(
                "no clock", f"given use_sim_time: true and no publisher of {topic}, expected one; "
                f"{cure}",
            )
        ]
    if not known:
        return [
            Complaint(
                "no clock", f"given a publisher of {topic} ({seen.clocks[0]}) that has sent "
                f"nothing for {PATIENCE:g} s, expected its messages; start it anew",
            )
        ]
    if seen.pose_silence < PATIENCE:
        # A simulator that is paused, or waits in lockstep, goes on repeating its last pose.
        if not seen.pose_age < -seen.pose_timeout:
            return []
        return [
            Complaint(
                "clock stopped", f"given poses that go on and nothing on {topic} since "
                f"t = {seen.time:.3f} s, expected both from one simulator; look for what holds "
                f"{topic} back",
            )
        ]
    there = "its publisher hangs or was killed" if seen.clocks else "its publisher is gone"
    return [
        Complaint(
            "clock stopped", f"given nothing on {topic} and {seen.pose_topic} since "
            f"t = {seen.time:.3f} s, expected a running simulator; {there}: start it anew",
        )
    ]


def _no_pose(seen: Surroundings) -> list[Complaint]:
    if seen.pose_silence < PATIENCE:
        return []
    if seen.poses:
        given = f"a publisher of {seen.pose_topic} ({seen.poses[0]}) that sends nothing that "
        given += "arrives"
        cure = f"'ros2 topic info -v {seen.pose_topic}' tells its quality of service"
    else:
        given = f"no publisher of {seen.pose_topic}"
        cure = "start the simulator or the robot's estimator, or remap, -r pose:=/its/topic"
    return [
        Complaint(NO_POSE, f"given {given} for {PATIENCE:g} s, expected 20 Hz or more; {cure}")
    ]


def _wrong_clock(seen: Surroundings) -> list[Complaint]:
    """Return the complaint about poses that are stamped on another clock than the node's."""
    age = seen.pose_age
    # A single pose from the future is refused, which is told by itself; nan is before the first.
    if not (age > seen.pose_timeout or age < -OTHER_CLOCK):
        return []
    if seen.follows_clock and seen.clock_silence >= PATIENCE:
        return []  # paused
    where = "behind" if age > 0.0 else "ahead of"
    given = f"given poses with stamps {abs(age):.3g} s {where} this node's clock, expected at "
    given += f"most {seen.pose_timeout:g} s"
    if not seen.follows_clock and age > OTHER_CLOCK:
        cure = "they are in simulated time: start this node with -p use_sim_time:=true"
    elif seen.follows_clock and age < -OTHER_CLOCK:
        cure = "they are on the system clock: start this node with -p use_sim_time:=false"
    else:
        cure = "synchronise the clocks of the machines (chrony), or raise pose_timeout"
    return [Complaint("wrong clock", f"{given}; {cure}")]

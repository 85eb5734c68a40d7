# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults in the ROS graph around a node, each with cause and remedy: clocks, publishers, QoS.

Pure functions of what a node observes; `sphere_nmpc.ros.graph_monitor` observes and logs.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass

SILENCE_LIMIT = 1.25
"""Silence after which a topic counts as missing [s, wall]. Nodes that start together have
discovered each other by then, and with checks every half second faults are logged within two."""
NO_POSE = "no pose"
OTHER_CLOCK_AGE = 1e6
"""Age of a pose beyond which its stamp is of another kind of clock, not merely late [s]."""
_USE_NAMESPACE = "start a further robot in a namespace, -r __ns:=/second"
_MOST_NAMES = 8
"""Names of nodes in a message."""
_KILLED = "a node that was killed is counted for up to 20 s"


@dataclass(frozen=True)
class GraphFault:
    """A fault in the ROS graph, with its remedy.

    Attributes
    ----------
    kind : str
        What is wrong, in a few words that do not change.
    message : str
        What was given, what was expected, and the remedy.
    severe : bool
        Whether it prevents the node from doing its work.
    """

    kind: str
    message: str
    severe: bool = True


@dataclass(frozen=True)
class GraphState:
    """Observations of the ROS graph by a controller at one moment.

    Attributes
    ----------
    follows_clock : bool
        Whether the node runs with ``use_sim_time``.
    time : float
        Control time [s]; nan before the first message on /clock.
    clock_silence, pose_silence : float
        Wall time since control time last changed, and since the last pose was received [s].
    pose_age : float
        Age of the newest pose on the node's clock when it was received [s], positive for an old
        one; nan before the first pose.
    pose_timeout : float
        Largest accepted age of a pose [s].
    clocks, poses : sequence of str
        Names of the nodes that publish the clock and the pose.
    clock_topic, pose_topic : str
        Full names of the topics.
    other_clocks : sequence of str
        Other topics on which a clock is published.
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


def find_faults(seen: GraphState) -> list[GraphFault]:
    """Return the faults around a controller, the most severe first."""
    found = _no_time(seen) or _no_pose(seen) or _wrong_clock(seen)
    clocks = seen.clocks if seen.follows_clock else ()
    return found + further_publishers(seen.pose_topic, seen.poses, seen.clock_topic, clocks)


def further_publishers(
    pose_topic: str, poses: Sequence[str], clock_topic: str, clocks: Sequence[str]
) -> list[GraphFault]:
    """Return the faults of several nodes `clocks` or `poses` that publish clock or pose."""
    return [
        *several_publishers(clock_topic, clocks, "time jumps between them"),
        *several_publishers(pose_topic, poses, "the pose jumps between them"),
    ]


def several_publishers(topic: str, nodes: Sequence[str], effect: str) -> list[GraphFault]:
    """Return the fault of a topic that more than one of `nodes` publishes, with its effect."""
    if len(nodes) < 2:
        return []
    return [
        GraphFault(
            f"other publisher of {topic}",
            f"given {len(nodes)} ({names_of(nodes)}), expected one; {effect}; "
            f"{_USE_NAMESPACE}; {_KILLED}",
            severe=False,
        )
    ]


def names_of(nodes: Sequence[str]) -> str:
    """Return the names of nodes for a message, a few of them if there are many."""
    more = ["..."] if len(nodes) > _MOST_NAMES else []
    return ", ".join([*sorted(nodes)[:_MOST_NAMES], *more])


def incompatible_qos(topic: str, node: str, reason: str) -> GraphFault:
    """Return the fault of two ends of a topic between which no message can be delivered.

    Parameters
    ----------
    topic : str
        Full name of the topic.
    node : str
        Full name of the other node.
    reason : str
        What is incompatible, in the words of the middleware.
    """
    return GraphFault(
        f"incompatible QoS on {topic}",
        f"given {reason.removeprefix('ERROR: ').rstrip(';').lower()} ({node}), expected qualities "
        f"of service that fit; no message passes; 'ros2 topic info -v {topic}' shows both sides",
        severe=False,
    )


def clock_jumped(step: float) -> GraphFault:
    """Return the fault of a clock that has jumped by `step` [s]."""
    return GraphFault(
        "clock jumped", f"given a step of {step:+.6g} s, expected a clock that runs on; nothing "
        "is sent until it does",
    )


def network_fault(announced: Set[str], present: Set[str]) -> list[GraphFault]:
    """Return the fault of a node that other machines are not told the right address of.

    Parameters
    ----------
    announced : set of str
        Addresses that this machine had in its network when the node started, which Fast DDS
        announces as long as the node runs.
    present : set of str
        Those that it has now.
    """
    if not present or announced & present:
        return []
    before, now = (", ".join(sorted(some)) or "none" for some in (announced, present))
    return [
        GraphFault(
            "network", f"given the address {now}, expected the one that this node announces since "
            f"its start ({before}); nodes on other machines cannot find it: restart it",
            severe=False,
        )
    ]


def missed_samples(share: float, span: float, period: float) -> list[GraphFault]:
    """Return the fault of a controller that misses sampling instants; none for a share of 0.

    Parameters
    ----------
    share : float
        Share of the instants that passed without a plan.
    span : float
        Wall time over which it was taken [s].
    period : float
        Control period [s].
    """
    if not share:
        return []
    return [
        GraphFault(
            "missed samples", f"given {100.0 * share:.3g} % of the sampling instants of the last "
            f"{span:.0f} s without a plan, at {1.0 / period:.4g} Hz, expected none; a lower "
            "control_rate, thread_priority: 1 or a free processor core helps",
            severe=False,
        )
    ]


def _no_time(seen: GraphState) -> list[GraphFault]:
    """Return the fault of a clock that is not published or has stopped."""
    if not seen.follows_clock or seen.clock_silence < SILENCE_LIMIT:
        return []
    topic, known = seen.clock_topic, seen.time == seen.time
    if not known and not seen.clocks:
        remedy = "start a simulator, or on a real robot -p use_sim_time:=false"
        if seen.other_clocks:
            other = f"-r /clock:={seen.other_clocks[0]} follows the clock that is there"
            remedy = f"{other}, or {remedy}"
        return [
            GraphFault(
                "no clock", f"given use_sim_time: true and no publisher of {topic}, expected one; "
                f"{remedy}",
            )
        ]
    if not known:
        return [
            GraphFault(
                "no clock", f"given a publisher of {topic} ({seen.clocks[0]}) that has sent "
                f"nothing for {SILENCE_LIMIT:g} s, expected its messages; restart it",
            )
        ]
    if seen.pose_silence < SILENCE_LIMIT:
        # A simulator that is paused, or waits in lockstep, repeats its last pose.
        if not seen.pose_age < -seen.pose_timeout:
            return []
        return [
            GraphFault(
                "clock stopped", f"given poses but no message on {topic} since "
                f"t = {seen.time:.3f} s, expected both from one simulator; find out what blocks "
                f"{topic}",
            )
        ]
    cause = "its publisher hangs or was killed" if seen.clocks else "its publisher is gone"
    return [
        GraphFault(
            "clock stopped", f"given nothing on {topic} and {seen.pose_topic} since "
            f"t = {seen.time:.3f} s, expected a running simulator; {cause}: restart it",
        )
    ]


def _no_pose(seen: GraphState) -> list[GraphFault]:
    """Return the fault of poses that are not published or not received."""
    if seen.pose_silence < SILENCE_LIMIT:
        return []
    if seen.poses:
        given = f"a publisher of {seen.pose_topic} ({seen.poses[0]}) but none of its messages"
        remedy = f"'ros2 topic info -v {seen.pose_topic}' shows its quality of service"
    else:
        given = f"no publisher of {seen.pose_topic}"
        remedy = "start the simulator or the robot's estimator, or remap, -r pose:=/its/topic"
    return [
        GraphFault(
            NO_POSE, f"given {given} for {SILENCE_LIMIT:g} s, expected 20 Hz or more; {remedy}"
        )
    ]


def _wrong_clock(seen: GraphState) -> list[GraphFault]:
    """Return the fault of poses that are stamped on another clock than the node's."""
    age = seen.pose_age
    # A single pose ahead of the clock is refused and logged by itself; nan is before the first.
    if not (age > seen.pose_timeout or age < -OTHER_CLOCK_AGE):
        return []
    if seen.follows_clock and seen.clock_silence >= SILENCE_LIMIT:
        return []  # paused
    where = "behind" if age > 0.0 else "ahead of"
    given = f"given poses with stamps {abs(age):.3g} s {where} this node's clock, expected at "
    given += f"most {seen.pose_timeout:g} s"
    if not seen.follows_clock and age > OTHER_CLOCK_AGE:
        remedy = "they are in simulated time: start this node with -p use_sim_time:=true"
    elif seen.follows_clock and age < -OTHER_CLOCK_AGE:
        remedy = "they are on the system clock: start this node with -p use_sim_time:=false"
    else:
        remedy = "synchronise the clocks of the machines (chrony), or raise pose_timeout"
    return [GraphFault("wrong clock", f"{given}; {remedy}")]

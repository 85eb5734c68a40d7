# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What causes the faults of the catalogue: generators that begin a fault, yield, and end it.

What has to be done repeatedly while the fault lasts is a function that they yield.
"""

import contextlib
import itertools
import math
import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from geometry_msgs.msg import PoseStamped, Vector3
from hostile import RADIUS, bad_map, goal_message, map_message, random_goal
from nav_msgs.msg import OccupancyGrid
from node_session import Session, SessionError
from relay import Disturbance, stamp_of
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.state import POSITION
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros.cdr import WORLD_FRAME, Pose, read
from sphere_nmpc.ros.cdr_messages import pose_message
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_to_ros

Action = Iterator[Any]
_OBSTACLE_AHEAD = 1.5
"""Least distance from the sphere to the middle of a new obstacle [m]."""
_SLICE = 0.1
"""Period of the throttling [s], that of Linux's processor quotas."""
_HOG = "import time\nend = time.time() + 30\nwhile time.time() < end: pass"
"""Program that ends by itself if the campaign is killed."""
_LEFT_ON_DISK = 1000
"""Space that is left before the disk is full [bytes]."""
_SOME_MESSAGES = 4000
"""Size of a bag that is not empty [bytes]."""
_WRONG_AT_START = (
    "sample_period:=-1.0", "strategy:=none", "robot.shell_mass:=0.0", "horizon:=2.5",
    "time_budget:=fast",
)
_WRONG_LIVE = (
    ("controller", "pose_timeout", -1.0), ("controller", "pose_timeout", float("nan")),
    ("controller", "max_iterations", "many"), ("controller", "strategy", "none"),
    ("controller", "robot__max_rotor_speed", 1e9), ("controller", "no_such_thing", 1),
    ("simulator", "real_time_factor", -1.0), ("simulator", "process_noise", float("inf")),
    ("simulator", "seed", "seven"),
)


def every(
    period: float, act: Callable[[], float | None], at_once: bool = True
) -> Callable[[], None]:
    """Return a function that acts when it is called, but once a `period` [s, wall] at most.

    Where `act` returns a number that is the next period.
    """
    due = 0.0 if at_once else time.monotonic() + period

    def when_due() -> None:
        nonlocal due
        if time.monotonic() >= due:
            due = time.monotonic() + (act() or period)

    return when_due


def source(session: Session) -> random.Random:
    """Return a source of randomness of Python."""
    return random.Random(int(session.rng.integers(2**32)))


def disturb_poses(session: Session, disturbance: Disturbance) -> Action:
    """Disturb the poses between simulator and controller."""
    session.relay.poses.disturbances.append(disturbance)
    yield
    session.relay.poses.disturbances.remove(disturbance)


def lose(session: Session, of: tuple[str, ...]) -> Action:
    """Lose all messages of some topics between simulator and controller."""
    session.relay.lost.update(of)
    yield
    session.relay.lost.difference_update(of)


def pause(session: Session) -> Action:
    """Pause simulated time."""
    session.call("simulator/pause", SetBool.Request(data=True))
    yield
    session.call("simulator/pause", SetBool.Request(data=False))


def clock_back(session: Session, by: float) -> Action:
    """Let the clock jump into the past by `by` [s]; it stays so, as another jump would be another.

    It does not jump to before zero.
    """
    relay = session.relay
    relay.shift -= min(round(by * NANOSECONDS), session.judge.now + relay.shift)
    session.judge.limits.restart()
    yield


def pace(session: Session, factor: float) -> Action:
    """Set another real-time factor."""
    session.require_parameters("simulator", real_time_factor=factor)
    yield
    session.require_parameters("simulator", real_time_factor=session.settings.rtf)


def bad_goals(session: Session, kinds: tuple[str, ...], period: float = 0.2) -> Action:
    """Send further goals of some kinds of `goal_message` in turn, one a `period` [s, wall]."""
    rng, kind = source(session), itertools.cycle(kinds)
    with session.publisher(PoseStamped, "goal_pose", 1) as publisher:
        yield every(period, lambda: publisher.publish(goal_message(rng, next(kind))))


def two_poses(session: Session, offset: float = 0.0) -> Action:
    """Publish further poses, each at a random time between one of the sphere and the next.

    They are displaced by `offset` along x [m]; with 0 they are those of another sphere, within 2 m
    and in any orientation.
    """
    other, relay, settings = random_goal(session.rng), session.relay, session.settings
    seen, due, after = b"", math.inf, 0.0

    def send() -> None:
        nonlocal seen, due, after
        if relay.newest != seen:
            # Sometimes just before a sampling instant, at which the newest pose counts.
            after = session.rng.uniform() / settings.rate
            seen, due = relay.newest, time.monotonic() + after / settings.rtf
        if time.monotonic() >= due:
            due, state = math.inf, other
            if offset:
                state = read(seen, Pose).in_frame(WORLD_FRAME)
                state[0] += offset
            stamp = stamp_of(seen) + round(NANOSECONDS * after) + relay.shift
            publisher.publish(pose_message(state, stamp, RADIUS))

    with session.publisher(PoseStamped, "pose") as publisher:
        yield send


def kill(session: Session, node: str) -> Action:
    """Send SIGKILL to a node and start it again.

    To a recorder once it has written, as it may lose its last second.
    """
    process = session.processes[node]
    if node == "recorder":
        before = written(session.folder)
        session.wait(lambda: written(session.folder) > before, "the recorder to write")
    process.kill()
    session.reports.messages.append(process.ending)
    yield
    session.start(node)


def stop(session: Session, node: str) -> Action:
    """Send SIGSTOP to a node, and SIGCONT at the end."""
    session.processes[node].send(signal.SIGSTOP)
    yield
    session.processes[node].send(signal.SIGCONT)


def throttle(session: Session, share: float) -> Action:
    """Let the controller run for a share of the time only, as a processor quota does."""
    process = session.processes["controller"]
    turns = itertools.cycle(((signal.SIGSTOP, 1.0 - share), (signal.SIGCONT, share)))

    def switch() -> float:
        number, part = next(turns)
        process.send(number)
        return part * _SLICE

    yield every(_SLICE, switch)
    process.send(signal.SIGCONT)


def hog(session: Session, number: int) -> Action:
    """Run other processes that take all of the processor time that they get."""
    hogs: list[subprocess.Popen[bytes]] = []
    try:
        for _ in range(number):
            hogs.append(subprocess.Popen([sys.executable, "-c", _HOG]))
        yield
    finally:
        for process in hogs:
            process.kill()
            process.wait()


def signal_worker(session: Session, number: signal.Signals) -> Action:
    """Send a signal that ends or stops the controller's worker, and SIGCONT at the end."""
    controller = session.processes["controller"].pid
    # One that was just replaced may not be there yet.
    session.wait(lambda: worker_of(controller), "the worker of the controller")
    pid = worker_of(controller)
    send(pid, number)
    yield
    send(pid, signal.SIGCONT)


def send(pid: int, number: signal.Signals) -> None:
    """Send a signal to a process that may have ended."""
    with contextlib.suppress(ProcessLookupError):
        if pid:
            os.kill(pid, number)


def worker_of(controller: int) -> int:
    """Return the process id of the worker that a process has started; 0 if there is none."""
    with contextlib.suppress(psutil.NoSuchProcess):  # a process may end while it is looked at
        for child in psutil.Process(controller).children():
            command = "" if child.status() == psutil.STATUS_ZOMBIE else " ".join(child.cmdline())
            if "sphere_nmpc.worker.serve" in command:
                return child.pid
    return 0


def memory_of(controller: int) -> float:
    """Return the resident memory of a process and its worker [MB]."""
    found = 0.0
    for pid in filter(None, (controller, worker_of(controller))):
        with contextlib.suppress(psutil.NoSuchProcess):
            found += psutil.Process(pid).memory_info().rss / 1e6
    return found


def bad_solver(session: Session, mode: str) -> Action:
    """Let the solver fail in a mode of `bad_strategy`."""
    session.solver_file.write_text(mode)
    yield
    session.solver_file.write_text("")


def disk_full(session: Session) -> Action:
    """Let the recorder's disk be full, and start a new recording once there is space again.

    A limit on the size of files is set from outside while the recorder runs: no disk has to be
    filled, and writing fails in the same place as on a full one.
    """
    pid, folder = session.processes["recorder"].pid, session.folder
    session.wait(lambda: written(folder) > _SOME_MESSAGES, "a bag of the recorder")
    hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)[1]
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (written(folder) + _LEFT_ON_DISK, hard))
    yield
    with contextlib.suppress(ProcessLookupError):  # if the recorder has been restarted
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (hard, hard))
    before = set(folder.glob("bag*"))
    response = session.call("recorder/start", Trigger.Request())
    if response.success:
        session.wait(
            lambda: set(folder.glob("bag*")) != before and written(folder) > _SOME_MESSAGES,
            "a new bag",
        )
    elif "already" not in response.message:
        raise SessionError(f"the recorder does not start again: {response.message}")


def written(folder: Path) -> int:
    """Return the size of the bag in a folder that was written last [bytes]; 0 without one."""
    files = [file.stat() for file in folder.glob("bag*/*.mcap")]
    # Of the file being written, which may be smaller than earlier ones.
    return max(files, key=lambda file: file.st_mtime_ns).st_size if files else 0


def second_controller(session: Session) -> Action:
    """Run a second controller, which drives the same robot to another goal."""
    rival = session.processes.add("rival", session.processes["controller"].command, append=True)
    names = ["-r", "__node:=rival", "-r", "goal_pose:=rival_goal"]
    try:
        rival.start(*session.arguments("controller"), *names)
        with session.publisher(PoseStamped, "rival_goal", 1) as publisher:
            if not publisher.get_subscription_count():
                raise SessionError("the second controller does not start")
            publisher.publish(pose_to_ros(random_goal(session.rng), 0, RADIUS))
            yield
    finally:
        session.processes.stop("rival")  # with SIGINT first: it commands its rotors to rest


def bad_start(session: Session) -> Action:
    """Start the controller with invalid parameters, each of which it has to name, then again."""
    controller = session.processes["controller"]
    controller.stop()
    try:
        for wrong in _WRONG_AT_START:
            before = len(controller.output)
            controller.start(*session.arguments("controller"), "-p", wrong)
            session.wait(lambda: controller.code is not None, f"the end with {wrong}")
            output = controller.output[before:]
            name = wrong.partition(":")[0]
            if controller.code != InvalidParameterError.exit_code or name not in output:
                raise SessionError(f"{controller.ending} with {wrong}, output: {output.strip()}")
            session.reports.messages.append(output)
        yield
    finally:
        session.start("controller")


def bad_live(session: Session) -> Action:
    """Set invalid parameters while the nodes run, each of which they have to refuse."""
    for node, name, value in _WRONG_LIVE:
        (result,) = session.set_parameters(node, **{name: value})
        if result.successful or not result.reason:
            raise SessionError(f"{node} did not refuse {name} = {value!r} with a reason")
        session.reports.messages.append(f"refused live: {result.reason}")
    yield


def new_obstacle(session: Session) -> Action:
    """Put an obstacle across the way to the goal by a map, then send bad maps; in the end no map.

    It may cover the goal, which can be reached again when the map has gone.
    """
    judge = session.judge
    if judge.state is None or judge.run is None:
        raise SessionError("there is no pose of the sphere, or no goal")
    place = judge.state[POSITION]
    way = judge.run.goal[POSITION] - place
    length = float(np.linalg.norm(way))
    ahead = way / length if length > 0.0 else np.array([1.0, 0.0])
    obstacle = place + max(_OBSTACLE_AHEAD, 0.5 * length) * ahead
    rng = source(session)
    with session.publisher(OccupancyGrid, "map", LATCHED) as publisher:
        publisher.publish(map_message(obstacle))
        yield every(0.5, lambda: publisher.publish(bad_map(rng)), at_once=False)
    session.without_map()


def push(session: Session, impulse: float) -> Action:
    """Push the sphere in a random direction with an impulse [N s]; the momentum stays."""
    angle = session.rng.uniform(-math.pi, math.pi)
    with session.publisher(Vector3, "simulator/push") as publisher:
        publisher.publish(Vector3(x=impulse * math.cos(angle), y=impulse * math.sin(angle)))
        yield


def tilt(session: Session, slope: float) -> Action:
    """Tilt the floor by `slope` [rad] in a random direction; the momentum stays."""
    angle = session.rng.uniform(-math.pi, math.pi)
    session.require_parameters("simulator", slope=slope, slope_direction=angle)
    yield
    session.require_parameters("simulator", slope=0.0, slope_direction=0.0)

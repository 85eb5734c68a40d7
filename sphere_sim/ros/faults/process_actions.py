# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of processes: killed, stopped, starved, duplicated, without disk space."""

import contextlib
import resource
import signal
import subprocess
import sys
import threading
import time

from geometry_msgs.msg import PoseStamped

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_sim.ros.faults.action import Action
from sphere_sim.ros.faults.fault_session import RADIUS, READY, FaultSession, SessionError
from sphere_sim.ros.faults.goal_actions import random_goal
from sphere_sim.ros.session.child_process import ChildProcess

_SLICE = 0.1
"""Period of the throttling [s], that of Linux's processor quotas."""
_WRONG_PARAMETERS = InvalidParameterError.exit_code
"""Exit code of a node that is started with wrong parameters."""
_LEFT_ON_DISK = 1000
"""Space that is left before the disk is full [bytes]."""


class NodeAction(Action):
    """Something that is done to one node.

    Parameters
    ----------
    node : str
        Name of the node.
    """

    def __init__(self, node: str) -> None:
        self._node = node


class Kill(NodeAction):
    """SIGKILL to a node, which is started again at the end; parameters as for `NodeAction`."""

    def begin(self, session: FaultSession) -> None:
        """Kill it; a recorder once it has written, as it may lose its last second."""
        process = session.processes[self._node]
        if self._node == "recorder":
            before = _written(session)
            session.wait(lambda: _written(session) > before, READY, "the recorder to write")
        process.kill()
        session.monitor.messages.append(process.ending)

    def end(self, session: FaultSession) -> None:
        """Start it again."""
        if self._node == "simulator":
            session.monitor.limits.restart()
        session.start(self._node)


class Stop(NodeAction):
    """SIGSTOP to a node, and SIGCONT at the end; parameters as for `NodeAction`."""

    def begin(self, session: FaultSession) -> None:
        """Stop it."""
        session.processes[self._node].send(signal.SIGSTOP)

    def end(self, session: FaultSession) -> None:
        """Continue it."""
        session.processes[self._node].send(signal.SIGCONT)


class Throttle(Action):
    """Throttling of the controller: stopped most of the time, as by a processor quota.

    Parameters
    ----------
    share : float
        Share of the time in which it runs.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self._over = threading.Event()

    def begin(self, session: FaultSession) -> None:
        """Start the thread that stops and continues it."""
        self._thread = threading.Thread(
            target=self._throttle, args=(session.processes["controller"],), daemon=True
        )
        self._thread.start()

    def end(self, session: FaultSession) -> None:
        """End the thread; the controller runs again."""
        self._over.set()
        self._thread.join()

    def _throttle(self, process: ChildProcess) -> None:
        while not self._over.is_set():
            process.send(signal.SIGSTOP)
            time.sleep((1.0 - self._share) * _SLICE)
            process.send(signal.SIGCONT)
            time.sleep(self._share * _SLICE)


class Hogs(Action):
    """Other processes that take all of the processor time that they get.

    Parameters
    ----------
    number : int
        Number of processes.
    """

    def __init__(self, number: int) -> None:
        self._number = number
        self._hogs: list[subprocess.Popen[bytes]] = []

    def begin(self, session: FaultSession) -> None:
        """Start them."""
        # In the session of the campaign, whose share of the processor they have together. If the
        # campaign is killed, they end by themselves.
        for _ in range(self._number):
            self._hogs.append(subprocess.Popen([sys.executable, "-c", _HOG]))

    def end(self, session: FaultSession) -> None:
        """End them."""
        for hog in self._hogs:
            hog.kill()
            hog.wait()


_HOG = "import time\nend = time.time() + 30\nwhile time.time() < end: pass"


class DiskFull(Action):
    """Full disk: the recorder cannot write any more.

    A limit on the size of files is set from outside while the recorder runs: no disk has to be
    filled, and writing fails in the same place as on a full one.
    """

    def begin(self, session: FaultSession) -> None:
        """Set the limit a little above the size of the file."""
        self._pid = session.processes["recorder"].pid
        session.wait(lambda: _written(session) > 0, READY, "a bag of the recorder")
        limit = _written(session) + _LEFT_ON_DISK
        hard = resource.prlimit(self._pid, resource.RLIMIT_FSIZE)[1]
        resource.prlimit(self._pid, resource.RLIMIT_FSIZE, (limit, hard))

    def end(self, session: FaultSession) -> None:
        """Remove the limit, if the recorder has not been restarted."""
        with contextlib.suppress(ProcessLookupError):
            hard = resource.prlimit(self._pid, resource.RLIMIT_FSIZE)[1]
            resource.prlimit(self._pid, resource.RLIMIT_FSIZE, (hard, hard))


def _written(session: FaultSession) -> int:
    """Return the size of the bag that was written last [bytes]; 0 without one."""
    files = [file.stat() for file in session.settings.folder.glob("bag*/*.mcap")]
    # Of the file being written, which may be smaller than earlier ones.
    return max(files, key=lambda file: file.st_mtime_ns).st_size if files else 0


class SecondController(Action):
    """A second controller, which drives the same robot to another goal."""

    def begin(self, session: FaultSession) -> None:
        """Start it and send it a goal."""
        command = session.processes["controller"].command
        rival = session.processes.add("rival", command, append=True)
        names = ["-r", "__node:=rival", "-r", "goal_pose:=rival_goal"]
        self._publisher = session.node.create_publisher(PoseStamped, "rival_goal", 1)
        rival.start([*session.arguments("controller"), *names])
        subscribers = self._publisher.get_subscription_count
        session.wait(lambda: subscribers() > 0, READY, "the second controller")
        self._publisher.publish(pose_to_ros(random_goal(session.rng), 0, RADIUS))

    def end(self, session: FaultSession) -> None:
        """End it with SIGINT first, so that it commands its rotors to rest."""
        session.processes.stop("rival")
        session.node.destroy_publisher(self._publisher)


class BadStart(Action):
    """Starts of the controller with invalid parameters, then with valid ones."""

    _WRONG = (
        "sample_period:=-1.0", "strategy:=none", "robot.shell_mass:=0.0", "horizon:=2.5",
        "time_budget:=fast",
    )

    def begin(self, session: FaultSession) -> None:
        """Start the controller with each; it has to end by itself and name the parameter."""
        controller = session.processes["controller"]
        controller.stop()
        for wrong in self._WRONG:
            before = controller.log.stat().st_size
            controller.start([*session.arguments("controller"), "-p", wrong])
            session.wait(lambda: controller.code is not None, READY, f"the end with {wrong}")
            output = controller.log.read_bytes()[before:].decode(errors="replace")
            if controller.code != _WRONG_PARAMETERS or wrong.partition(":")[0] not in output:
                raise SessionError(f"{controller.ending} with {wrong}, output: {output.strip()}")
            session.monitor.messages.append(output)

    def end(self, session: FaultSession) -> None:
        """Start it with valid parameters."""
        session.start("controller")

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of processes: killed, starved, doubled, without a disk, started wrongly."""

import contextlib
import resource
import signal
import subprocess
import sys
import threading
import time

from geometry_msgs.msg import PoseStamped

from sphere_nmpc.ros.conversions import pose_to_ros
from sphere_sim.ros.faults.on_goals import random_goal
from sphere_sim.ros.faults.session import RADIUS, READY, FaultSession, SessionError
from sphere_sim.ros.session.processes import NodeProcess

_SLICE = 0.1
"""Period in which a starved process gets its share of time [s], that of Linux's quotas."""
_LEFT_ON_DISK = 1000
"""What the disk takes before it is full [bytes]."""


class Kill:
    """A node is killed as ``kill -9`` does and started again at the end.

    Parameters
    ----------
    node : str
        Which.
    """

    def __init__(self, node: str) -> None:
        self._node = node

    def begin(self, session: FaultSession) -> None:
        """Kill it."""
        session.monitor.said.append(session.processes[self._node].kill())

    def keep_on(self, session: FaultSession) -> None:
        """Wait."""

    def end(self, session: FaultSession) -> None:
        """Start it again."""
        if self._node == "simulator":
            session.monitor.limits.forget()
        session.start(self._node)


class Throttle:
    """The controller is held most of the time, as a quota of processor time does.

    Parameters
    ----------
    share : float
        Of the time that it may run.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self._over = threading.Event()

    def begin(self, session: FaultSession) -> None:
        """Start to hold it."""
        self._thread = threading.Thread(
            target=self._hold, args=(session.processes["controller"],), daemon=True
        )
        self._thread.start()

    def keep_on(self, session: FaultSession) -> None:
        """Leave it to the thread."""

    def end(self, session: FaultSession) -> None:
        """Let it run."""
        self._over.set()
        self._thread.join()

    def _hold(self, process: NodeProcess) -> None:
        while not self._over.is_set():
            process.send(signal.SIGSTOP)
            time.sleep((1.0 - self._share) * _SLICE)
            process.send(signal.SIGCONT)
            time.sleep(self._share * _SLICE)


class Hogs:
    """Other processes want all of the processor.

    Parameters
    ----------
    number : int
        How many.
    """

    def __init__(self, number: int) -> None:
        self._number = number

    def begin(self, session: FaultSession) -> None:
        """Start them."""
        self._hogs = [
            # Should the campaign die, they end by themselves.
            subprocess.Popen([sys.executable, "-c", _HOG]) for _ in range(self._number)
        ]

    def keep_on(self, session: FaultSession) -> None:
        """Let them work."""

    def end(self, session: FaultSession) -> None:
        """End them."""
        for hog in self._hogs:
            hog.kill()
            hog.wait()


_HOG = "import time\nend = time.time() + 30\nwhile time.time() < end: pass"


class DiskFull:
    """The kernel takes no more of what the recorder writes.

    The limit is one on the size of files, set from outside while the recorder runs: no disk
    has to be filled, and writing fails in the same place as on a full one.
    """

    def begin(self, session: FaultSession) -> None:
        """Set the limit a little above what is written."""
        self._pid = session.processes["recorder"].pid
        folder = session.settings.folder
        files = [file.stat() for file in folder.glob("bag*/*.mcap")]
        # The one that is being written, which may be smaller than earlier ones.
        written = max(files, key=lambda file: file.st_mtime_ns).st_size
        hard = resource.prlimit(self._pid, resource.RLIMIT_FSIZE)[1]
        resource.prlimit(self._pid, resource.RLIMIT_FSIZE, (written + _LEFT_ON_DISK, hard))

    def keep_on(self, session: FaultSession) -> None:
        """Wait."""

    def end(self, session: FaultSession) -> None:
        """Take the limit away, from the recorder that is still the same."""
        with contextlib.suppress(ProcessLookupError):
            hard = resource.prlimit(self._pid, resource.RLIMIT_FSIZE)[1]
            resource.prlimit(self._pid, resource.RLIMIT_FSIZE, (hard, hard))


class Rival:
    """A second controller drives the same robot to a goal of its own."""

    def begin(self, session: FaultSession) -> None:
        """Start it and send it off."""
        process = session.processes["controller"]
        self._rival = NodeProcess("rival", process.command, session.settings.folder)
        session.processes["rival"] = self._rival
        names = ["-r", "__node:=rival", "-r", "goal_pose:=rival_goal"]
        self._rival.start([*session.arguments("controller"), *names])
        publisher = session.node.create_publisher(PoseStamped, "rival_goal", 1)
        listening = publisher.get_subscription_count
        session.wait(lambda: listening() > 0, READY, "the second controller")
        publisher.publish(pose_to_ros(random_goal(session.rng), 0, RADIUS))
        self._publisher = publisher

    def keep_on(self, session: FaultSession) -> None:
        """Let them fight."""

    def end(self, session: FaultSession) -> None:
        """End it, politely: its last words are those of a controller in force."""
        self._rival.stop()
        del session.processes["rival"]
        session.node.destroy_publisher(self._publisher)


class BadStart:
    """The controller is started with parameters that it cannot have, then with good ones."""

    _WRONG = (
        "sample_period:=-1.0", "strategy:=none", "robot.shell_mass:=0.0", "horizon:=2.5",
        "control_rate:=fast",
    )

    def begin(self, session: FaultSession) -> None:
        """Start it wrongly; it has to end by itself and say why."""
        controller = session.processes["controller"]
        controller.stop()
        for wrong in self._WRONG:
            before = controller.log.stat().st_size
            controller.start([*session.arguments("controller"), "-p", wrong])
            session.wait(lambda: controller.code is not None, READY, f"the end with {wrong}")
            told = controller.log.read_bytes()[before:].decode(errors="replace")
            if controller.code != 1 or wrong.partition(":")[0] not in told:
                raise SessionError(f"{controller.wait(1.0)} with {wrong}, saying: {told.strip()}")
            session.monitor.said.append(told)

    def keep_on(self, session: FaultSession) -> None:
        """Wait."""

    def end(self, session: FaultSession) -> None:
        """Start it as it should be."""
        session.start("controller")

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The viewer node: shows what the topics say, and sends what the user asks for.

subscribes  pose, joint_states, controller/active_goal, controller/predicted_path,
            controller/status, /diagnostics
publishes   goal_pose
calls       simulator/pause, simulator/reset, simulator/push and parameters, where they are there
"""

import time
from collections.abc import Sequence

from rclpy.executors import Executor

from sphere_nmpc.ros.lifetime import RunnableNode, run
from sphere_nmpc.ros.scheduling import lower_priority
from sphere_sim.ros.viewer.topic_source import TopicSource
from sphere_sim.viewer.server import announce
from sphere_sim.viewer.viewer import FRAME_PERIOD, Viewer

_MOST_CALLBACKS = 40
"""Of one frame; what is left waits for the next."""


class ViewerNode(RunnableNode):
    """Show frames from topics at a steady rate.

    Parameters
    ----------
    port : int
        Where the page is served on this machine; a free port if it is taken.
    """

    def __init__(self, port: int) -> None:
        super().__init__("viewer")
        self._source = TopicSource(self)
        self._viewer = Viewer(self._source, port, live=True)
        self._due = time.monotonic()
        # Not in the node's log, which goes to /rosout and so to everybody.
        announce(self._viewer.url)

    def work(self, executor: Executor) -> None:
        """Sleep until the next frame is due, look at what has come, and show it.

        Between two frames the middleware keeps the newest message of each topic, so that the
        viewer's work does not grow with the robot's rates.
        """
        wait = self._due - time.monotonic()
        if wait > 0.0:
            time.sleep(wait)
        self._due = max(self._due + FRAME_PERIOD, time.monotonic())
        for _ in range(_MOST_CALLBACKS):
            before = self._source.inputs.heard
            executor.spin_once(timeout_sec=0.0)
            if self._source.inputs.heard == before:
                break
        self._viewer.tick()

    def finish(self) -> None:
        """Close the page."""
        self._viewer.close()


def main(args: Sequence[str] | None, port: int) -> int:
    """Run the node; see `sphere_nmpc.ros.lifetime.run`."""
    lower_priority()
    return run(lambda: ViewerNode(port), args, __doc__ or "")

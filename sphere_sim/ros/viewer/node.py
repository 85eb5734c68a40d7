# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Viewer node: shows the topics of a robot in the browser, and sends the requests of users.

subscribes  pose, joint_states, controller/active_goal, controller/predicted_path,
            controller/status, /diagnostics
publishes   goal_pose, simulator/push
calls       simulator/pause, simulator/reset and parameters, where available
"""

import time
from collections.abc import Sequence

from rclpy.executors import Executor

from sphere_nmpc.ros.lifetime import RunnableNode, lower_priority, run
from sphere_nmpc.ros.settings import FrameSettings
from sphere_sim.ros.viewer.topic_source import TopicSource
from sphere_sim.viewer.server import announce
from sphere_sim.viewer.viewer import FRAME_PERIOD, Viewer

_MOST_CALLBACKS = 40
"""Most callbacks between two frames."""


class ViewerNode(RunnableNode):
    """Node that shows frames of live topics at a constant rate.

    Parameters
    ----------
    port : int
        Port of the page on this machine; a free port is used if it is taken.
    """

    def __init__(self, port: int) -> None:
        super().__init__("viewer")
        frame = self.parameters.declare(FrameSettings()).settings.world_frame
        self.parameters.warn_of_unknown()
        self._source = TopicSource(self, frame)
        self._viewer = Viewer(self._source, port, live=True)
        self._due = time.monotonic()
        # Not logged: every node can read /rosout, and the address holds the access token.
        announce(self._viewer.url)

    def work(self, executor: Executor) -> None:
        """Wait until the next frame is due, receive the newest messages, and show the frame.

        Between two frames the middleware keeps the newest message of each topic only, so that the
        load does not depend on the robot's rates.
        """
        wait = self._due - time.monotonic()
        if wait > 0.0:
            time.sleep(wait)
        self._due = max(self._due + FRAME_PERIOD, time.monotonic())
        for _ in range(_MOST_CALLBACKS):
            before = self._source.subscriptions.message_count
            executor.spin_once(timeout_sec=0.0)
            if self._source.subscriptions.message_count == before:
                break
        self._viewer.tick()

    def finish(self) -> None:
        """Close the page."""
        self._viewer.close()


def main(args: Sequence[str] | None, port: int) -> int:
    """Run the node; see `sphere_nmpc.ros.lifetime.run`."""
    lower_priority()
    return run(lambda: ViewerNode(port), args, __doc__ or "")

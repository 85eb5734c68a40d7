# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Viewer node: shows the topics of a robot in the browser, and sends the requests of users.

subscribes  pose, ground_truth/pose, joint_states, controller/active_goal,
            controller/path, controller/predicted_path, controller/floor, controller/status,
            /diagnostics
publishes   goal_pose, goal_point, path, simulator/push
calls       controller/enable, controller/cancel, simulator/pause, simulator/reset and parameters,
            where available
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped, Vector3
from nav_msgs.msg import Path
from rclpy.executors import Executor
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.control.goal_client import Ending, NavigatorSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantities import quantities
from sphere_nmpc.ros.cdr import WORLD_FRAME
from sphere_nmpc.ros.goal_link import GoalLink, GoalMessage
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.lifetime import lower_priority, run
from sphere_nmpc.ros.settings import FrameSettings
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.recording.run import setup_text
from sphere_sim.ros.session.goal_messages import path_message, point_message, pose_message
from sphere_sim.ros.simulator.settings import SimulatorNodeSettings
from sphere_sim.ros.viewer.remote_parameter import RemoteParameter
from sphere_sim.ros.viewer.robot_subscriptions import RobotSubscriptions
from sphere_sim.viewer.server import announce
from sphere_sim.viewer.source import (
    ApplyPush,
    Cancel,
    Capabilities,
    Enable,
    Frame,
    Pause,
    Request,
    Reset,
    SetGoal,
    SetPath,
    SetPoint,
    SetSpeed,
    SetStrategy,
)
from sphere_sim.viewer.viewer import FRAME_PERIOD, Viewer

_MOST_CALLBACKS = 40
"""Most callbacks between two frames."""


_ROBOT = tuple(quantities(RobotParameters))
"""Parameters of the controller's robot, of which plots and pushes need the drives."""


class TopicSource:
    """`Source` of frames of a robot; it sends requests without waiting for the answers."""

    def __init__(self, node: Node, frame: str = WORLD_FRAME) -> None:
        self.subscriptions = RobotSubscriptions(node, frame)
        """Subscriptions to the robot's topics."""
        self._enable = node.create_client(SetBool, "controller/enable")
        self._cancel = node.create_client(Trigger, "controller/cancel")
        self._pause = node.create_client(SetBool, "simulator/pause")
        self._reset = node.create_client(Trigger, "simulator/reset")
        self._pushes = node.create_publisher(Vector3, "simulator/push", 10)
        self._notices: list[str] = []
        notify = self._notices.append
        self._link = GoalLink(
            node, (PoseStamped, PointStamped, Path), NavigatorSettings(), self._take_ending
        )
        self._speed = RemoteParameter(
            node, "simulator", "real_time_factor", SimulatorNodeSettings, notify, ["plant"]
        )
        self._strategy = RemoteParameter(
            node, "controller", "strategy", ControllerSettings, notify,
            [f"robot.{name}" for name in _ROBOT],
        )

    def frames(self) -> Sequence[Frame]:
        """Return the newest frame."""
        self._link.update()
        self._speed.refresh()
        self._strategy.refresh()
        frame, robot = self.subscriptions.newest(), self._robot()
        notices = tuple(self._notices)
        self._notices.clear()
        # The parameter is newer than the status, which is not published while time is paused.
        strategy = self._strategy.value if self._strategy.writable else frame.strategy
        setup = setup_text(
            strategy, math.nan if frame.state is None else frame.radius,
            math.nan if robot is None else robot.max_rotor_speed, self._plant(),
        )
        return [replace(
            frame, strategy=strategy, setup=setup, robot=robot or RobotParameters(),
            capabilities=self._capabilities(), notices=notices,
        )]

    def handle(self, request: Request) -> str:
        """Publish the goal or push, call the service or set the parameter of a request."""
        if isinstance(request, SetGoal):
            return self._send(pose_message(request.goal))
        if isinstance(request, SetPoint):
            return self._send(point_message(request.position))
        if isinstance(request, SetPath):
            return self._send(path_message(np.array(request.places)))
        if isinstance(request, Enable):
            return self._call(self._enable, SetBool.Request(data=request.enabled))
        if isinstance(request, Cancel):
            self._link.client.abandon("")  # not sent again after that
            return self._call(self._cancel, Trigger.Request())
        if isinstance(request, Pause):
            return self._call(self._pause, SetBool.Request(data=request.paused))
        if isinstance(request, Reset):
            return self._call(self._reset, Trigger.Request())
        if isinstance(request, ApplyPush):
            x, y = request.impulse
            self._pushes.publish(Vector3(x=x, y=y))
        elif isinstance(request, SetSpeed) and self._speed.writable:
            self._speed.set(float(request.factor))
        elif isinstance(request, SetStrategy) and self._strategy.writable:
            self._strategy.set(request.name)
        return ""

    def _send(self, message: GoalMessage) -> str:
        publisher = self._link.publishers[type(message)]
        if publisher.get_subscription_count() == 0:
            return f"{publisher.topic_name} has no subscriber: is a controller running?"
        self._link.begin("", [message], until_taken=True)
        return ""

    def _take_ending(self, ending: Ending) -> None:
        if ending.reason.endswith("its log says more"):
            self._notices.append(ending.reason)

    def _call(self, client: Any, request: Any) -> str:
        if not client.service_is_ready():
            return f"service {client.srv_name} is not available"
        client.call_async(request).add_done_callback(self._take_answer)
        return ""

    def _take_answer(self, future: Any) -> None:
        answer = future.result()
        if answer is not None and not answer.success:
            self._notices.append(answer.message)

    def _plant(self) -> str:
        """Return the plant that is simulated; empty while it is unknown."""
        known = self._speed.value is not None and self._speed.others
        return str(self._speed.others[0]) if known else ""

    def _robot(self) -> RobotParameters | None:
        """Return the controller's robot; None while it is unknown or not valid."""
        try:
            return RobotParameters(**dict(zip(_ROBOT, self._strategy.others, strict=True)))
        except ValueError:  # not valid, or one is missing
            return None

    def _capabilities(self) -> Capabilities:
        speed, strategy = self._speed, self._strategy
        return Capabilities(
            pause=self._pause.service_is_ready(),
            reset=self._reset.service_is_ready(),
            push=self._pushes.get_subscription_count() > 0,
            stop=self._enable.service_is_ready() and self._cancel.service_is_ready(),
            paused=self.subscriptions.live.paused,
            speed=float(speed.value) if speed.writable else None,
            strategies=strategy.choices if strategy.writable else (),
        )


class ViewerNode(GuardedNode):
    """Node that shows frames of live topics at a constant rate, at `port` or another free one."""

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
        without = 0
        for _ in range(_MOST_CALLBACKS):
            before = self._source.subscriptions.message_count
            executor.spin_once(timeout_sec=0.0)
            without = without + 1 if self._source.subscriptions.message_count == before else 0
            # Between two messages of one topic the executor may serve something else.
            if without == 2:
                break
        self._viewer.tick()

    def finish(self) -> None:
        """Close the page."""
        self._viewer.close()


def main(args: Sequence[str] | None, port: int) -> int:
    """Run the node; see `sphere_nmpc.ros.lifetime.run`."""
    lower_priority()
    return run(lambda: ViewerNode(port), args, __doc__ or "")

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The graph as a source of frames, and where the viewer's requests go."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.ros.conversions import pose_to_ros
from sphere_sim.ros.viewer.inputs import ViewerInputs
from sphere_sim.ros.viewer.remote_parameter import RemoteParameter
from sphere_sim.viewer.frame import (
    Frame,
    Offers,
    Pause,
    Push,
    Request,
    Reset,
    SetGoal,
    SetSpeed,
    SetStrategy,
)


class TopicSource:
    """A `Source` of frames from topics; asks for what the user wants, and waits for no answer.

    Parameters
    ----------
    node : Node
        Owner of subscriptions, publisher and clients; the robot is in its namespace.
    """

    def __init__(self, node: Node) -> None:
        self.inputs = ViewerInputs(node)
        """What is heard."""
        self._goals = node.create_publisher(PoseStamped, "goal_pose", 1)
        self._pause = node.create_client(SetBool, "simulator/pause")
        self._reset = node.create_client(Trigger, "simulator/reset")
        self._push = node.create_client(Trigger, "simulator/push")
        self._news: list[str] = []
        told = self._news.append
        self._speed = RemoteParameter(node, "simulator", "real_time_factor", told)
        self._strategy = RemoteParameter(node, "controller", "strategy", told)

    def frames(self) -> Sequence[Frame]:
        """Return the one frame there is: the newest."""
        self._speed.refresh()
        self._strategy.refresh()
        frame = replace(
            self.inputs.newest(), offers=self._offers(), news=tuple(self._news)
        )
        self._news.clear()
        # What was chosen counts at once; while time stands still no status tells.
        chosen = self._strategy.value if self._strategy.writable else frame.strategy
        return [replace(frame, strategy=chosen)]

    def handle(self, request: Request) -> str:
        """Publish the goal, call the service or set the parameter that is asked for."""
        if isinstance(request, SetGoal):
            return self._send_goal(request)
        if isinstance(request, Pause):
            return self._call(self._pause, SetBool.Request(data=request.paused))
        if isinstance(request, Reset):
            return self._call(self._reset, Trigger.Request())
        if isinstance(request, Push):
            return self._call(self._push, Trigger.Request())
        if isinstance(request, SetSpeed) and self._speed.writable:
            self._speed.set(float(request.factor))
        elif isinstance(request, SetStrategy) and self._strategy.writable:
            self._strategy.set(request.name)
        return ""

    def _send_goal(self, request: SetGoal) -> str:
        if self._goals.get_subscription_count() == 0:
            return "nobody listens to goal_pose: is a controller running?"
        # Stamp 0 means now; the controller looks at frame and pose only.
        self._goals.publish(pose_to_ros(request.goal, 0, self.inputs.frame.radius))
        return ""

    def _call(self, client: Any, request: Any) -> str:
        if not client.service_is_ready():
            return f"{client.srv_name} is not there"
        client.call_async(request).add_done_callback(self._take_answer)
        return ""

    def _take_answer(self, future: Any) -> None:
        answer = future.result()
        if answer is not None and not answer.success:
            self._news.append(answer.message)

    def _offers(self) -> Offers:
        speed, strategy = self._speed, self._strategy
        return Offers(
            goal=True,
            pause=self._pause.service_is_ready(),
            reset=self._reset.service_is_ready(),
            push=self._push.service_is_ready(),
            paused=self.inputs.stands_still,
            speed=float(speed.value) if speed.writable else None,
            strategies=strategy.choices if strategy.writable else (),
        )

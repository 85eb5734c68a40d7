# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Topic and service that push the simulated sphere, and the topic of the pushes that it got."""

from collections.abc import Callable

from geometry_msgs.msg import Vector3, Vector3Stamped
from rclpy.node import Node
from std_srvs.srv import Trigger

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.ros.messages import stamp_to_ros
from sphere_sim.ros.simulator.settings import PushSettings
from sphere_sim.world.simulator import Simulator


class PushReceiver:
    """Subscriber of ``~/push`` and server of the service of that name.

    Parameters
    ----------
    node : Node
        Node of subscription, service and publisher.
    simulator : Simulator
        Simulator whose plant is pushed.
    fault_log, event_log : FaultLog
        Logs of refused pushes and of the others.
    settings : callable
        Returns the present settings, which have the impulse of the service.
    epoch : callable
        Returns the stamp [ns] of simulated time 0.
    frame : str
        Frame of the impulses.
    """

    def __init__(
        self,
        node: Node,
        simulator: Simulator,
        fault_log: FaultLog,
        event_log: FaultLog,
        settings: Callable[[], PushSettings],
        epoch: Callable[[], int],
        frame: str,
    ) -> None:
        self._simulator = simulator
        self._fault_log = fault_log
        self._event_log = event_log
        self._settings = settings
        self._epoch = epoch
        self._frame = frame
        self._pushed = node.create_publisher(Vector3Stamped, "~/pushed", 10)
        self._pushes = node.create_subscription(Vector3, "~/push", self._receive, 10)
        self._service = node.create_service(Trigger, "~/push", self._serve)

    def _receive(self, message: Vector3) -> None:
        given = [message.x, message.y, message.z]
        try:
            settings = PushSettings(push_impulse=(message.x, message.y))
            if message.z != 0.0:
                raise InvalidParameterError("z", message.z, "z = 0: a horizontal push")
        except InvalidParameterError as error:
            self._fault_log.report("push refused", f"given {given}, expected {error.expected}")
            return
        self._push(settings)

    def _serve(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        response.message = f"pushed with {self._push(self._settings())}"
        return response

    def _push(self, settings: PushSettings) -> str:
        """Push the sphere, and return impulse and time as text."""
        x, y = settings.push_impulse
        self._simulator.plant.push((x, y))
        message = Vector3Stamped(vector=Vector3(x=x, y=y))
        message.header.frame_id = self._frame
        message.header.stamp = stamp_to_ros(self._epoch() + self._simulator.now)
        self._pushed.publish(message)
        done = f"{[x, y]} N s at t = {self._simulator.time:.3f} s"
        self._event_log.report("push", done)
        return done

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Action server whose goals end by a call, not with the return of a callback."""

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from sphere_nmpc.control.goal_client import Outcome
from sphere_nmpc.ros.guarded_node import GuardedNode


class GoalServer(ActionServer):
    """Action server of a node, on a relative name.

    rclpy expects a callback that returns at the end of the goal. One that waits would block a
    single-threaded executor, and as a coroutine it is tried again at each turn of the executor,
    which then never sleeps. So there is none; `finish` hands over the result.

    Parameters
    ----------
    node : GuardedNode
        Its executor serves the goals.
    kind : type
        Type of the action.
    name : str
        Name of the action.
    check : callable
        Raises an error for a goal that is to be rejected.
    begin : callable
        Called with this server and the handle of a goal that was accepted.
    cancel : callable
        Called with the handle of a goal that is to be cancelled; returns whether it will be.
    """

    def __init__(
        self,
        node: GuardedNode,
        kind: Any,
        name: str,
        check: Callable[[Any], object],
        begin: Callable[["GoalServer", ServerGoalHandle], object],
        cancel: Callable[[ServerGoalHandle], bool],
    ) -> None:
        def checked(request: Any) -> GoalResponse:
            try:
                check(request)
            except Exception as error:  # rclpy would lose other requests with it
                node.report(f"{name} rejected", error)
                return GoalResponse.REJECT
            return GoalResponse.ACCEPT

        def accepted(handle: ServerGoalHandle) -> None:
            handle.execute()
            begin(self, handle)

        guarded_cancel = node.guarded(f"{name} failed", cancel)

        def cancelled(handle: ServerGoalHandle) -> CancelResponse:
            return CancelResponse.ACCEPT if guarded_cancel(handle) else CancelResponse.REJECT

        super().__init__(
            node, kind, name, _never, goal_callback=checked,
            handle_accepted_callback=node.guarded(f"{name} failed", accepted),
            cancel_callback=cancelled,
        )

    def notify_execute(
        self, goal_handle: ServerGoalHandle, execute_callback: Callable[..., Any] | None
    ) -> None:
        """Begin a goal, of which only the state changes."""

    def finish(self, handle: ServerGoalHandle, outcome: Outcome, result: Any) -> None:
        """End a goal, and send the result to those who ask for it."""
        endings = {
            Outcome.SUCCEEDED: handle.succeed, Outcome.CANCELED: handle.canceled,
            Outcome.ABORTED: handle.abort,
        }
        endings[outcome]()
        super().notify_execute(handle, lambda _: result)


def _never(handle: ServerGoalHandle) -> None:
    """Stand for the callback that rclpy demands."""

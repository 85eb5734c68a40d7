# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Contract between the control loop and what works beside it: tasks, replies, workers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

Result = TypeVar("Result")
Store = dict[str, Any]
"""Objects that tasks keep in the worker from one to the next."""
Task = Callable[[Store], Result]
"""Work to be done: a function or an object that can be pickled, called with the worker's store."""


@dataclass(eq=False)
class Reply(Generic[Result]):
    """Result of a task once it is `ready`, or why there will be none.

    An error is that the task was not taken or has raised, or that the worker has ended.
    """

    result: Result | None = None
    ready: bool = False
    error: str = ""

    @property
    def pending(self) -> bool:
        """Whether a result may still come."""
        return not self.ready and not self.error


class Worker(Protocol):
    """Executor of tasks, one after another, that the control loop does not wait for."""

    @property
    def available(self) -> bool:
        """Whether it takes tasks; not while its process cannot be started."""
        ...

    def submit(self, task: Task[Result]) -> Reply[Result]:
        """Queue a task and return its reply, which is refused at once where too many wait.

        Never blocks and never raises.
        """
        ...

    def poll(self) -> None:
        """Update the replies with the results that have arrived since the last call."""
        ...

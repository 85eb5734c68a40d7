# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Changes of something that takes long to make: made in a thread, each whole or not at all."""

import os
import threading
import time
from collections.abc import Callable, Hashable
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from sphere_nmpc.foreign.code import foreign_error

G = TypeVar("G")
G_co = TypeVar("G_co", covariant=True)


class Made(Protocol[G_co]):
    """What has been made, with what it has been made of."""

    @property
    def given(self) -> G_co:
        """What it has been made of."""


M = TypeVar("M", bound=Made[Any])


@dataclass(eq=False)
class Request(Generic[G]):
    """Change that is asked for: what it is of, and what is given after it."""

    name: str
    change: Callable[[G], G]
    """Returns what is given after it; called by the thread, and raises an error to refuse it."""
    since: float = field(default_factory=time.monotonic)
    """Steady time at which it was asked for [s], or one before it whose place it has taken."""
    answer: Future[Callable[[], object]] | None = None
    """Future of what puts it in force, where who asks for it decides on that."""


@dataclass
class _Outcome(Generic[M]):
    made: M
    refused: list[tuple[Request[Any], Exception]] = field(default_factory=list)


class ChangeQueue(Generic[G, M]):
    """Queue of changes, which are made in a thread one after the other or several together.

    What cannot be made is refused, and has no effect on those after it. A newer change with the
    same key takes the place of one that waits, so that the queue is no longer than there are keys,
    and all that wait are made together. `look` has to be called while it is busy; it and all other
    methods are for one thread, that of a node's executor.

    Parameters
    ----------
    in_force : Made
        What has been made at the start.
    make : callable
        Returns what is made of what is given, in the place of what is in force; called by the
        thread.
    use : callable
        Puts what has been made in force, given the time since it was asked for [s, wall]; what it
        refuses by an error has no effect either.
    refuse : callable
        Takes a request that is refused, and the error.
    """

    def __init__(
        self, in_force: M, make: Callable[[G, M], M], use: Callable[[M, float], object],
        refuse: Callable[[Request[G], Exception], object],
    ) -> None:
        self.in_force = in_force
        """What has been made of all changes up to now that were not refused."""
        self._make, self._use, self._refuse = make, use, refuse
        self._waiting: dict[Hashable, Request[G]] = {}
        self._making: list[Request[G]] = []
        self._job: Future[_Outcome[M]] | None = None

    def submit(self, key: Hashable, request: Request[G]) -> None:
        """Make a change, in the place of one with the same key that waits."""
        before = self._waiting.get(key)
        if before is not None:
            request.since = before.since
        self._waiting[key] = request
        self._begin()

    def prepare(
        self, request: Request[G], is_awaited: bool = False
    ) -> Future[Callable[[], object]]:
        """Make a change, and return a future of what puts it in force, or of the error.

        When that is done, the change has to be put in force at once or never. The future is done
        by `look`, or before this returns if `is_awaited`.
        """
        answer = request.answer = Future()
        self._waiting[request] = request
        self._begin()
        while is_awaited and self._job is not None and not answer.done():
            wait([self._job])
            self._end()
            if not answer.done():
                self._begin()
        return answer

    def look(self) -> bool:
        """Use what has been made, and go on with what waits; return whether there is more."""
        if self._job is not None and self._job.done():
            self._end()
        self._begin()
        return self._job is not None

    def oldest(self) -> Request[G] | None:
        """Return the oldest change that is not in force yet; None without any."""
        requests = [*self._making, *self._waiting.values()]
        return min(requests, key=lambda request: request.since, default=None)

    def close(self, reason: Exception) -> None:
        """Refuse what is not in force yet; the thread ends by itself, or with the process."""
        requests = [*self._making, *self._waiting.values()]
        self._making, self._waiting, self._job = [], {}, None
        for request in requests:
            if request.answer is not None:
                request.answer.set_exception(reason)

    def _begin(self) -> None:
        if self._job is not None or not self._waiting:
            return
        first = next(iter(self._waiting.values()))
        alone = first.answer is not None
        self._making = [
            request for request in self._waiting.values()
            if (request is first if alone else request.answer is None)
        ]
        self._waiting = {
            key: request for key, request in self._waiting.items() if request not in self._making
        }
        job = self._job = Future()
        # Not of a pool, which the interpreter would wait for at its end.
        thread = threading.Thread(
            target=self._run, args=(job, self.in_force, self._making), name="floor", daemon=True
        )
        try:
            thread.start()
        except Exception as error:  # the system has none left
            job.set_exception(error)

    def _end(self) -> None:
        """Put in force what has been made, and refuse what has not."""
        job, requests = self._job, self._making
        self._job, self._making = None, []
        if job is None:
            return
        failure = job.exception()
        if failure is not None:
            for request in requests:
                self._refused(request, foreign_error(failure))
            return
        outcome = job.result()
        for request, error in outcome.refused:
            self._refused(request, error)
        refused = [request for request, _ in outcome.refused]
        accepted = [request for request in requests if request not in refused]
        if not accepted:
            return
        answer = accepted[0].answer
        if answer is not None:
            answer.set_result(partial(self._put, outcome.made, accepted[0].since))
            return
        try:
            self._put(outcome.made, min(request.since for request in accepted))
        except Exception as error:
            for request in accepted:
                self._refused(request, error)

    def _put(self, made: M, since: float) -> None:
        self._use(made, time.monotonic() - since)
        self.in_force = made

    def _refused(self, request: Request[G], error: Exception) -> None:
        if request.answer is not None:
            request.answer.set_exception(error)
        else:
            self._refuse(request, error)

    def _run(self, job: Future[_Outcome[M]], in_force: M, requests: list[Request[G]]) -> None:
        # A thread begins with the priority of the one that starts it, which may be that of a
        # control loop in real time.
        with suppress(AttributeError, OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        try:
            job.set_result(self._outcome(in_force, requests))
        except BaseException as error:
            job.set_exception(error)

    def _outcome(self, in_force: M, requests: list[Request[G]]) -> _Outcome[M]:
        """Return what is made of changes; of those that cannot be made together, one by one."""
        given, outcome, possible = in_force.given, _Outcome(in_force), []
        for request in requests:
            try:
                given = request.change(given)
            except BaseException as error:
                outcome.refused.append((request, foreign_error(error)))
            else:
                possible.append(request)
        if not possible:
            return outcome
        try:
            outcome.made = self._make(given, in_force)
        except BaseException as error:
            if len(possible) == 1:
                outcome.refused.append((possible[0], foreign_error(error)))
                return outcome
            for request in possible:
                after = self._outcome(outcome.made, [request])
                outcome.made = after.made
                outcome.refused += after.refused
        return outcome

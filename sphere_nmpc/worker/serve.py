# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Program of the worker process: does the tasks that arrive until its channel is closed.

It is started by `sphere_nmpc.worker.process`.
"""

import contextlib
import gc
import os
import signal
from functools import partial
from importlib import import_module
from typing import NoReturn

from sphere_nmpc.foreign.code import called
from sphere_nmpc.process.channel import Channel, ChannelEndError, ContentError, encoded
from sphere_nmpc.process.child import END_SIGNALS, NICENESS
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_nmpc.worker.contract import Store

_USED = ("sphere_nmpc.strategy.time_optimal.search_task", "sphere_nmpc.estimation.estimator")
"""Modules of the tasks, loaded before the first of them arrives."""


def serve(channel: Channel) -> None:
    """Do the tasks that arrive; each is answered by its result and an error, empty if none."""
    store: Store = {}
    with contextlib.suppress(ChannelEndError):
        while True:
            try:
                task = channel.receive()
            except ContentError as error:  # as a module that it needs cannot be imported
                task = partial(_failed, error)
            try:
                answer = encoded((called(task, store), ""))
            except Exception as raised:
                # One failed task must not prevent the next ones.
                answer = encoded((None, f"{type(raised).__name__}: {raised}"))
            channel.send(answer)


def _failed(error: Exception, store: Store) -> NoReturn:
    raise error


def main(argv: list[str]) -> int:
    """Serve the channel whose file descriptor is the only argument."""
    # It ends with its owner, which may still need it after a signal to both.
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    # A control loop with a real-time priority passes it on to the processes that it starts.
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    limit_library_threads()
    for name in _USED:
        import_module(name)
    gc.freeze()
    serve(Channel.inherited(int(argv[0])))
    return 0

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Background tasks are done in order, and dropped where the queue is full."""

import threading

from sphere_nmpc.ros.controller.background import Background


def test_tasks_are_done_in_order_and_errors_are_reported() -> None:
    done: list[int] = []
    errors: list[str] = []

    def fail() -> None:
        raise ValueError("no")

    background = Background(errors.append)
    assert background.do(lambda: done.append(1))
    background.close()
    background = Background(errors.append)
    assert background.do(fail)
    assert background.do(lambda: done.append(2))
    background.close()
    assert done == [1, 2]
    assert errors == ["ValueError: no"]


def test_tasks_are_dropped_while_the_queue_is_full() -> None:
    release, began = threading.Event(), threading.Event()
    done: list[int] = []

    def long() -> None:
        began.set()
        release.wait()

    background = Background(print)
    background.do(long)
    began.wait()
    accepted = [background.do(lambda: done.append(0)) for _ in range(5)]
    release.set()
    background.close()
    assert accepted == [True, True, False, False, False]
    assert len(done) == 2

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Garbage is collected at the intervals of the node, and only then."""

import gc
import weakref

import pytest

from sphere_nmpc.ros.garbage import GarbageCollection


class Cycle:
    """Object that refers to itself, so that its reference count never falls to zero."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture
def garbage():
    with GarbageCollection(0.0) as made:
        yield made
    assert gc.isenabled() and gc.get_freeze_count() == 0


def test_cycle_is_collected_when_the_interval_has_passed(garbage) -> None:
    assert not gc.isenabled()
    cycle = weakref.ref(Cycle())
    garbage.collect_if_due(0.2)
    assert cycle() is not None
    garbage.collect_if_due(0.3)
    assert cycle() is None


def test_cycle_of_older_objects_is_collected_after_minutes(garbage) -> None:
    kept = Cycle()
    cycle = weakref.ref(kept)
    for second in range(1, 5):
        garbage.collect_if_due(float(second))
    del kept
    garbage.collect_if_due(290.0)
    assert cycle() is not None, "it has survived two collections of new objects"
    garbage.collect_if_due(301.0)
    assert cycle() is None

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import itertools
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from recorded_bags import Entry, run_messages, write_own

from sphere_sim.recording.run import Run
from sphere_sim.recording.run_reader import read_run


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Run]:
    """Return a function that writes entries to a new bag of the recorder, and reads it."""
    numbers = itertools.count()

    def read(entries: Iterable[Entry], **options: str) -> Run:
        return read_run(write_own(tmp_path / f"bag_{next(numbers)}", entries), **options)

    return read


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return the run of `run_messages`."""
    return read_run(write_own(tmp_path_factory.mktemp("whole") / "bag", run_messages()))

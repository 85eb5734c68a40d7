# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A goal is resumed after a short time and on the same clock only."""

from pathlib import Path

import numpy as np
import pytest

from sphere_nmpc.control import goal_memory
from sphere_nmpc.control.goal_memory import GoalMemory
from sphere_nmpc.model.state import as_state

GOAL = as_state([1.0, -2.0, 0.0, 0.6, 0.8, 0.0])
STAMP = 12_345_678_901


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "goals" / "0.controller.json"


def test_goal_is_resumed_for_some_time_and_on_the_same_clock_only(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = GoalMemory(path, 30.0)
    for simulated in (False, True):
        memory.save(GOAL, STAMP, simulated)
        assert memory.recall(STAMP, simulated) is not None
        assert memory.recall(STAMP, not simulated) is None
        assert memory.recall(STAMP - 1, simulated) is None, "the clock was set back"
    written = path.stat().st_mtime
    monkeypatch.setattr(goal_memory.time, "time", lambda: written + 30.0)
    found = GoalMemory(path, 30.0).recall(STAMP, True)
    assert found is not None and found[1] == 30.0
    np.testing.assert_array_equal(found[0], GOAL)
    assert GoalMemory(path, 29.0).recall(STAMP, True) is None
    memory.save(None, STAMP, True)
    assert memory.recall(STAMP, True) is None and not list(path.parent.iterdir())
    GoalMemory(path, 0.0).save(GOAL, STAMP, True)
    assert not path.exists(), "goals are not kept"


@pytest.mark.parametrize(
    "content",
    ["", "[]", "null", '{"goal": [1, 2], "stamp": 0}', '{"goal": [0, 0, 9, 0, 0, 0]}',
     '{"goal": [0,0,1,0,0,0], "stamp": "x"}', '{"goal": [0,0,1,0,0,0], "stamp": Infinity}',
     "\ufffd" * 40],
)
def test_file_without_a_valid_goal_is_ignored(path: Path, content: str) -> None:
    path.parent.mkdir()
    path.write_text(content, encoding="utf-8")
    assert GoalMemory(path, 30.0).recall(STAMP, True) is None


def test_folder_that_cannot_be_written_raises(tmp_path: Path) -> None:
    (tmp_path / "goals").write_text("in the way")
    with pytest.raises(OSError):
        GoalMemory(tmp_path / "goals" / "file", 30.0).save(GOAL, STAMP, True)

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals are resumed after a short time and on the same clock only."""

from pathlib import Path

import pytest

from sphere_nmpc.control import goal_memory
from sphere_nmpc.control.goal_memory import GoalMemory
from sphere_nmpc.model.goal import Goal, GoalSequence, Orientation
from sphere_nmpc.model.state import as_state

POSES = [as_state([1.0, -2.0, 0.0, 0.6, 0.8, 0.0]), as_state([0.1, 0.2, 1.0, 0.0, 0.0, 0.0])]
GOALS = GoalSequence((Goal(POSES[0]), Goal(POSES[1], Orientation.ANY_HEADING)), 42, 1)
STAMP = 12_345_678_901


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "goals" / "0.controller.json"


def test_goal_is_resumed_for_some_time_and_on_the_same_clock_only(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = GoalMemory(path, 30.0)
    for simulated in (False, True):
        memory.save(GOALS, STAMP, simulated)
        assert memory.recall(STAMP, simulated) is not None
        assert memory.recall(STAMP, not simulated) is None
        assert memory.recall(STAMP - 1, simulated) is None, "the clock was set back"
    written = path.stat().st_mtime
    monkeypatch.setattr(goal_memory.time, "time", lambda: written + 30.0)
    found = GoalMemory(path, 30.0).recall(STAMP, True)
    assert found is not None and found[1] == 30.0
    assert found[0].lists_same(GOALS)
    assert (found[0].stamp, found[0].index) == (42, 1)
    assert GoalMemory(path, 29.0).recall(STAMP, True) is None
    memory.save(None, STAMP, True)
    assert memory.recall(STAMP, True) is None and not list(path.parent.iterdir())


_UPRIGHT = '["full", 0, 0, 1, 0, 0, 0]'


def _content(goal: str, index: str = "0", stamp: str = "0") -> str:
    return (
        f'{{"goals": [{goal}], "goal_stamp": 0, "index": {index}, "stamp": {stamp}, '
        '"simulated": true}'
    )


@pytest.mark.parametrize(
    "content",
    ["", "[]", "null", _content("[1, 2]"), _content('["full", 0, 0, 9, 0, 0, 0]'),
     _content('["some", 0, 0, 1, 0, 0, 0]'), _content(_UPRIGHT, index="1"),
     _content(_UPRIGHT, stamp='"x"'), _content(_UPRIGHT, stamp="Infinity"), "\ufffd" * 40],
)
def test_file_without_a_valid_goal_is_ignored(path: Path, content: str) -> None:
    path.parent.mkdir()
    path.write_text(content, encoding="utf-8")
    assert GoalMemory(path, 30.0).recall(STAMP, True) is None


def test_content_of_the_tests_above_is_valid_but_for_what_they_change(path: Path) -> None:
    path.parent.mkdir()
    path.write_text(_content(_UPRIGHT), encoding="utf-8")
    assert GoalMemory(path, 30.0).recall(STAMP, True) is not None


def test_folder_that_cannot_be_written_raises(tmp_path: Path) -> None:
    (tmp_path / "goals").write_text("in the way")
    memory = GoalMemory(tmp_path / "goals" / "file", 30.0)
    for use in (lambda: memory.save(GOALS, STAMP, True), lambda: memory.recall(STAMP, True)):
        with pytest.raises(OSError, match="goals: given no folder, expected one of user"):
            use()


def test_goal_that_somebody_else_can_have_written_is_not_resumed(path: Path) -> None:
    memory = GoalMemory(path, 30.0)
    memory.save(GOALS, STAMP, True)
    assert memory.recall(STAMP, True) is not None
    path.parent.chmod(0o777)
    with pytest.raises(OSError, match=r"given a folder that others can write, mode 777, expected"):
        memory.recall(STAMP, True)

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The client of goals against a controller that is written out here, and against random events."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphere_nmpc.conditions import Kind
from sphere_nmpc.control.goal_client import Due, GoalClient, Missed, NavigatorSettings, Outcome
from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.quantity import stamp_text

SETTINGS = NavigatorSettings(controller_timeout=5.0, no_progress_timeout=20.0)
STEP = 0.1  # s
FOREIGN = "7.000000000"
A, B, C = b"A", b"B", b"C"


@dataclass
class World:
    """A client and the controller that it talks to; messages arrive at the next step."""

    client: GoalClient = field(init=False)
    now: float = 100.0
    in_force: str = ""
    mode: Kind = Kind.NO_GOAL
    moves: float = 0.0
    """Time that the sphere still needs, to the goal or to rest [s]."""
    unreachable: set[str] = field(default_factory=set)
    """Stamps of goals that the controller does not pursue."""
    is_final: bool = True
    """Whether no area that may move is the cause of that."""
    plans: int = 0
    lives: bool = True
    takes_goals: bool = True
    can_send: bool = True
    sent: list[str] = field(default_factory=list)
    cancels: int = 0
    ended: dict[bytes, tuple[Outcome, str]] = field(default_factory=dict)
    missed: dict[bytes, tuple[Missed, ...]] = field(default_factory=dict)
    stamps: list[str] = field(default_factory=list)
    """Those of all stages that were begun."""
    _under_way: str | None = None
    _cancel_under_way: bool = False
    _stamps: dict[bytes, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.client = GoalClient(SETTINGS, self._stamp)

    def _stamp(self) -> int:
        self.stamps.append(f"{len(self.stamps) + 1}.000000000")
        return len(self.stamps) * 1_000_000_000

    def begin(self, goal: bytes, stages: int = 1, pause: float = 0.0, **options: bool) -> None:
        def messages() -> Iterator[bytes]:
            for _ in range(stages):
                yield goal

        self.client.begin(goal, messages(), pause, **options)
        self._update()

    def stamp(self, goal: bytes) -> str:
        return self._stamps[goal]

    def outcome(self, goal: bytes) -> Outcome:
        return self.ended[goal][0]

    def take(self, stamp: str) -> None:
        """Put a goal in force at the controller."""
        self.in_force, self.mode, self.moves = stamp, Kind.TRACKING, 2.0
        if stamp in self.unreachable:
            self.mode, self.moves = Kind.NO_PROGRESS, 0.0
        self.plans += 1

    def drop(self) -> None:
        if self.in_force:
            self.in_force, self.mode, self.moves = "", Kind.NO_GOAL, 0.3

    def restart(self, kept: bool) -> None:
        self.lives, self.plans = True, 0
        if kept:
            self.take(self.in_force)
        else:
            self.in_force, self.mode, self.moves = "", Kind.NO_GOAL, 0.0

    def step(self, duration: float = STEP) -> None:
        for _ in range(round(duration / STEP)):
            self.now += STEP
            if self.lives:
                self._control()
            self._update()

    def _control(self) -> None:
        if self._under_way is not None and self.takes_goals:
            self.take(self._under_way)
        if self._cancel_under_way:
            self.drop()
            self.client.cancel_answered()
            self._update()
        self._under_way, self._cancel_under_way = None, False
        if self.mode in (Kind.TRACKING, Kind.NO_GOAL, Kind.AT_GOAL):
            self.moves = max(0.0, self.moves - STEP)
        if self.mode is Kind.TRACKING and self.moves == 0.0:
            self.mode = Kind.AT_GOAL
        at_rest = self.moves == 0.0
        stands = self.mode is Kind.NO_PROGRESS
        self.client.receive(GoalReport(
            self.in_force, 0, 1, self.mode.value, at_rest, self.plans,
            unreachable="goal occupied" if stands and self.is_final else "",
            obstacle="it is occupied" if stands else "", time_left=self.moves,
        ), self.now)
        self._update()

    def _update(self) -> None:
        due = self.client.update(self.now, self.can_send)
        for ending in due.ended:
            assert ending.goal not in self.ended, "a second end"
            self.ended[ending.goal] = ending.outcome, ending.reason
            self.missed[ending.goal] = ending.missed
        if due.cancel:
            self.cancels += 1
            self._cancel_under_way = True
        if due.send:
            stamp = stamp_text(self.client.stamp)
            self._stamps[self.client.message] = stamp
            self.sent.append(stamp)
            self._under_way = stamp


@pytest.fixture
def world() -> World:
    world = World()
    world.step(1.0)
    return world


def test_goal_succeeds_at_the_goal(world) -> None:
    world.begin(A)
    world.step(1.0)
    assert world.client.goal == A
    assert world.client.report.time_left == pytest.approx(1.0)
    world.step(1.5)
    assert world.ended == {A: (Outcome.SUCCEEDED, "at the goal")}
    world.step(20.0)
    assert world.in_force == world.stamp(A), "it stays there"
    assert world.cancels == 0 and len(world.sent) == 1


def test_cancelled_goal_ends_at_rest_and_once_however_often_it_is_cancelled(world) -> None:
    world.begin(A)
    world.step(1.0)
    assert world.client.cancel(A)
    assert world.client.cancel(A)
    world.step(0.2)
    assert world.in_force == "" and not world.ended, "it is dropped but still moves"
    world.step(0.5)
    assert world.ended == {A: (Outcome.CANCELED, "at rest")}
    assert not world.client.cancel(A)
    assert world.cancels == 1


@pytest.mark.parametrize("after", [0.0, 0.1, 0.2])
def test_goal_that_is_cancelled_at_once_does_not_come_into_force_later(world, after) -> None:
    world.begin(A)
    world.step(after)
    assert world.client.cancel(A)
    world.step(3.0)
    assert world.outcome(A) is Outcome.CANCELED
    assert world.in_force == ""


def test_goal_that_a_busy_controller_takes_after_it_was_cancelled_is_dropped_first(world) -> None:
    world.begin(A)
    sent, world._under_way = world._under_way, None
    assert world.client.cancel(A)
    world.step(3.0)
    assert not world.ended, "the sphere may still begin to move"
    world._under_way = sent
    world.step(2.0)
    assert world.outcome(A) is Outcome.CANCELED
    assert world.in_force == ""


def test_newer_goal_takes_over_without_a_cancel_between(world) -> None:
    world.begin(A)
    world.step(1.0)
    world.begin(B)
    assert world.ended == {A: (Outcome.ABORTED, "a newer goal has taken over")}
    world.step(1.0)
    assert world.in_force == world.stamp(B)
    world.step(2.0)
    assert world.outcome(B) is Outcome.SUCCEEDED
    assert world.cancels == 0 and len(world.sent) == 2


def test_goal_after_a_cancel_is_not_dropped_with_the_one_before(world) -> None:
    world.begin(A)
    world.step(1.0)
    assert world.client.cancel(A)
    world._update()  # the request is under way
    world.begin(B)
    assert world.outcome(A) is Outcome.ABORTED, "the sphere will not be at rest"
    assert len(world.sent) == 1
    world.step(4.0)
    assert world.outcome(B) is Outcome.SUCCEEDED


def test_goal_of_somebody_else_takes_over(world) -> None:
    world.begin(A)
    world.step(1.0)
    world.take(FOREIGN)
    world.step()
    assert world.ended == {A: (Outcome.ABORTED, "another goal has taken over")}
    world.step(5.0)
    assert world.in_force == FOREIGN and world.cancels == 0 and len(world.sent) == 1


def test_goal_in_force_before_is_not_taken_for_a_newer_one(world) -> None:
    world.take(FOREIGN)
    world.step(1.0)
    world.begin(A)
    world.step()
    assert not world.ended
    world.step(3.0)
    assert world.outcome(A) is Outcome.SUCCEEDED


def test_goal_that_is_cancelled_at_the_controller_is_aborted_at_once(world) -> None:
    world.begin(A)
    world.step(1.0)
    world.drop()
    world.step()
    assert world.ended == {A: (Outcome.ABORTED, "cancelled at the controller")}


def test_lost_goal_is_sent_again_until_the_controller_shows_it(world) -> None:
    world.begin(A)
    world._under_way = None
    world.step(4.0)
    assert len(world.sent) == 2
    assert world.outcome(A) is Outcome.SUCCEEDED


def test_goal_that_the_controller_refuses_is_aborted(world) -> None:
    world.takes_goals = False
    world.begin(A)
    world.step(6.0)
    assert world.outcome(A) is Outcome.ABORTED
    assert "has not taken it" in world.ended[A][1]


def test_killed_controller_is_told_once_and_nothing_is_followed_later(world) -> None:
    world.begin(A)
    world.step(1.0)
    world.lives = False
    world.step(4.0)
    assert not world.ended
    world.step(3.0)
    assert world.ended == {A: (Outcome.ABORTED, "no status of the controller for 5 s")}
    assert world.cancels == 0, "nobody would be told"
    world.restart(kept=True)
    world.step(2.0)
    assert world.in_force == "", "a goal that has ended is dropped"
    assert world.cancels == 1


def test_goal_goes_on_where_a_controller_is_restarted_in_time(world) -> None:
    world.begin(A)
    world.step(1.0)
    world.lives = False
    world.step(3.0)
    world.restart(kept=True)
    world.step(1.0)
    assert not world.ended
    world.step(3.0)
    assert world.outcome(A) is Outcome.SUCCEEDED
    assert len(world.sent) == 1


def test_goal_that_a_restarted_controller_does_not_know_is_aborted(world) -> None:
    world.begin(A)
    world.step(1.0)
    world.lives = False
    world.step(2.0)
    world.restart(kept=False)
    world.step(2.0)
    assert not world.ended, "it may still be restored"
    world.step(5.0)
    assert world.outcome(A) is Outcome.ABORTED
    assert "follows it no longer" in world.ended[A][1]


def test_older_goal_restored_by_a_restarted_controller_is_replaced(world) -> None:
    world.begin(A)
    world.step(1.0)
    world.begin(B)
    world.step(0.3)
    world.lives = False
    world.in_force = world.stamp(A)
    world.step(1.0)
    world.restart(kept=True)
    world.step(6.0)
    assert world.outcome(B) is Outcome.SUCCEEDED


@pytest.mark.parametrize("restarts", [False, True])
def test_goal_cancelled_without_a_controller_ends_once(world, restarts) -> None:
    world.begin(A)
    world.step(1.0)
    world.lives = False
    assert world.client.cancel(A)
    world.step(2.0)
    assert not world.ended
    if restarts:
        world.restart(kept=True)
    world.step(10.0)
    assert world.outcome(A) is (Outcome.CANCELED if restarts else Outcome.ABORTED)
    assert not restarts or world.in_force == ""


def test_goal_without_poses_waits_and_is_aborted_in_the_end(world) -> None:
    world.begin(A)
    world.step(1.0)
    world.mode = Kind.NO_FRESH_POSE
    world.step(15.0)
    world.mode = Kind.TRACKING
    world.step(0.5)
    assert not world.ended
    world.mode = Kind.CLOCK_STOPPED
    world.step(19.0)
    assert not world.ended
    world.step(2.0)
    assert world.ended == {A: (Outcome.ABORTED, "the clock stands still, for 20 s")}


def test_goal_is_not_aborted_for_poses_that_were_missing_before_it(world) -> None:
    world.mode = Kind.NO_POSE
    world.step(100.0)
    world.begin(A)
    world.step(1.0)
    assert not world.ended


GIVEN_UP = "no progress towards the goal: it is occupied"


def test_goal_that_cannot_be_reached_is_aborted_at_once_and_not_followed_later(world) -> None:
    world.unreachable.add("1.000000000")
    world.begin(A)
    world.step(0.2)
    assert world.ended == {A: (Outcome.ABORTED, GIVEN_UP)}
    assert world.missed[A] == (Missed(0, "goal occupied", GIVEN_UP),)
    world.step(1.0)
    assert world.in_force == "", "an area that moves on must not let the sphere start"


def test_goal_in_the_way_of_which_something_is_waits_and_is_aborted_in_the_end(world) -> None:
    world.is_final = False
    world.unreachable.add("1.000000000")
    world.begin(A)
    world.step(19.0)
    assert not world.ended
    world.step(2.0)
    assert world.ended == {A: (Outcome.ABORTED, f"{GIVEN_UP}, for 20 s")}
    assert world.missed[A][0].cause == Kind.NO_PROGRESS.value


def test_goal_goes_on_where_what_was_in_the_way_has_moved(world) -> None:
    world.is_final = False
    world.unreachable.add("1.000000000")
    world.begin(A)
    world.step(19.0)
    world.unreachable.clear()
    world.take(world.in_force)
    world.step(3.0)
    assert world.outcome(A) is Outcome.SUCCEEDED


@pytest.mark.parametrize("mode", [Kind.SATURATED, Kind.FALLBACK, Kind.POSE_JUMPED])
def test_no_mode_keeps_a_goal_for_ever(world, mode) -> None:
    world.begin(A)
    world.step(1.0)
    world.mode = mode
    world.step(21.0)
    assert world.ended == {A: (Outcome.ABORTED, f"{mode.value}, for 20 s")}


def test_goal_ends_at_once_where_the_controller_is_disabled(world) -> None:
    world.begin(A)
    world.step(1.0)
    world.mode = Kind.DISABLED
    world.step(0.1)
    assert world.ended == {A: (Outcome.ABORTED, "disabled")}


def test_stages_are_sent_in_order_with_a_pause_at_each(world) -> None:
    world.begin(A, stages=3, pause=1.0)
    world.step(2.5)
    assert (world.mode, world.client.stage) == (Kind.AT_GOAL, 0), "pause"
    world.step(1.0)
    assert (world.mode, world.client.stage) == (Kind.TRACKING, 1)
    world.step(6.0)
    assert world.ended == {A: (Outcome.SUCCEEDED, "at the goal")}
    assert world.sent == world.stamps and len(world.stamps) == 3 and not world.missed[A]
    world.step(5.0)
    assert world.in_force == world.stamps[-1], "it stays there"


@pytest.mark.parametrize("missed", [{0}, {1}, {2}, {0, 2}])
def test_stage_that_cannot_be_reached_is_missed_and_the_next_one_sent(world, missed) -> None:
    world.unreachable = {f"{stage + 1}.000000000" for stage in missed}
    world.begin(A, stages=3)
    world.step(10.0)
    assert world.ended == {A: (Outcome.SUCCEEDED, f"{len(missed)} of 3 missed")}
    assert [one.stage for one in world.missed[A]] == sorted(missed)
    assert (world.in_force == "") is (2 in missed), "what was missed is not followed later"


def test_goal_of_which_no_stage_can_be_reached_is_aborted(world) -> None:
    world.unreachable = {"1.000000000", "2.000000000"}
    world.begin(A, stages=2)
    world.step(3.0)
    assert world.ended == {A: (Outcome.ABORTED, GIVEN_UP)}
    assert len(world.missed[A]) == 2


def test_what_no_other_stage_would_mend_ends_the_goal(world) -> None:
    world.begin(A, stages=3)
    world.step(3.5)
    world.mode = Kind.DISABLED
    world.step(0.1)
    assert world.ended == {A: (Outcome.ABORTED, "disabled")} and len(world.stamps) == 2


def test_goal_can_be_cancelled_and_taken_over_during_a_pause(world) -> None:
    world.begin(A, stages=2, pause=5.0)
    world.step(4.0)
    assert world.mode is Kind.AT_GOAL and not world.ended
    assert world.client.cancel(A)
    world.step(1.0)
    assert world.outcome(A) is Outcome.CANCELED and world.in_force == ""
    world.begin(B, stages=2, pause=5.0)
    world.step(4.0)
    world.begin(C)
    assert world.ended[B] == (Outcome.ABORTED, "a newer goal has taken over")
    world.step(4.0)
    assert world.outcome(C) is Outcome.SUCCEEDED
    world.begin(b"D", stages=2, pause=5.0)
    world.step(4.0)
    world.take(FOREIGN)
    world.step(0.1)
    assert world.ended[b"D"] == (Outcome.ABORTED, "another goal has taken over")


def test_abandoned_goal_ends_and_is_dropped(world) -> None:
    world.begin(A)
    world.step(1.0)
    world.client.abandon("the navigator has ended")
    world._update()
    assert world.ended == {A: (Outcome.ABORTED, "the navigator has ended")}
    world.step(1.0)
    assert world.in_force == ""
    world.client.abandon("again")
    assert world.client.update(world.now) == Due()


def test_goal_that_is_left_to_the_controller_is_over_once_it_is_shown(world) -> None:
    world.begin(A, until_taken=True)
    world._under_way = None
    world.step(1.0)
    assert not world.ended, "it was lost"
    world.step(0.5)
    assert world.outcome(A) is Outcome.SUCCEEDED and world.mode is Kind.TRACKING
    world.mode = Kind.DISABLED
    world.step(30.0)
    assert world.in_force == world.stamp(A) and world.cancels == 0, "it is not given up"


def test_goal_is_sent_when_there_is_a_controller(world) -> None:
    world.can_send = False
    world.begin(A)
    world.step(2.0)
    assert not world.sent
    world.can_send = True
    world.step(3.0)
    assert world.outcome(A) is Outcome.SUCCEEDED and len(world.sent) == 1


def test_time_in_which_the_process_was_stopped_is_no_silence_of_the_controller(world) -> None:
    world.begin(A)
    world.step(1.0)
    world.now += 100.0
    world._update()
    assert not world.ended
    world.step(2.0)
    assert world.outcome(A) is Outcome.SUCCEEDED


EVENTS = (
    "begin", "begin several", "cancel", "foreign", "kill", "restart", "restart with memory",
    "lose", "drop",
)


@given(st.lists(st.tuples(st.sampled_from(EVENTS), st.integers(0, 25)), max_size=25))
def test_each_goal_has_one_end_whatever_happens(events) -> None:
    world, begun = World(), 0
    for event, steps in events:
        if event in ("begin", "begin several"):
            begun += 1
            world.begin(str(begun).encode(), 1 + 2 * (event == "begin several"), 0.5)
        elif event == "cancel" and world.client.goal:
            assert world.client.cancel(world.client.goal)
        elif event == "foreign" and world.lives:
            world.take(FOREIGN)
        elif event == "kill":
            world.lives = False
        elif event.startswith("restart") and not world.lives:
            world.restart(kept="memory" in event)
        elif event == "lose":
            world._under_way, world._cancel_under_way = None, False
        elif event == "drop" and world.lives:
            world.drop()
        world.step(steps * STEP)
    world.step(20.0)
    assert len(world.ended) == begun
    # What is followed in the end is a goal that was reached, or one of somebody else.
    followed = {world.stamp(goal): goal for goal in world.ended}.get(world.in_force)
    assert followed or world.in_force in ("", FOREIGN) or not world.lives
    world.step(3.0)
    assert not world.lives or followed is None or (
        world.in_force == "" or world.outcome(followed) is Outcome.SUCCEEDED
    )

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The client of goals against a controller that is written out here, and against random events."""

from itertools import repeat

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphere_nmpc.control.goal_client import GoalClient, NavigatorSettings, Outcome
from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.quantities import stamp_text
from sphere_nmpc.reporting.conditions import Kind

SETTINGS = NavigatorSettings(controller_timeout=5.0, no_progress_timeout=20.0)
STEP = 0.1  # s
FOREIGN = "7.000000000"
GIVEN_UP = "no progress towards the goal: a wall"
NEWER, OTHER = "a newer goal has taken over", "another goal has taken over"


class World:
    """A client and the controller that it talks to; messages arrive at the next step.

    Events are words, with the goal that they concern. Each stage of a goal has a stamp of its own,
    1 s, 2 s and so on in the order in which they are begun.
    """

    def __init__(self) -> None:
        self.client = GoalClient(SETTINGS, self._stamp)
        self.now = 0.0
        self.in_force = ""
        self.mode = Kind.NO_GOAL
        self.moves = 0.0  # time that the sphere still needs, to the goal or to rest [s]
        self.unreachable: set[str] = set()  # stamps of goals that the controller does not pursue
        self.is_final = True  # whether no area that may move is the cause of that
        self.plans = self.stamps = self.cancels = self.sent = 0
        self.lives = self.takes_goals = self.can_send = True
        self.ended: dict[str, tuple[float, Outcome, str]] = {}
        self.missed: dict[str, list[tuple[int, str]]] = {}
        self.stamp_of: dict[str, str] = {}
        self._clock = 0.0
        self._under_way: str | None = None
        self._held_up: str | None = None
        self._cancel_under_way = False
        self.step(1.0)
        self.now = 0.0

    def _stamp(self) -> int:
        self.stamps += 1
        return self.stamps * 1_000_000_000

    def play(self, *events: str | float) -> None:
        """Let events happen, and time [s] pass between them."""
        for event in events:
            if isinstance(event, str):
                self.happen(*event.split())
            else:
                self.step(event)

    def happen(self, event: str, what: str = "") -> None:
        match event:
            case "begin" | "leave":
                self.client.begin(what, iter([what]), until_taken=event == "leave")
            case "stages":
                self.client.begin(what, repeat(what, 3), pause=1.0)
            case "cancel":
                assert self.client.cancel(what) is (what not in self.ended)
            case "abandon":
                self.client.abandon("the navigator has ended")
            case "foreign":
                self.take(FOREIGN)
            case "drop":
                self.drop()
            case "mode":
                self.mode = Kind[what]
            case "kill":
                self.lives = False
            case "restart" | "restore":
                self.lives, self.plans = True, 0
                if event == "restore":
                    self.take(self.stamp_of[what] if what else self.in_force)
                else:
                    self.in_force, self.mode, self.moves = "", Kind.NO_GOAL, 0.0
            case "lose":
                self._under_way, self._cancel_under_way = None, False
            case "hold_up":
                self._held_up, self._under_way = self._under_way, None
            case "arrive":
                self._under_way = self._held_up
            case "refuse":
                self.takes_goals = False
            case "occupied" | "blocked":
                self.unreachable |= {f"{stage}.000000000" for stage in what.split("+")}
                self.is_final = event == "occupied"
            case "freed":
                self.unreachable.clear()
                self.take(self.in_force)
            case "no_controller" | "controller":
                self.can_send = event == "controller"
            case "stopped":  # this process
                self._clock += 100.0
            case _:
                raise ValueError(event)
        self._update()

    def take(self, stamp: str) -> None:
        """Put a goal in force at the controller."""
        self.in_force, self.mode, self.moves = stamp, Kind.TRACKING, 2.0
        if stamp in self.unreachable:
            self.mode, self.moves = Kind.NO_PROGRESS, 0.0
        self.plans += 1

    def drop(self) -> None:
        if self.in_force:
            self.in_force, self.mode, self.moves = "", Kind.NO_GOAL, 0.3

    def step(self, duration: float = STEP) -> None:
        for _ in range(round(duration / STEP)):
            self.now += STEP
            self._clock += STEP
            if self.lives:
                self._control()
            self._update()

    def _control(self) -> None:
        arrived, self._under_way = self._under_way, None
        if arrived is not None and self.takes_goals:
            self.take(arrived)
        if self._cancel_under_way:
            self.drop()
            self._cancel_under_way = False
            self.client.cancel_answered()
            self._update()
        if self.mode in (Kind.TRACKING, Kind.NO_GOAL, Kind.AT_GOAL):
            self.moves = max(0.0, self.moves - STEP)
        if self.mode is Kind.TRACKING and self.moves == 0.0:
            self.mode = Kind.AT_GOAL
        stands = self.mode is Kind.NO_PROGRESS
        self.client.receive(GoalReport(
            self.in_force, 0, 1, self.mode.value, self.moves == 0.0, self.plans,
            unreachable="no way" if stands and self.is_final else "",
            obstacle="a wall" if stands else "", time_left=self.moves,
        ), self._clock)
        self._update()

    def _update(self) -> None:
        due = self.client.update(self._clock, self.can_send)
        for ending in due.ended:
            assert ending.goal not in self.ended, "a second end"
            self.ended[ending.goal] = self.now, ending.outcome, ending.reason
            self.missed[ending.goal] = [(one.stage, one.cause) for one in ending.missed]
        if due.cancel:
            self.cancels += 1
            self._cancel_under_way = True
        if due.send:
            self._under_way = stamp_text(self.client.pursuit.stamp)
            self.stamp_of[self.client.pursuit.message] = self._under_way
            self.sent += 1


DONE, STOPPED, FAILED = Outcome.SUCCEEDED, Outcome.CANCELED, Outcome.ABORTED
REACHED, AT_REST = "at the goal", "at rest"
GONE = "no status of the controller for 5 s"
NOT_TAKEN = "the controller has not taken it, for 5 s; its log says more"
NO_LONGER = "the controller follows it no longer, for 5 s; its log says more"
CASES = {
    "it stays at the goal": (
        ["begin A", 22.0], {"A": (2.0, DONE, REACHED)}, "A", 1, 0,
    ),
    "cancelled twice": (
        ["begin A", 1.0, "cancel A", "cancel A", 1.0, "cancel A"],
        {"A": (1.3, STOPPED, AT_REST)}, "", 1, 1,
    ),
    "cancelled at once": (
        ["begin A", "cancel A", 3.0], {"A": (0.4, STOPPED, AT_REST)}, "", 1, 1,
    ),
    "a busy controller takes it after it was cancelled": (
        ["begin A", "hold_up", "cancel A", 3.0, "arrive", 2.0],
        {"A": (3.4, STOPPED, AT_REST)}, "", 1, 1,
    ),
    "cancelled while the controller is gone": (
        ["begin A", 1.0, "kill", "cancel A", 12.0], {"A": (6.1, FAILED, GONE)}, "A", 1, 1,
    ),
    "cancelled before the controller is restarted": (
        ["begin A", 1.0, "kill", "cancel A", 2.0, "restore", 10.0],
        {"A": (3.3, STOPPED, AT_REST)}, "", 1, 1,
    ),
    "cancelled during a pause": (
        ["stages A", 2.5, "cancel A", 1.0], {"A": (2.8, STOPPED, AT_REST)}, "", 1, 1,
    ),
    "taken over without a cancel": (
        ["begin A", 1.0, "begin B", 3.0], {"A": (1.0, FAILED, NEWER), "B": (3.0, DONE, REACHED)},
        "B", 2, 0,
    ),
    "a goal after a cancel is not dropped with the one before": (
        ["begin A", 1.0, "cancel A", "begin B", 4.0],
        {"A": (1.0, FAILED, NEWER), "B": (3.1, DONE, REACHED)}, "B", 2, 1,
    ),
    "another's goal": (
        ["begin A", 1.0, "foreign", 5.0], {"A": (1.1, FAILED, OTHER)}, FOREIGN, 1, 0,
    ),
    "another's goal before": (
        ["foreign", 1.0, "begin A", 3.0], {"A": (3.0, DONE, REACHED)}, "A", 1, 0,
    ),
    "cancelled at the controller": (
        ["begin A", 1.0, "drop", 1.0], {"A": (1.1, FAILED, "cancelled at the controller")}, "",
        1, 0,
    ),
    "lost and sent again": (
        ["begin A", "lose", 4.0], {"A": (3.0, DONE, REACHED)}, "A", 2, 0,
    ),
    "refused": (["refuse", "begin A", 6.0], {"A": (5.1, FAILED, NOT_TAKEN)}, "", 5, 0),
    "killed controller, whose goal is dropped once it is back": (
        ["begin A", 1.0, "kill", 7.0, "restore", 2.0], {"A": (6.1, FAILED, GONE)}, "", 1, 1,
    ),
    "controller restarted in time": (
        ["begin A", 1.0, "kill", 3.0, "restore", 4.0], {"A": (6.0, DONE, REACHED)}, "A", 1, 0,
    ),
    "restarted controller without a memory": (
        ["begin A", 1.0, "kill", 2.0, "restart", 7.0], {"A": (6.1, FAILED, NO_LONGER)}, "", 1, 0,
    ),
    "restarted controller that restores the goal before": (
        ["begin A", 1.0, "begin B", 0.3, "kill", 1.0, "restore A", 6.0],
        {"A": (1.0, FAILED, NEWER), "B": (4.4, DONE, REACHED)}, "B", 3, 0,
    ),
    "without poses, then without a clock": (
        ["begin A", 1.0, "mode NO_FRESH_POSE", 15.0, "mode TRACKING", 0.5, "mode CLOCK_STOPPED",
         21.0],
        {"A": (36.6, FAILED, "the clock stands still, for 20 s")}, "", 1, 1,
    ),
    "poses that were missing before": (["mode NO_POSE", 100.0, "begin A", 1.0], {}, "A", 1, 0),
    "disabled": (
        ["begin A", 1.0, "mode DISABLED", 0.1], {"A": (1.1, FAILED, "disabled")}, "A", 1, 1,
    ),
    "unreachable, and not followed if the area moves on": (
        ["occupied 1", "begin A", 2.0], {"A": (0.1, FAILED, GIVEN_UP)}, "", 1, 1,
    ),
    "blocked for too long": (
        ["blocked 1", "begin A", 21.0], {"A": (20.1, FAILED, f"{GIVEN_UP}, for 20 s")}, "", 1, 1,
    ),
    "blocked for a while": (
        ["blocked 1", "begin A", 19.0, "freed", 3.0], {"A": (21.0, DONE, REACHED)}, "A", 1, 0,
    ),
    "stages with a pause at each": (
        ["stages A", 14.0], {"A": (9.2, DONE, REACHED)}, "A", 3, 0,
    ),
    "what no other stage would mend": (
        ["stages A", 3.5, "mode DISABLED", 0.1], {"A": (3.6, FAILED, "disabled")}, "A", 2, 1,
    ),
    "abandoned": (
        ["begin A", 1.0, "abandon", 1.0, "abandon"],
        {"A": (1.0, FAILED, "the navigator has ended")}, "", 1, 1,
    ),
    "left to the controller once it is shown": (
        ["leave A", "lose", 2.0, "mode DISABLED", 30.0], {"A": (1.1, DONE, REACHED)}, "A", 2, 0,
    ),
    "sent when there is a controller": (
        ["no_controller", "begin A", 2.0, "controller", 3.0], {"A": (4.0, DONE, REACHED)}, "A",
        1, 0,
    ),
    "this process is stopped for a while": (
        ["begin A", 1.0, "stopped", 2.0], {"A": (2.0, DONE, REACHED)}, "A", 1, 0,
    ),
}


@pytest.mark.parametrize(
    ("events", "ended", "in_force", "sent", "cancels"), CASES.values(), ids=CASES
)
def test_goal_has_the_right_end_at_the_right_time(events, ended, in_force, sent, cancels) -> None:
    world = World()
    world.play(*events)
    assert {goal: end[1:] for goal, end in world.ended.items()} == {
        goal: end[1:] for goal, end in ended.items()
    }
    for goal, end in ended.items():
        assert world.ended[goal][0] == pytest.approx(end[0], abs=0.5 * STEP)
    assert world.in_force == world.stamp_of.get(in_force, in_force)
    assert (world.sent, world.cancels) == (sent, cancels)


def test_goal_under_way_and_its_stage_are_told() -> None:
    world = World()
    world.play("stages A", 1.0)
    assert (world.client.goal, world.client.pursuit.stage) == ("A", 0)
    assert world.client.report.time_left == pytest.approx(1.0)
    world.play(3.0)
    assert (world.mode, world.client.pursuit.stage) == (Kind.TRACKING, 1)


@pytest.mark.parametrize("missed", ["1", "2", "3", "1+3", "1+2+3"])
def test_stage_that_cannot_be_reached_is_missed_and_the_next_one_sent(missed) -> None:
    world = World()
    world.play(f"occupied {missed}", "stages A", 15.0)
    stages = [int(stage) - 1 for stage in missed.split("+")]
    assert world.missed == {"A": [(stage, "no way") for stage in stages]}
    expected = (FAILED, GIVEN_UP) if len(stages) == 3 else (DONE, f"{len(stages)} of 3 missed")
    assert world.ended["A"][1:] == expected
    assert (world.in_force == "") is (2 in stages), "what was missed is not followed later"


EVENTS = ("begin", "stages", "cancel", "foreign", "kill", "restart", "restore", "lose", "drop")


@given(st.lists(st.tuples(st.sampled_from(EVENTS), st.integers(0, 25)), max_size=25))
def test_each_goal_has_one_end_whatever_happens(events) -> None:
    world, begun = World(), 0
    for event, steps in events:
        if event in ("begin", "stages"):
            begun += 1
            world.happen(event, str(begun))
        elif event == "cancel" and world.client.goal:
            world.happen(event, world.client.goal)
        elif event in ("kill", "lose") or (
            event != "cancel" and world.lives is (event in ("foreign", "drop"))
        ):
            world.happen(event)
        world.step(steps * STEP)
    world.step(20.0)
    assert len(world.ended) == begun
    # What is followed in the end is a goal that was reached, or one of somebody else.
    followed = {world.stamp_of[goal]: goal for goal in world.ended}.get(world.in_force)
    assert followed or world.in_force in ("", FOREIGN) or not world.lives
    world.step(3.0)
    assert not world.lives or followed is None or (
        world.in_force == "" or world.ended[followed][1] is DONE
    )

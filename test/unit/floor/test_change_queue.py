# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Changes that are made in a thread: each whole or not at all, and none for long unnoticed."""

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass

import pytest
from patience import PATIENCE

from sphere_nmpc.errors import ForeignCodeError
from sphere_nmpc.floor.change_queue import ChangeQueue, Request

Given = tuple[str, ...]


@dataclass(frozen=True)
class Made:
    given: Given


class Words:
    """Queue of words, of which some cannot be made, others not be used."""

    def __init__(self) -> None:
        self.made: list[Given] = []
        self.refused: list[tuple[str, str]] = []
        self.used: list[Given] = []
        self.gate = threading.Event()
        self.gate.set()
        self.queue: ChangeQueue[Given, Made] = ChangeQueue(
            Made(()), self._make, self._use, lambda request, error: self.refused.append(
                (request.name, str(error))
            )
        )

    def _make(self, given: Given, in_force: Made) -> Made:
        assert self.gate.wait(PATIENCE)
        self.made.append(given)
        if "late" in given:
            raise OSError("no space")
        return Made(given)

    def _use(self, made: Made, took: float) -> None:
        assert took >= 0.0
        if "useless" in made.given:
            raise ValueError("of no use")
        self.used.append(made.given)

    def say(self, *words: str, key: str = "", **given: float) -> None:
        for word in words:
            self.queue.submit(key or word, self.request(word, **given))

    def request(self, word: str, **given: float) -> Request[Given]:
        def change(given: Given) -> Given:
            if word == "early":
                raise ValueError("no word")
            if word == "exit":
                raise SystemExit
            if word == "interrupt":
                raise KeyboardInterrupt
            return (*given, word)

        return Request(word, change, **given)

    def finish(self) -> Given:
        """Return the words in force when nothing is left to be made."""
        self.gate.set()
        end = time.monotonic() + PATIENCE
        while self.queue.look():
            assert time.monotonic() < end
            time.sleep(1e-3)
        return self.queue.in_force.given


@pytest.fixture
def words() -> Iterator[Words]:
    found = Words()
    yield found
    found.gate.set()


def test_all_that_wait_are_made_together_and_a_newer_change_takes_the_place_of_an_older(words):
    words.gate.clear()
    words.say("first")
    for number in range(1000):
        words.say(f"moved {number}", key="area")
        words.say("other")
    assert words.finish() == ("first", "moved 999", "other")
    assert words.made == [("first",), ("first", "moved 999", "other")] == words.used


@pytest.mark.parametrize(
    ("bad", "before", "after"),
    # What cannot be used is known when all have been made together.
    [("early", "c", "d"), ("late", "c", "d"), ("useless", "", "")],
)
def test_what_cannot_be_made_is_refused_and_spoils_nothing_else(words, bad, before, after) -> None:
    words.say("a")
    assert words.finish() == ("a",)
    words.gate.clear()
    words.say("b", *before, bad, *after)
    assert words.finish() == ("a", "b", *before, *after)
    words.say("e")
    assert words.finish() == ("a", "b", *before, *after, "e")
    assert [name for name, _ in words.refused] == [bad]


def put(answer: Future[Callable[[], object]]) -> None:
    answer.result(0.0)()


def test_change_that_is_prepared_is_in_force_when_who_asked_says_so(words) -> None:
    answer = words.queue.prepare(words.request("a"))
    assert words.finish() == () and answer.done()
    words.queue.prepare(words.request("b")).add_done_callback(put)
    assert words.finish() == ("b",), "the one before was left"
    words.gate.clear()
    words.say("c")
    words.queue.prepare(words.request("d")).add_done_callback(put)
    words.say("e")
    assert words.finish() == ("b", "c", "d", "e") and not words.refused


def test_change_that_is_awaited_is_made_after_those_before_it(words) -> None:
    words.say("a", "late")
    put(words.queue.prepare(words.request("b"), is_awaited=True))
    assert words.queue.in_force.given == ("a", "b") == words.finish()
    for bad in ("early", "late"):
        answer = words.queue.prepare(words.request(bad), is_awaited=True)
        assert isinstance(answer.exception(0.0), (ValueError, OSError))
    assert [name for name, _ in words.refused] == ["late"], "others are answered"
    words.say("c")
    assert words.finish() == ("a", "b", "c")


def test_age_is_that_of_the_oldest_change_that_is_not_in_force(words) -> None:
    assert words.queue.oldest() is None
    words.gate.clear()
    words.say("a", since=5.0)
    assert words.queue.oldest().name == "a"
    words.say("b", since=3.0)
    words.say("c", key="b", since=9.0)
    assert (words.queue.oldest().name, words.queue.oldest().since) == ("c", 3.0), "as long as b"
    words.finish()
    assert words.queue.oldest() is None


def test_end_does_not_wait_and_answers(words) -> None:
    words.gate.clear()
    words.say("a")
    answer = words.queue.prepare(words.request("b"))
    (thread,) = (one for one in threading.enumerate() if one.name == "floor")
    assert thread.daemon, "the interpreter does not wait for it"
    words.queue.close(ValueError("it ends"))
    assert str(answer.exception(0.0)) == "it ends" and not words.queue.look()
    words.gate.set()
    thread.join(PATIENCE)
    assert words.finish() == ()


def test_what_would_end_the_thread_is_refused_and_the_others_are_made(words) -> None:
    words.gate.clear()
    words.say("a")
    words.say("exit", "b", "interrupt")
    assert words.finish() == ("a", "b")
    assert words.refused == [("exit", "SystemExit ''"), ("interrupt", "KeyboardInterrupt ''")]
    answer = words.queue.prepare(words.request("exit"), is_awaited=True)
    assert isinstance(answer.exception(0.0), ForeignCodeError)


@pytest.mark.parametrize("error", [RuntimeError("can't start new thread"), MemoryError()])
def test_thread_that_cannot_be_started_refuses_what_waits_and_a_later_one_is(
    words, monkeypatch, error
) -> None:
    def start(thread: threading.Thread) -> None:
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", start)
        words.say("a")
        answer = words.queue.prepare(words.request("b"))
        awaited = words.queue.prepare(words.request("c"), is_awaited=True)
        assert words.finish() == ()
        assert answer.exception(0.0) is awaited.exception(0.0) is error
    assert words.refused == [("a", str(error))] and words.queue.oldest() is None
    words.say("d")
    assert words.finish() == ("d",)

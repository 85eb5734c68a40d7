# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A channel tells errors of what it carries from its own end, and carries shared memory."""

import gc
import os
import pickle
import resource
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator

import pytest

from sphere_nmpc.process.channel import (
    Channel,
    ChannelEndError,
    ContentError,
    SharedMemory,
    encoded,
)

ERRORS = {
    "missing": FileNotFoundError("gone"), "end": EOFError("short"),
    "waits": BlockingIOError("waits"), "broken": BrokenPipeError("broken"),
    "memory": MemoryError("full"), "name": ModuleNotFoundError("absent"),
}


class Raising:
    """Object that raises the error of this name when it is read."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __reduce__(self) -> tuple[object, ...]:
        return _raise, (self._name,)


def _raise(name: str) -> None:
    raise ERRORS[name]


@pytest.fixture
def ends() -> Iterator[tuple[Channel, Channel]]:
    here, there = (Channel(end) for end in socket.socketpair())
    yield here, there
    here.close()
    there.close()


@pytest.mark.parametrize("name", ERRORS)
def test_an_object_that_cannot_be_read_is_no_end(name, ends) -> None:
    here, there = ends
    here.send(encoded([Raising(name), SharedMemory.of(memoryview(b"lost"))]))
    here.send(encoded({"next": 1}))
    with pytest.raises(ContentError, match="Error: "):
        there.receive()
    assert there.receive() == {"next": 1}


def test_the_end_is_told_on_both_sides(ends) -> None:
    here, there = ends
    here.send(encoded("last"))
    here.close()
    assert there.receive() == "last"
    with pytest.raises(ChannelEndError, match="closed"):
        there.receive()
    with pytest.raises(ChannelEndError, match="sent"):
        there.send(encoded("late"))
    with pytest.raises(ChannelEndError):
        here.receive()


def test_memory_outlives_its_sender_and_is_the_same_again(ends) -> None:
    here, there = ends
    there.never_wait()
    memory = SharedMemory.of(memoryview(b"first "), memoryview(b"second"))
    here.send(encoded([memory, "and", memory]))
    here.send(encoded(memory))
    here.send(encoded(SharedMemory.of(memoryview(b"another"))))
    assert here._socket.fileno() != -1
    del memory  # while it is under way
    first, _, second = there.receive()
    again, other = there.receive(), there.receive()
    assert first is second
    assert first == again != other
    assert len({first, again, other}) == 2
    mapped = again.mapped()
    del first, second, again
    assert mapped[:] == b"first second"
    assert other.mapped()[:] == b"another"
    with pytest.raises(BlockingIOError):
        there.receive()


def test_memory_and_its_descriptors_are_freed_without_garbage_collection(ends) -> None:
    here, there = ends
    gc.disable()
    try:
        before = len(os.listdir("/proc/self/fd"))
        for _ in range(20):
            here.send(encoded(SharedMemory.of(memoryview(bytes(10_000)))))
            there.receive().mapped()
        assert len(os.listdir("/proc/self/fd")) == before
    finally:
        gc.enable()


def test_where_no_descriptor_is_free_the_channel_ends(ends) -> None:
    here, there = ends
    here.send(encoded(SharedMemory.of(memoryview(b"too much"))))
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    try:
        with pytest.raises(ChannelEndError, match="too many files"):
            there.receive()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


KILLED = """
memory = SharedMemory.of(memoryview(b'12'), memoryview(b'3'))
assert memory.mapped()[:] == b'123'
os.kill(os.getpid(), signal.SIGKILL)
"""
TOO_SMALL = """
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try: SharedMemory.of(memoryview(bytes(10_000)))
except OSError as error: print(error.strerror)
"""


@pytest.mark.parametrize("system", ["", "del os.memfd_create"], ids=["memfd_create", "without"])
@pytest.mark.parametrize(
    ("program", "code", "told"), [(KILLED, -9, ""), (TOO_SMALL, 0, "File too large\n")],
    ids=["killed", "too small"],
)
def test_nothing_is_left_of_memory_whose_process_is_killed_or_cannot_have_it(
    system, program, code, told, tmp_path
) -> None:
    imports = "import os, resource, signal\nfrom sphere_nmpc.process.channel import SharedMemory\n"
    done = subprocess.run(
        [sys.executable, "-c", f"{imports}{system}\n{program}"], check=False,
        env=dict(os.environ, TMPDIR=str(tmp_path)), capture_output=True, text=True,
    )
    assert (done.returncode, done.stdout, done.stderr) == (code, told, "")
    assert not list(tmp_path.iterdir())


def test_memory_that_cannot_be_had_or_is_pickled_without_a_channel_is_told(
    monkeypatch, tmp_path
) -> None:
    with pytest.raises(TypeError, match="through a channel"):
        pickle.dumps(SharedMemory.of(memoryview(b"alone")))
    monkeypatch.delattr(os, "memfd_create")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(OSError, match="missing"):
        SharedMemory.of(memoryview(b"nowhere"))

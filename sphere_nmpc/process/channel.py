# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Channel between two processes for whole objects, and memory that they share.

What fails is of one of two kinds: `ChannelEndError` where nothing can be sent or received any
more, and `ContentError` where an object has arrived that cannot be read, after which others can.
"""

import io
import mmap
import os
import pickle
import socket
import struct
import tempfile
import weakref
from collections import deque
from typing import IO, Any, NamedTuple, NoReturn

from sphere_nmpc.foreign.code import called

_HEADER = struct.Struct("!QQ")
"""Before each message: its length [bytes], and the number of shared memories that belong to it."""
_READ_AT_ONCE = 1 << 18
"""Bytes: what a socket of Linux holds by default."""
_MAX_DESCRIPTORS = 253
"""File descriptors that Linux passes at once."""


class ChannelEndError(Exception):
    """Transport has failed: the other end is closed, or the system does not pass messages on."""


class ContentError(Exception):
    """Object that has arrived as a whole and cannot be read; the channel goes on."""


class SharedMemory:
    """Memory of two processes that is freed when the last one has ended or dropped it.

    It is a file without a name, so that nothing is left of it whatever ends a process, and a
    message that is under way keeps it. Objects of the same memory are equal.

    Parameters
    ----------
    file : binary file
        The file, which this object closes.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        weakref.finalize(self, file.close)
        status = os.fstat(file.fileno())
        self._identity = status.st_dev, status.st_ino

    @classmethod
    def of(cls, *parts: memoryview) -> "SharedMemory":
        """Return memory with a copy of some bytes, one part after the other.

        OSError is raised where there is not enough of it.
        """
        try:
            file: IO[bytes] = os.fdopen(os.memfd_create("sphere_nmpc"), "w+b", buffering=0)
        except (AttributeError, OSError):  # Linux alone has it
            file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - closed by `cls`
        memory = cls(file)
        for part in parts:
            left = part.cast("B")
            while left:
                left = left[file.write(left) :]
        return memory

    def mapped(self) -> mmap.mmap:
        """Return the bytes, which cannot be changed; they stay as long as what is returned."""
        return mmap.mmap(self.fileno(), 0, access=mmap.ACCESS_READ)

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._file.fileno()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SharedMemory) and other._identity == self._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    def __reduce__(self) -> NoReturn:
        raise TypeError("shared memory can only be sent through a channel")


class Message(NamedTuple):
    """Object as it is sent: a pickle, and the shared memories that it refers to."""

    content: bytes
    memories: tuple[SharedMemory, ...] = ()


class Channel:
    """One end of a pipe between a process and a child that it has started, for whole objects.

    Objects are pickled, and reading a pickle can run any code. So this is for the two ends of a
    socket pair alone, of which one was handed to the child when it was started: nobody else can
    write to it.
    """

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._read = bytearray()
        self._memories: deque[SharedMemory] = deque()

    @classmethod
    def inherited(cls, descriptor: int) -> "Channel":
        """Return the end whose file descriptor was handed to this process."""
        return cls(socket.socket(fileno=descriptor))

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close this end; the other one then has nothing more to receive."""
        self._socket.close()

    def never_wait(self) -> None:
        """Do not wait from now on: `receive` raises BlockingIOError where it would have to."""
        self._socket.setblocking(False)

    def send(self, message: Message) -> None:
        """Send what `encoded` has returned.

        `ChannelEndError` is raised where that fails, also because one would have to wait.
        """
        content, memories = message
        left = memoryview(_HEADER.pack(len(content), len(memories)) + content)
        try:
            if memories:
                descriptors = [memory.fileno() for memory in memories]
                left = left[socket.send_fds(self._socket, [left], descriptors) :]
            self._socket.sendall(left)
        except OSError as error:
            raise ChannelEndError(f"nothing can be sent: {error}") from error

    def receive(self) -> Any:
        """Return the next object.

        `ChannelEndError` is raised where none will come, `ContentError` if it cannot be read, and
        BlockingIOError after `never_wait` where it has not arrived as a whole; what has is kept.
        """
        while len(self._read) < _HEADER.size:
            self._more()
        length, number = _HEADER.unpack_from(self._read)
        end = _HEADER.size + length
        while len(self._read) < end:
            self._more()
        content = bytes(self._read[_HEADER.size : end])
        del self._read[:end]
        memories = [self._memories.popleft() for _ in range(number)]
        try:
            # Modules are imported for it, whoever has written them.
            return called(_Unpickler(content, memories).load)
        except Exception as error:
            raise ContentError(f"{type(error).__name__}: {error}") from error

    def _more(self) -> None:
        try:
            arrived, descriptors, flags, _ = socket.recv_fds(
                self._socket, _READ_AT_ONCE, _MAX_DESCRIPTORS
            )
        except BlockingIOError:
            raise
        except OSError as error:
            raise ChannelEndError(f"nothing can be received: {error}") from error
        self._memories += [SharedMemory(os.fdopen(number, "rb")) for number in descriptors]
        if not arrived:
            raise ChannelEndError("the other end is closed")
        if flags & socket.MSG_CTRUNC:
            raise ChannelEndError("too many files are open for shared memory to be received")
        self._read += arrived


def encoded(message: object) -> Message:
    """Return an object as `Channel.send` takes it; raises where it cannot be pickled."""
    content = io.BytesIO()
    pickler = _Pickler(content)
    pickler.dump(message)
    return Message(content.getvalue(), tuple(pickler.memories))


class _Pickler(pickle.Pickler):
    """Pickler that writes the number of a shared memory in its place."""

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        memories: dict[SharedMemory, int] = {}
        self.memories = memories
        # Called for shared memories alone; `persistent_id` would be for each of all objects. It
        # does not refer to the pickler, which would be freed as garbage only.
        self.dispatch_table = {
            SharedMemory: lambda one: (
                _memory_of_message, (memories.setdefault(one, len(memories)),)
            )
        }


class _Unpickler(pickle.Unpickler):
    """Unpickler that finds shared memories by their numbers."""

    def __init__(self, content: bytes, memories: list[SharedMemory]) -> None:
        super().__init__(io.BytesIO(content))
        self._memories = memories

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == (__name__, _memory_of_message.__name__):
            return self._memories.__getitem__
        return super().find_class(module, name)


def _memory_of_message(number: int) -> NoReturn:
    """Stand for a shared memory of a message, by its number."""
    raise pickle.UnpicklingError(f"shared memory {number} belongs to a message of a channel")

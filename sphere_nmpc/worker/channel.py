# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Pipe between a process and a child that it has started, for objects as whole messages.

Objects are pickled, and reading a pickle can run any code. So this is for the two ends of a socket
pair alone, of which one was handed to the child when it was started: nobody else can write to it.
"""

import pickle
import socket
import struct
from typing import Any

_LENGTH = struct.Struct("!Q")
"""Length of a message [bytes], which comes before it."""
_READ_AT_ONCE = 1 << 18
"""Bytes: what a socket of Linux holds by default."""


class Channel:
    """One end of the pipe.

    Parameters
    ----------
    connected : socket
        A connected socket, which the channel closes.
    """

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._read = bytearray()

    @classmethod
    def pair(cls) -> tuple["Channel", "Channel"]:
        """Return both ends; OSError where the system allows no further ones."""
        here, there = socket.socketpair()
        return cls(here), cls(there)

    @classmethod
    def inherited(cls, descriptor: int) -> "Channel":
        """Return the end whose file descriptor was handed to this process."""
        return cls(socket.socket(fileno=descriptor))

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close this end; reading from the other one then ends with EOFError."""
        self._socket.close()

    def never_wait(self) -> None:
        """Raise BlockingIOError from now on where sending or `receive` would have to wait."""
        self._socket.setblocking(False)

    def send(self, message: bytes) -> None:
        """Send what `encoded` has returned."""
        self._socket.sendall(_LENGTH.pack(len(message)) + message)

    def receive(self) -> Any:
        """Return the next object.

        Raises
        ------
        BlockingIOError
            After `never_wait`, where the object has not arrived as a whole; what has is kept.
        EOFError
            If the other end is closed.
        Exception
            Any other where the object cannot be read.
        """
        while len(self._read) < _LENGTH.size:
            self._more()
        (length,) = _LENGTH.unpack_from(self._read)
        end = _LENGTH.size + length
        while len(self._read) < end:
            self._more()
        message = bytes(self._read[_LENGTH.size : end])
        del self._read[:end]
        return pickle.loads(message)

    def _more(self) -> None:
        arrived = self._socket.recv(_READ_AT_ONCE)
        if not arrived:
            raise EOFError("the other end is closed")
        self._read += arrived


def encoded(message: object) -> bytes:
    """Return an object as `Channel.send` takes it; raises where it cannot be pickled."""
    return pickle.dumps(message, pickle.HIGHEST_PROTOCOL)

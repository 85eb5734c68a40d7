# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Two network namespaces connected by a link that delays and loses packets; Linux, as root.

A bridge in a third namespace, this file as a program, delays or drops each frame. The ``netem`` of
many kernels would do the same, but not every kernel has it.
"""

import contextlib
import dataclasses
import heapq
import itertools
import os
import random
import select
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

ADDRESSES = ("10.77.0.1", "10.77.0.2")
_ALL_FRAMES = 0x0003
_SOL_PACKET, _VNET_HEADER, _OUTGOING = 263, 15, 4
_LARGEST = 1 << 17
_BURST_EVERY = 10.0
"""Time between the starts of two bursts of loss [s]."""
_READY = 5.0
"""Longest wait until the bridge has opened both ends, and until these are in operation [s]."""


class LinkError(RuntimeError):
    """Namespaces or links cannot be created on this machine."""


@dataclass(frozen=True)
class Quality:
    """Delay and loss of packets, the same in either direction."""

    delay: float
    """Mean delay [s]."""
    jitter: float
    """Largest difference of a drawn delay from it, so that packets overtake [s]."""
    loss: float
    """Share of packets that are lost."""
    burst: float = 0.0
    """Time in every 10 s for which everything is lost [s]."""


@contextlib.contextmanager
def lossy_link(quality: Quality) -> Iterator[tuple[str, str]]:
    """Connect two new namespaces, yield their names, and remove everything at the end.

    Their addresses are `ADDRESSES`. `LinkError` is raised where that is not possible.
    """
    if shutil.which("ip") is None:
        raise LinkError("the command 'ip' is not there (on Debian and Ubuntu: iproute2)")
    one, other, middle = (f"sphere_{os.getpid()}_{place}" for place in "abm")
    with contextlib.ExitStack() as undo:
        for name in (one, other, middle):
            _ip("netns", "add", name)
            undo.callback(_ip, "netns", "del", name)
            _ip("-n", name, "link", "set", "lo", "up")
        ends = ((one, "end_a"), (other, "end_b"))
        for host, end in ends:
            _join((end, host), (f"to_{end}", middle))
            _ip("-n", middle, "link", "set", f"to_{end}", "up")
        undo.enter_context(_bridge(quality, middle))
        for (host, end), address in zip(ends, ADDRESSES, strict=True):
            _ip("-n", host, "address", "add", f"{address}/24", "dev", end)
            _ip("-n", host, "link", "set", end, "up")
        for host, end in ends:
            _wait_until_running(host, end)
        yield one, other


def _ip(*arguments: str) -> str:
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise LinkError(f"ip {' '.join(arguments)}: {done.stderr.strip()}")
    return done.stdout


def _wait_until_running(host: str, end: str) -> None:
    """Wait until an interface is in operation: the kernel reports carriers once a second only."""
    give_up = time.monotonic() + _READY
    while " state UP " not in _ip("-n", host, "-oneline", "link", "show", "dev", end):
        if time.monotonic() > give_up:
            raise LinkError(f"{end} of {host} was not in operation within {_READY:g} s")
        time.sleep(0.02)


def _join(end: tuple[str, str], other: tuple[str, str]) -> None:
    """Create a link between two interfaces, each given with its namespace."""
    _ip("link", "add", "name", end[0], "netns", end[1], "type", "veth",
        "peer", "name", other[0], "netns", other[1])


@contextlib.contextmanager
def _bridge(quality: Quality, namespace: str) -> Iterator[None]:
    numbers = [f"{value:g}" for value in dataclasses.astuple(quality)]
    program = [sys.executable, __file__, "to_end_a", "to_end_b", *numbers]
    process = subprocess.Popen(
        ["ip", "netns", "exec", namespace, *program], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        ready, _, _ = select.select([process.stdout], [], [], _READY)
        if not ready or "ready" not in process.stdout.readline():
            raise LinkError("the bridge did not start")
        yield
    finally:
        process.send_signal(signal.SIGTERM)
        printed, _ = process.communicate()
        print(f"  bridge: {printed.strip()}", flush=True)


def _run_bridge(ends: tuple[str, str], quality: Quality) -> None:
    """Forward frames, delayed or not at all, until SIGTERM."""
    sockets = [_packet_socket(name) for name in ends]
    opposite = {sockets[0]: sockets[1], sockets[1]: sockets[0]}
    pending: list[tuple[float, int, socket.socket, bytes]] = []
    numbers, received, lost, late = itertools.count(), 0, 0, 0.0
    stop: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: stop.append(number))
    print("ready", flush=True)
    while not stop:
        wait = max(0.0, pending[0][0] - time.monotonic()) if pending else 0.1
        readable, _, _ = select.select(sockets, [], [], min(wait, 0.1))
        for end in readable:
            frame, address = end.recvfrom(_LARGEST)
            if address[2] == _OUTGOING:
                continue
            received += 1
            in_burst = time.monotonic() % _BURST_EVERY < quality.burst
            if in_burst or random.random() < quality.loss:
                lost += 1
                continue
            delay = quality.delay + quality.jitter * random.uniform(-1.0, 1.0)
            due = time.monotonic() + max(0.0, delay)
            heapq.heappush(pending, (due, next(numbers), opposite[end], frame))
        while pending and pending[0][0] <= time.monotonic():
            due, _, end, frame = heapq.heappop(pending)
            late = max(late, time.monotonic() - due)
            with contextlib.suppress(OSError):
                end.send(frame)
    print(f"{received} frames, {lost} lost, at most {1e3 * late:.1f} ms later than drawn")


def _packet_socket(name: str) -> socket.socket:
    end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ALL_FRAMES))
    # With this header, checksums that are left to the interface are left to the next one.
    end.setsockopt(_SOL_PACKET, _VNET_HEADER, 1)
    end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    end.bind((name, 0))
    return end


if __name__ == "__main__":
    _run_bridge((sys.argv[1], sys.argv[2]), Quality(*map(float, sys.argv[3:])))

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Invalid input at the viewer's port causes at most one line, and the viewer keeps serving."""

import random
import re
import resource
import socket
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import msgspec.msgpack
import pytest

pytest.importorskip("viser")

from page_helpers import page_of
from patience import PATIENCE
from recorded_bags import rolling_messages, write_own
from test_access import PROTOCOL, shake_hands
from verb_process import stop
from websockets.exceptions import ConnectionClosed

from sphere_nmpc.model.state import make_state
from sphere_sim.ros.session.child_process import verb_command
from sphere_sim.viewer.frame import Capabilities, Frame
from sphere_sim.viewer.source import Request, SendGoal, SetGoal
from sphere_sim.viewer.viewer import Viewer

pack = msgspec.msgpack.encode
RANDOM = random.Random(1)
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [1, 1, 1], "fov": 1.0,
    "near": 0.1, "far": 100.0, "image_height": 100, "image_width": 100, "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
}
NAN = float("nan")
ODD = (None, NAN, 1e308, "x", [], ["a"], {}, [NAN] * 3, [NAN] * 4, [0] * 4, [1e300] * 3)
MESSAGES = (
    RANDOM.randbytes(100), b"", "text", pack(5), pack([1, 2]), pack({}), pack({"type": "Nothing"}),
    pack({"type": ["a"]}), pack({"type": "GuiUpdateMessage"}), bytes(51 * 2**20),
    pack({**CAMERA, "wxyz": [1, 2, 3]}), pack({**CAMERA, "position": "x"}),
)


def http(port: int, *lines: str) -> bytes:
    return "\r\n".join((*lines, f"Host: 127.0.0.1:{port}", "", "")).encode()


def half_a_handshake(port: int, query: str, *lines: str) -> bytes:
    return http(port, f"GET /?{query} HTTP/1.1", "Upgrade: websocket", *lines)


def invalid_requests(port: int, query: str) -> tuple[bytes, ...]:
    return (
        b"", RANDOM.randbytes(5000), b"\x00\x01\r\n\r\n", b"\x16\x03\x01\x02\x00\x01\x00",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", b"GET / HTTP/1.1\r\nHost: x",
        b"GET /" + 100_000 * b"a" + b" HTTP/1.1\r\n\r\n",
        http(port, "POST / HTTP/1.1"), http(port, "HEAD / HTTP/1.1"),
        http(port, f"GET //[x?{query} HTTP/1.1"), http(port, f"GET /%2e%2e?{query} HTTP/1.1"),
        http(port, "GET / HTTP/1.1", "Host: b", "Upgrade: websocket", "Upgrade: websocket"),
        half_a_handshake(port, query),
        half_a_handshake(port, query, "Upgrade: websocket", f"Sec-WebSocket-Protocol: {PROTOCOL}"),
        half_a_handshake(port, query, "Connection: Upgrade", "Sec-WebSocket-Key: x",
                         f"Sec-WebSocket-Protocol: {PROTOCOL}", "Sec-WebSocket-Version: 1"),
    )


def send_raw(port: int, data: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", port), timeout=2.0) as end:
        end.settimeout(0.2)
        with suppress(OSError):
            end.sendall(data)
            return end.recv(200)
    return b""


class Process:
    """Viewer of a recording in a process."""

    def __init__(self, folder: Path, limit: Callable[[], None] | None = None) -> None:
        self.folder = folder
        bag = folder / "bag"
        if not bag.exists():
            write_own(bag, rolling_messages())
        command = verb_command("viewer", "--port", "0", "--replay", str(bag))
        with (folder / "viewer.log").open("wb") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log, preexec_fn=limit)

    def __enter__(self) -> "Process":
        end = time.monotonic() + PATIENCE
        while not self.url:
            assert self.process.poll() is None and time.monotonic() < end, self.log
            time.sleep(0.1)
        return self

    def __exit__(self, *exception: object) -> None:
        stop([self.process])

    @property
    def url(self) -> str:
        return page_of(self.folder)

    @property
    def log(self) -> str:
        return (self.folder / "viewer.log").read_text(encoding="utf-8")

    def serves(self) -> bool:
        with shake_hands(self.url) as page:
            return len(page.recv(timeout=PATIENCE)) > 0


def test_invalid_input_of_all_kinds_causes_one_line(tmp_path) -> None:
    with Process(tmp_path) as viewer:
        send_invalid_input(viewer)
        assert viewer.serves()
        # With the address anybody on this machine could send goals.
        assert (viewer.folder / "viewer.log").stat().st_mode & 0o077 == 0
    assert "Traceback" not in viewer.log
    about_the_bag = re.compile(r"viewer: (http|no status|/\w+)")
    lines = [line for line in viewer.log.splitlines() if not about_the_bag.match(line)]
    assert len(lines) == 1, viewer.log
    assert lines[0].startswith("viewer: invalid input of a page was ignored: ")


def send_invalid_input(viewer: Process) -> None:
    page = urlsplit(viewer.url)
    for data in invalid_requests(page.port, page.query):
        send_raw(page.port, data)
    for message in MESSAGES:
        with shake_hands(viewer.url) as end, suppress(ConnectionClosed, TimeoutError):
            end.send(message)
            while True:
                end.recv(timeout=1.0)


def test_too_many_connections_cause_one_line_and_service_resumes(tmp_path) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40))

    with Process(tmp_path, limit) as viewer:
        port = urlsplit(viewer.url).port
        held = [socket.create_connection(("127.0.0.1", port)) for _ in range(60)]
        end = time.monotonic() + PATIENCE
        while "too many open files" not in viewer.log:
            assert time.monotonic() < end, viewer.log
            time.sleep(0.1)
        for connection in held:
            connection.close()
        assert viewer.serves()
        assert viewer.log.count("too many open files") == 1 and "Traceback" not in viewer.log


class Script:
    """Source of one constant frame that collects requests."""

    def __init__(self) -> None:
        self.requests: list[Request] = []

    def frames(self) -> list[Frame]:
        state = make_state((1.0, 2.0), (1.0, 0.0, 0.0, 0.0))
        capabilities = Capabilities(pause=True, reset=True, speed=1.0, strategies=("a", "b"))
        return [Frame(state=state, goal=state, capabilities=capabilities)]

    def handle(self, request: Request) -> str:
        self.requests.append(request)
        return "noted"


def odd_messages(viewer: Viewer) -> Iterator[dict]:
    """Yield messages of a page with invalid values."""
    for odd in ODD:
        for uuid in viewer._server.gui._gui_input_handle_from_uuid:
            yield {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": odd}}
        for name in ("/goal", "/goal/turn"):
            moved = {"type": "TransformControlsUpdateMessage", "name": name}
            yield {**moved, "wxyz": odd, "position": [0, 0, 0]}
            yield {**moved, "wxyz": [1, 0, 0, 0], "position": odd}
        yield {**CAMERA, "position": odd, "look_at": odd}
        yield {**CAMERA, "fov": odd, "near": odd, "image_width": odd}


@pytest.mark.slow
def test_invalid_values_do_not_end_the_viewer(capfd) -> None:
    script = Script()
    viewer = Viewer(script, 0, live=True)
    try:
        viewer.tick()
        messages = deque(odd_messages(viewer))
        while messages:
            # One page sends all of them; another one continues if it is disconnected.
            with suppress(ConnectionClosed), shake_hands(viewer.url) as page:
                page.send(pack(CAMERA))
                while messages:
                    page.send(pack(messages.popleft()))
                    answered, end = page.ping(), time.monotonic() + PATIENCE
                    while not answered.wait(0.0):
                        assert time.monotonic() < end, "no answer"
                        with suppress(TimeoutError):
                            page.recv(timeout=0.01)
                    viewer.tick()
                    viewer._panel.put(SendGoal())
            viewer.tick()
        with shake_hands(viewer.url) as page:
            assert len(page.recv(timeout=PATIENCE)) > 0
    finally:
        viewer.close()
    goals = [request.goal for request in script.requests if isinstance(request, SetGoal)]
    assert goals and all(abs(goal[2:] @ goal[2:] - 1.0) < 1e-9 for goal in goals)
    printed = capfd.readouterr()
    assert "Traceback" not in printed.err and "Warning" not in printed.err
    assert printed.out == "" and len(printed.err.splitlines()) <= 3

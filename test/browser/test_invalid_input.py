# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Invalid input at the viewer's port causes at most one line a kind, and the viewer continues."""

import random
import resource
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from urllib.parse import urlsplit

import msgspec.msgpack
import pytest

pytest.importorskip("viser")

from pages import PROTOCOL, Script, shake_hands
from patience import PATIENCE
from websockets.exceptions import ConnectionClosed

from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import make_state
from sphere_sim.viewer.source import Capabilities, Frame, SendGoal, SetGoal
from sphere_sim.viewer.viewer import Viewer

pytestmark = pytest.mark.slow
pack = msgspec.msgpack.encode
RANDOM = random.Random(1)
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [1, 1, 1], "fov": 1.0,
    "near": 0.1, "far": 100.0, "image_height": 100, "image_width": 100, "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
}
NAN = float("nan")
ODD = (None, NAN, 1e308, "x", [], ["a"], {}, [NAN] * 3, [NAN] * 4, [0] * 4, [1e300] * 3)


def invalid_requests(port: int, query: str) -> Iterator[bytes]:
    yield from (
        b"", RANDOM.randbytes(5000), b"\x00\x01\r\n\r\n", b"\x16\x03\x01\x02\x00\x01\x00",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", b"GET / HTTP/1.1\r\nHost: x",
        b"GET /" + 100_000 * b"a" + b" HTTP/1.1\r\n\r\n",
    )
    upgrade = f"GET /?{query} HTTP/1.1", "Upgrade: websocket"
    protocol = f"Sec-WebSocket-Protocol: {PROTOCOL}"
    for lines in (
        ("POST / HTTP/1.1",), (f"GET //[x?{query} HTTP/1.1",), (f"GET /%2e%2e?{query} HTTP/1.1",),
        (f"GET /{300 * 'a'}?{query} HTTP/1.1",), upgrade,
        (*upgrade, "Upgrade: websocket", protocol),
        (*upgrade, "Connection: Upgrade", "Sec-WebSocket-Key: x", protocol,
         "Sec-WebSocket-Version: 1"),
    ):
        yield "\r\n".join((*lines, f"Host: 127.0.0.1:{port}", "", "")).encode()


def invalid_messages(viewer: Viewer) -> Iterator[bytes | str]:
    yield from (
        RANDOM.randbytes(100), b"", "text", pack(5), pack({}), pack({"type": "Nothing"}),
        pack({"type": ["a"]}), pack({"type": "GuiUpdateMessage"}), bytes(51 * 2**20),
        pack({**CAMERA, "wxyz": [1, 2, 3]}), pack({**CAMERA, "position": "x"}),
    )
    for odd in ODD:
        for uuid in viewer._server.gui._gui_input_handle_from_uuid:
            yield pack({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": odd}})
        for name in ("/goal", "/goal/turn"):
            moved = {"type": "TransformControlsUpdateMessage", "name": name}
            yield pack({**moved, "wxyz": odd, "position": [0, 0, 0]})
            yield pack({**moved, "wxyz": [1, 0, 0, 0], "position": odd})
        yield pack({**CAMERA, "position": odd, "look_at": odd, "fov": odd, "image_width": odd})


@pytest.fixture
def script() -> Script:
    script, state = Script(), make_state((1.0, 2.0), (1.0, 0.0, 0.0, 0.0))
    can = Capabilities(pause=True, reset=True, speed=1.0, strategies=("a", "b"))
    script.next = [Frame(state=state, goal=Goal(state), capabilities=can)]
    return script


@pytest.fixture
def viewer(script) -> Iterator[Viewer]:
    viewer = Viewer(script, 0, live=True)
    viewer.tick()
    yield viewer
    viewer.close()


def test_invalid_input_does_not_end_the_viewer(viewer, script, capfd) -> None:
    url = urlsplit(viewer.url)
    for data in invalid_requests(url.port, url.query):
        with socket.create_connection(("127.0.0.1", url.port), timeout=2.0) as end:
            end.settimeout(0.2)
            with suppress(OSError):
                end.sendall(data)
                end.recv(200)
    messages = list(invalid_messages(viewer))
    while messages:
        # One page sends all of them; another one continues if it is disconnected.
        with suppress(ConnectionClosed), shake_hands(viewer.url) as page:
            page.send(pack(CAMERA))
            while messages:
                page.send(messages.pop())
                answered, end = page.ping(), time.monotonic() + PATIENCE
                while not answered.wait(0.0):
                    assert time.monotonic() < end, "no answer"
                    with suppress(TimeoutError):
                        page.recv(timeout=0.01)
                viewer._panel.put(SendGoal())
                viewer.tick()
    with shake_hands(viewer.url) as page:
        assert len(page.recv(timeout=PATIENCE)) > 0
    goals = [request.goal for request in script.requests if isinstance(request, SetGoal)]
    assert goals and all(abs(goal[2:] @ goal[2:] - 1.0) < 1e-9 for goal in goals)
    printed = capfd.readouterr()
    assert printed.out == "" and len(printed.err.splitlines()) == 1, printed.err
    assert printed.err.startswith("viewer: invalid input of a page was ignored: ")


def test_too_many_connections_cause_one_line_and_service_resumes(viewer, capfd) -> None:
    held, text = [socket.socket() for _ in range(20)], ""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    end = time.monotonic() + PATIENCE
    try:
        # Sockets take the lowest free numbers: beyond the last of these none is left.
        resource.setrlimit(resource.RLIMIT_NOFILE, (held[-1].fileno() + 1, before[1]))
        for connection in held:
            connection.connect(("127.0.0.1", urlsplit(viewer.url).port))
        while "too many open files" not in text:
            assert time.monotonic() < end, text
            time.sleep(0.1)
            text += capfd.readouterr().err
    finally:
        for connection in held:
            connection.close()
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
    with shake_hands(viewer.url) as page:
        assert len(page.recv(timeout=PATIENCE)) > 0
    assert len((text + capfd.readouterr().err).splitlines()) == 1

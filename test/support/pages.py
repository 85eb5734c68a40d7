# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Pages of the viewer without a browser: a source of given frames, and a page's connection."""

import socket
from collections.abc import Sequence
from urllib.parse import urlsplit

import viser
from websockets.sync.client import ClientConnection, connect

from sphere_sim.viewer.source import Frame, Request

PROTOCOL = f"viser-v{viser.__version__}"


class Script:
    """Source of given frames that collects requests."""

    def __init__(self) -> None:
        self.next: list[Frame] = [Frame()]
        self.requests: list[Request] = []
        self.answer = ""

    def frames(self) -> Sequence[Frame]:
        return self.next

    def handle(self, request: Request) -> str:
        self.requests.append(request)
        return self.answer


def shake_hands(
    url: str, origin: str | None = None, host: str = "127.0.0.1", protocol: str = PROTOCOL
) -> ClientConnection:
    """Open a WebSocket at a page's address."""
    page = urlsplit(url)
    address = f"ws://{host}:{page.port}/?{page.query}"
    end = socket.create_connection(("127.0.0.1", page.port))
    return connect(address, sock=end, origin=origin, subprotocols=[protocol], max_size=None)

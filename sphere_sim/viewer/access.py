# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Access control of the viewer: requests need the token of its address and its own origin.

Any page that is open in a browser of this machine may send requests to 127.0.0.1, and so may any
user of the machine. The token keeps both out. The checks of Host and Origin keep out a page of
another site that has obtained the token, or that uses a name which resolves to this machine (DNS
rebinding).
"""

import secrets
from collections.abc import Callable
from http import HTTPStatus
from urllib.parse import parse_qs

import viser
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

RequestHandler = Callable[[ServerConnection, Request], Response | None]
"""Answers a request, or returns None to continue with the WebSocket handshake."""
HOST = "127.0.0.1"
_PROTOCOL = f"viser-v{viser.__version__}"


class AccessControl:
    """Check of every request to a port before the page, or its WebSocket, is served."""

    def __init__(self, port: int) -> None:
        self._token = secrets.token_urlsafe(16)
        self._hosts = tuple(f"{name}:{port}" for name in (HOST, "localhost"))
        self.is_installed = False
        """Whether a server passes its requests through this check."""

    @property
    def url(self) -> str:
        """Address of the page, with the token."""
        return f"http://{self._hosts[0]}/?token={self._token}"

    def protect(self, serve: RequestHandler) -> RequestHandler:
        """Return a handler that refuses requests, or else answers them as `serve` does."""
        self.is_installed = True

        def process(connection: ServerConnection, request: Request) -> Response | None:
            refusal = self.refusal(request)
            if refusal:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{refusal}\n")
            websocket = f"ws://{request.headers['Host']}/?token={self._token}"
            if "Upgrade" not in request.headers and websocket != _query(request, "websocket"):
                # The page reads the address of its WebSocket from its own address. A cookie would
                # work too, but browsers send cookies to every port of a machine.
                answer = connection.respond(HTTPStatus.FOUND, "")
                answer.headers["Location"] = f"/?token={self._token}&websocket={websocket}"
                return answer
            return serve(connection, request)

        return process

    def refusal(self, request: Request) -> str:
        """Return why a request is refused, with a remedy; empty for an accepted request."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            port = self._hosts[0].rpartition(":")[2]
            return (
                f"Host: expected {' or '.join(self._hosts)}; from another machine tunnel the same "
                f"port: ssh -L {port}:{self._hosts[0]} ROBOT"
            )
        # Browsers always send the origin of a page that opens a WebSocket; other programs may not.
        if any(origin != f"http://{hosts[0]}" for origin in origins):
            return f"Origin: expected http://{hosts[0]}; open the address that the viewer printed"
        # Bytes of a request that are not ASCII arrive as lone surrogates.
        given = _query(request, "token").encode(errors="surrogateescape")
        if not secrets.compare_digest(given, self._token.encode()):
            return (
                "token: missing or wrong; open the address that the viewer printed when it was "
                f"started: http://{hosts[0]}/?token=..."
            )
        protocols = ",".join(request.headers.get_all("Sec-WebSocket-Protocol"))
        if "Upgrade" in request.headers and _PROTOCOL not in map(str.strip, protocols.split(",")):
            return f"Sec-WebSocket-Protocol: expected {_PROTOCOL}; reload the page"
        return ""


def _query(request: Request, name: str) -> str:
    """Return the value of a query field; empty unless the field occurs exactly once."""
    values = parse_qs(request.path.partition("?")[2]).get(name, [])
    return values[0] if len(values) == 1 else ""

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Who is let in to the viewer: whoever knows the token in its address, from its own page.

Any page that is open in a browser of this machine may send requests to 127.0.0.1, and so may any
user of the machine. The token keeps both out; Host and Origin keep out a page of another site that
has come by the token, or by a name that leads here (DNS rebinding).
"""

import secrets
from collections.abc import Callable
from http import HTTPStatus
from urllib.parse import parse_qs

import viser
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

ProcessRequest = Callable[[ServerConnection, Request], Response | None]
"""Answers a request, or returns None for the WebSocket's handshake to go on."""
HOST = "127.0.0.1"
_NAMES = (HOST, "localhost")
_PROTOCOL = f"viser-v{viser.__version__}"


class Gate:
    """Looks at every request before the page, or its WebSocket, is served.

    Parameters
    ----------
    port : int
        Where the server listens.
    """

    def __init__(self, port: int) -> None:
        self._token = secrets.token_urlsafe(16)
        self._hosts = tuple(f"{name}:{port}" for name in _NAMES)
        self.stands = False
        """Whether a server asks it."""

    @property
    def url(self) -> str:
        """Address of the page, with the token."""
        return f"http://{self._hosts[0]}/?token={self._token}"

    def before(self, serve: ProcessRequest) -> ProcessRequest:
        """Return what answers requests: with a refusal, or else as `serve` does."""
        self.stands = True

        def process(connection: ServerConnection, request: Request) -> Response | None:
            refusal = self.refusal(request)
            if refusal:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{refusal}\n")
            if "Upgrade" not in request.headers and self._socket_of(request) != self._asked(
                request, "websocket"
            ):
                # The page takes the address of its WebSocket from its own. A cookie would do as
                # well, but browsers send those to all ports of a machine, whoever listens there.
                answer = connection.respond(HTTPStatus.FOUND, "")
                answer.headers["Location"] = (
                    f"/?token={self._token}&websocket={self._socket_of(request)}"
                )
                return answer
            return serve(connection, request)

        return process

    def refusal(self, request: Request) -> str:
        """Return why a request is refused and what to do about it; empty where it is not."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            port = self._hosts[0].rpartition(":")[2]
            return (
                f"Host: expected {' or '.join(self._hosts)}; from another machine tunnel the same "
                f"port: ssh -L {port}:{self._hosts[0]} ROBOT"
            )
        # Browsers say whose page opens a WebSocket; other programs need not.
        if any(origin != f"http://{hosts[0]}" for origin in origins):
            return f"Origin: expected http://{hosts[0]}; open the address that the viewer printed"
        given = self._asked(request, "token").encode()
        if not secrets.compare_digest(given, self._token.encode()):
            return (
                "token: missing or wrong; open the address that the viewer printed when it was "
                f"started: http://{hosts[0]}/?token=..."
            )
        protocols = ",".join(request.headers.get_all("Sec-WebSocket-Protocol"))
        if "Upgrade" in request.headers and _PROTOCOL not in map(str.strip, protocols.split(",")):
            return f"Sec-WebSocket-Protocol: expected {_PROTOCOL}; reload the page"
        return ""

    def _socket_of(self, request: Request) -> str:
        """Return the address of the WebSocket for the page that is asked for."""
        return f"ws://{request.headers['Host']}/?token={self._token}"

    @staticmethod
    def _asked(request: Request, name: str) -> str:
        """Return a field of the query; empty where it is not there once."""
        values = parse_qs(request.path.partition("?")[2]).get(name, [])
        return values[0] if len(values) == 1 else ""

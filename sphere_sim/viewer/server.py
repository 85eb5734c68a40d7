# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Web server of the viewer: on this machine only, with access control.

Any page that is open in a browser of this machine may send requests to 127.0.0.1, and so may any
user of the machine. The token of its address keeps both out. The checks of Host and Origin keep
out a page of another site that has obtained the token, or that uses a name which resolves to this
machine (DNS rebinding).
"""

import asyncio
import contextlib
import errno
import io
import logging
import os
import secrets
import socket
import stat
import sys
import warnings
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs

import viser
from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.reporting.fault_log import FaultLog

RequestHandler = Callable[[ServerConnection, Request], Response | None]
"""Answers a request, or returns None to continue with the WebSocket handshake."""
HOST = "127.0.0.1"
_PROTOCOL = f"viser-v{viser.__version__}"
DEFAULT_PORT = 8080
_HEAD = b"<title>Viser</title>", (
    b"<title>sphere_nmpc</title><style>@media (max-width: 36em) "
    b'{ [style*="max-height: 60%"] { max-height: 35% !important } }</style>'
)
"""Title of the page of viser, and what takes its place: a title, and a lower panel on a phone."""
_ERROR_PERIOD = 60.0
"""Least time between two messages about the same error of a connection [s]."""


class ServerError(SphereNmpcError):
    """Failure to serve the page."""


class AccessControl:
    """Check of every request to a port before the page, or its WebSocket, is served."""

    def __init__(self, port: int) -> None:
        self._token = secrets.token_urlsafe(16)
        self._hosts = tuple(f"{name}:{port}" for name in (HOST, "localhost"))
        self.url = f"http://{self._hosts[0]}/?token={self._token}"
        """Address of the page, with the token."""
        self.is_installed = False
        """Whether a server passes its requests through this check."""

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
            # The page has its scripts compressed, and its head is read here.
            if "Accept-Encoding" in request.headers:
                del request.headers["Accept-Encoding"]
            response = serve(connection, request)
            if response is not None and _HEAD[0] in response.body:
                response.body = response.body.replace(*_HEAD, 1)
                del response.headers["Content-Length"]
                response.headers["Content-Length"] = str(len(response.body))
            return response

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


class LocalServer(viser.ViserServer):
    """Server for clients on this machine that know its address with the token.

    A free port is used if the preferred one is taken. Raises `ServerError` if no port is
    available, or access control cannot be installed.
    """

    def __init__(self, port: int) -> None:
        listener = _listen(port)
        access = AccessControl(listener.getsockname()[1])
        self.url = access.url
        """Address of the page, with its access token."""
        # viser prints a banner; `announce` prints the address instead.
        with contextlib.redirect_stdout(io.StringIO()), _protected(access, listener):
            super().__init__(host=HOST, port=port, label="sphere_nmpc", verbose=False)
        if not access.is_installed:
            self.stop()
            raise ServerError(f"viser {viser.__version__} is not supported: no access control")
        self.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=(0, 114, 178)
        )
        self.gui.main_panel.dock_right()

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing where a page asks viser for a tunnel to this server through another host."""

    def stop(self) -> None:
        """Stop the server without the message of viser."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


def announce(url: str) -> None:
    """Print the address of the page, with which anybody on this machine can send goals.

    If standard output is a file, other users lose the right to read it.
    """
    with contextlib.suppress(OSError, AttributeError):
        mode = os.fstat(sys.stdout.fileno()).st_mode
        if stat.S_ISREG(mode):
            os.fchmod(sys.stdout.fileno(), stat.S_IMODE(mode) & ~(stat.S_IRWXG | stat.S_IRWXO))
    print(f"viewer: {url}", flush=True)


def _listen(preferred: int) -> socket.socket:
    """Return a socket that listens on this machine, on `preferred` or else on a free port."""
    try:
        # Without free file descriptors viser would wait for its event loop for ever.
        for end in (*socket.socketpair(), *socket.socketpair()):
            end.close()
        try:
            return socket.create_server((HOST, preferred))
        except OSError as error:
            listener = socket.create_server((HOST, 0))
            reason = os.strerror(error.errno or 0).lower()
            message = f"viewer: port {preferred}: {reason}; using {listener.getsockname()[1]}"
            print(message, file=sys.stderr, flush=True)
            return listener
    except OSError as error:
        reason = os.strerror(error.errno or 0).lower()
        raise ServerError(f"no port of {HOST} for the page: {reason}") from error


class _ConnectionErrors(logging.Handler):
    """Errors from the logger and the event loop of a server, as lines instead of tracebacks.

    Clients may send anything, at any rate, so the number of lines is limited.
    """

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self._log = FaultLog(
            lambda line: print(f"viewer: {line}", file=sys.stderr, flush=True), _ERROR_PERIOD
        )

    def emit(self, record: logging.LogRecord) -> None:
        """Report a log record, except failed handshakes, which any client can cause."""
        text = record.getMessage()
        if text != "opening handshake failed":
            self._report(text, record.exc_info[1] if record.exc_info else None)

    def handle_loop_error(
        self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]
    ) -> None:
        """Report an exception that nothing caught in the event loop."""
        self._report(str(context["message"]), context.get("exception"))

    def _report(self, text: str, error: BaseException | None) -> None:
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
            self._log.report(
                "a page has to wait", "too many open files; close pages or raise 'ulimit -n'"
            )
            return
        if error is not None:
            text += f", {type(error).__name__}: {error}"
        self._log.report("invalid input of a page was ignored", " ".join(text.split())[:200])


@contextlib.contextmanager
def _protected(access: AccessControl, listener: socket.socket) -> Iterator[None]:
    """Make a server that viser starts meanwhile use this listener and this access control.

    viser has no setting for either of them, nor for the logging of errors, but it calls
    ``websockets.asyncio.server.serve``, which has all three and is replaced meanwhile. A viser
    that serves in another way is recognised by its access control, which is not installed then.
    """
    serve = websockets_server.serve
    logger = logging.Logger("sphere_nmpc.viewer", logging.WARNING)
    errors = _ConnectionErrors()
    logger.addHandler(errors)
    # viser accepts values of a wrong shape with a warning, and fails on them later.
    warnings.filterwarnings("error", r"\[viser\] .* does not match annotation")
    # Pages may be closed at any time.
    warnings.filterwarnings("ignore", r"Queued a \w+ on a closed connection")

    def serve_protected(handler: Any, host: str, port: int, **settings: Any) -> Any:
        asyncio.get_running_loop().set_exception_handler(errors.handle_loop_error)
        settings["process_request"] = access.protect(settings["process_request"])
        return serve(handler, sock=listener, logger=logger, **settings)

    websockets_server.serve = serve_protected  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        websockets_server.serve = serve  # type: ignore[misc]

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The web server: on this machine only, behind a gate, and silent about itself."""

import asyncio
import contextlib
import io
import logging
import os
import socket
import stat
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import viser
from websockets.asyncio import server as websockets_server

from sphere_nmpc.errors import SphereNmpcError
from sphere_sim.viewer.complaints import Complaints
from sphere_sim.viewer.gate import HOST, Gate

DEFAULT_PORT = 8080


class ServerError(SphereNmpcError):
    """The page cannot be served."""


class LocalServer(viser.ViserServer):
    """A server for who knows its address on this machine.

    Parameters
    ----------
    port : int
        Where to listen; a free port if it is taken.

    Raises
    ------
    ServerError
        If no port can be had, or the server would stand open.
    """

    def __init__(self, port: int) -> None:
        listener = _listen(port)
        self._gate = Gate(listener.getsockname()[1])
        # viser draws a box about itself; the address is told by whoever starts the viewer.
        with contextlib.redirect_stdout(io.StringIO()), _behind(self._gate, listener):
            super().__init__(host=HOST, port=port, label="sphere_nmpc", verbose=False)
        if not self._gate.stands:
            self.stop()
            raise ServerError(f"viser {viser.__version__} serves in a way that is not known here")
        self.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=(0, 114, 178)
        )
        self.gui.main_panel.dock_right()

    @property
    def url(self) -> str:
        """Address of the page, with the token that lets in."""
        return self._gate.url

    def request_share_url(self, verbose: bool = True) -> None:
        """Refuse what a page could ask for: a tunnel to this server through a foreign host."""

    def stop(self) -> None:
        """End without a word."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()


def announce(url: str) -> None:
    """Print where the page is, for its owner alone: whoever reads the address may steer.

    A file that standard output goes to is no longer readable for others from then on.
    """
    with contextlib.suppress(OSError, AttributeError):
        mode = os.fstat(sys.stdout.fileno()).st_mode
        if stat.S_ISREG(mode):
            os.fchmod(sys.stdout.fileno(), stat.S_IMODE(mode) & ~(stat.S_IRWXG | stat.S_IRWXO))
    print(f"viewer: {url}", flush=True)


def _listen(preferred: int) -> socket.socket:
    """Return a socket that listens on this machine, at `preferred` or else at a free port."""
    try:
        # viser would wait for ever for an event loop that finds no file descriptors.
        for end in (*socket.socketpair(), *socket.socketpair()):
            end.close()
        try:
            return socket.create_server((HOST, preferred))
        except OSError as error:
            listener = socket.create_server((HOST, 0))
            reason = os.strerror(error.errno or 0).lower()
            told = f"viewer: port {preferred}: {reason}; taking {listener.getsockname()[1]}"
            print(told, file=sys.stderr, flush=True)
            return listener
    except OSError as error:
        reason = os.strerror(error.errno or 0).lower()
        raise ServerError(f"no port of {HOST} for the page: {reason}") from error


@contextlib.contextmanager
def _behind(gate: Gate, listener: socket.socket) -> Iterator[None]:
    """Let the server that viser starts meanwhile listen there and ask the gate.

    viser has no setting for either, nor for where complaints go.
    """
    serve = websockets_server.serve
    logger = logging.Logger("sphere_nmpc.viewer", logging.WARNING)
    complaints = Complaints()
    logger.addHandler(complaints)
    # viser takes values of another shape than announced, with a warning, and fails on them later.
    warnings.filterwarnings("error", r"\[viser\] .* does not match annotation")
    # A page may go any time.
    warnings.filterwarnings("ignore", r"Queued a \w+ on a closed connection")

    def serve_behind(handler: Any, host: str, port: int, **settings: Any) -> Any:
        asyncio.get_running_loop().set_exception_handler(complaints.take)
        settings["process_request"] = gate.before(settings["process_request"])
        return serve(handler, sock=listener, logger=logger, **settings)

    websockets_server.serve = serve_behind  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        websockets_server.serve = serve  # type: ignore[misc]

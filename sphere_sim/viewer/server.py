# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The web server: on this machine only, and silent about itself."""

import contextlib
import io
import socket

import viser

HOST = "127.0.0.1"
DEFAULT_PORT = 8080


class LocalServer(viser.ViserServer):
    """A server that nobody but this machine reaches.

    Parameters
    ----------
    port : int
        Where to listen; the next free port if it is taken.
    """

    def __init__(self, port: int) -> None:
        # viser draws a box about itself; the address is told by whoever starts the viewer.
        with contextlib.redirect_stdout(io.StringIO()):
            super().__init__(host=HOST, port=port, label="sphere_nmpc", verbose=False)
        self.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=(0, 114, 178)
        )
        self.gui.main_panel.dock_right()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.get_port()}"

    def request_share_url(self, verbose: bool = True) -> None:
        """Refuse what a page could ask for: a tunnel to this server through a foreign host."""


def free_port(preferred: int = DEFAULT_PORT) -> int:
    """Return `preferred` if nobody listens there, else a port that is free."""
    for port in (preferred, 0):
        with contextlib.suppress(OSError), socket.socket() as probe:
            probe.bind((HOST, port))
            return int(probe.getsockname()[1])
    return preferred

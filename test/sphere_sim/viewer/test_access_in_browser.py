# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Access control of the viewer, by pages in a real browser."""

import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import pytest

pytest.importorskip("viser")

from browser import Browser, find_browser
from patience import PATIENCE
from test_access import PROTOCOL

from sphere_sim.viewer.server import LocalServer

BROWSER = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here: apt-get install chromium"),
]
LURE = """<script>
const socket = new WebSocket(%s, %s);
socket.onopen = () => document.body.append("it is open");
socket.onerror = () => document.body.append("it is closed");
</script><body></body>"""


@pytest.fixture
def server() -> Iterator[LocalServer]:
    server = LocalServer(0)
    server.gui.add_markdown("this is the panel")
    yield server
    server.stop()


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Browser]:
    home = tmp_path / "browser"
    home.mkdir()
    with Browser(BROWSER, home) as page:
        yield page


def test_page_loads_and_reloads_under_both_names(server, page) -> None:
    for address in (server.url, server.url.replace("127.0.0.1", "localhost")):
        page.open(address)
        page.wait_for("this is the panel")
        page.evaluate("document.body.append('stale')")
        page.call("Page.reload")
        end = time.monotonic() + PATIENCE
        while "stale" in page.text or "this is the panel" not in page.text:
            assert time.monotonic() < end, page.text
            time.sleep(0.1)
        assert server.get_clients()
    assert page.console == []


def test_page_without_the_token_shows_a_remedy(server, page) -> None:
    page.open(server.url.partition("?")[0])
    page.wait_for("open the address that the viewer printed")
    assert not server.get_clients()


@pytest.mark.parametrize("knows_token", [False, True])
def test_page_of_another_site_cannot_connect(server, page, knows_token) -> None:
    port, query = urlsplit(server.url).port, urlsplit(server.url).query
    socket = f"ws://127.0.0.1:{port}/" + (f"?{query}" if knows_token else "")
    lure = (LURE % (json.dumps(socket), json.dumps(PROTOCOL))).encode()

    class Evil(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(lure)

        def log_message(self, *about: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Evil) as site:
        threading.Thread(target=site.serve_forever, daemon=True).start()
        page.open(f"http://127.0.0.1:{site.server_port}/")
        page.wait_for("it is ")
        assert "it is closed" in page.text
        site.shutdown()
    assert not server.get_clients()

# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Access control of the viewer, by real handshakes."""

import socket
import urllib.error
import urllib.request
from collections.abc import Iterator
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest

pytest.importorskip("viser")

import viser
import viser.infra._infra
import websockets.asyncio.server
from pages import shake_hands
from patience import PATIENCE
from websockets.exceptions import InvalidStatus

from sphere_sim.viewer.server import LocalServer, ServerError


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    server = LocalServer(0)
    yield server
    server.stop()


def refusal(url: str, **how: str) -> str:
    """Return the line with which the server refuses a WebSocket."""
    with pytest.raises(InvalidStatus) as error:
        shake_hands(url, **how)
    assert error.value.response.status_code == 403
    (line,) = bytes(error.value.response.body).decode().splitlines()
    return line


def get(url: str, host: str = "") -> tuple[int, str]:
    """Return status and body of a page."""
    request = urllib.request.Request(url, headers={"Host": host} if host else {})
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_page_has_the_title_of_this_package(server) -> None:
    status, page = get(f"{server.url}&websocket=ws://127.0.0.1:{server.get_port()}/?"
                       f"{urlsplit(server.url).query}")
    assert status == 200 and page.count("<title>") == 1
    assert "<title>sphere_nmpc</title>" in page and page.endswith("</html>\n")


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_own_page_is_accepted_under_both_names(server, host) -> None:
    origin = f"http://{host}:{server.get_port()}"
    with shake_hands(server.url, origin, host) as page:
        assert len(page.recv(timeout=PATIENCE)) > 0
    with pytest.raises(OSError), socket.socket() as other:
        # 127.0.0.0/8 is this machine; a listener on all addresses would answer here too.
        other.connect(("127.0.0.2", server.get_port()))


@pytest.mark.parametrize(
    ("host", "origin", "expected"),
    [("127.0.0.1", "http://evil.example", "Origin: expected http://127.0.0.1:"),
     ("127.0.0.1", "null", "Origin: "), ("127.0.0.1", "http://127.0.0.1:1", "Origin: "),
     ("evil.example", "http://evil.example:{port}", "Host: expected 127.0.0.1:"),
     ("0.0.0.0", "http://0.0.0.0:{port}", "Host: ")],
)
def test_page_of_another_site_or_name_is_refused_even_with_the_token(
    server, host, origin, expected
) -> None:
    origin = origin.format(port=server.get_port())
    assert refusal(server.url, origin=origin, host=host).startswith(expected)
    assert get(server.url, host)[0] == 403, "a name without the port is another one, too"


@pytest.mark.parametrize("query", ["", "token=x", "token=%ff", "{own}&{own}"])
def test_page_and_websocket_need_the_token_once(server, query) -> None:
    page = urlsplit(server.url)
    query = query.format(own=page.query)
    url = f"http://{page.netloc}/?{query}"
    assert refusal(url, origin=f"http://{page.netloc}").startswith("token: missing or wrong")
    assert get(url)[0] == get(f"http://{page.netloc}/index.html?{query}")[0] == 403


def test_page_is_redirected_to_its_websocket(server) -> None:
    assert refusal(server.url, protocol="viser-v0.0.1").endswith("reload the page")
    # A page with the address of another WebSocket is redirected to the own one.
    pages = []
    for url in (server.url, f"{server.url}&websocket=ws://evil.example"):
        with urllib.request.urlopen(url, timeout=PATIENCE) as page:
            assert page.status == 200 and b"<html" in page.read()
            pages.append(page.url)
    assert f"ws://127.0.0.1:{server.get_port()}/?token=" in pages[0] == pages[1]


def test_another_port_is_used_if_the_preferred_one_is_taken(server, capsys) -> None:
    taken = server.get_port()
    other = LocalServer(taken)
    free = other.get_port()
    assert free != taken and get(other.url)[0] == 200
    other.stop()
    text = f"viewer: port {taken}: address already in use; using {free}\n"
    assert capsys.readouterr() == ("", text)


def test_viser_that_does_not_serve_by_the_replaced_function_is_refused(monkeypatch) -> None:
    """viser has no setting for access control: `LocalServer` relies on what it calls."""
    module = websockets.asyncio.server
    others = SimpleNamespace(**{**vars(module), "serve": module.serve})
    found = SimpleNamespace(**{**vars(websockets), "asyncio": SimpleNamespace(server=others)})
    monkeypatch.setattr(viser.infra._infra, "websockets", found)
    with pytest.raises(ServerError, match="is not supported: no access control"):
        LocalServer(0)

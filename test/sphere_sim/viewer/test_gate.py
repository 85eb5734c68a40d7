# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Who is let in to the viewer, asked by real handshakes."""

import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest

pytest.importorskip("viser")

import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from sphere_sim.viewer.gate import Gate
from sphere_sim.viewer.server import LocalServer

PROTOCOL = f"viser-v{viser.__version__}"


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    server = LocalServer(0)
    yield server
    server.stop()


def shake_hands(
    url: str, origin: str | None = None, host: str = "127.0.0.1", protocol: str = PROTOCOL
) -> ClientConnection:
    """Open a WebSocket at a page's address."""
    page = urlsplit(url)
    address = f"ws://{host}:{page.port}/?{page.query}"
    end = socket.create_connection(("127.0.0.1", page.port))
    return connect(address, sock=end, origin=origin, subprotocols=[protocol], max_size=None)


def refusal(url: str, **how: str) -> str:
    """Return the line with which a WebSocket is refused."""
    with pytest.raises(InvalidStatus) as told:
        shake_hands(url, **how)
    assert told.value.response.status_code == 403
    (line,) = bytes(told.value.response.body).decode().splitlines()
    return line


def get(url: str, host: str = "") -> tuple[int, str]:
    """Return status and body of a page."""
    request = urllib.request.Request(url, headers={"Host": host} if host else {})
    try:
        with urllib.request.urlopen(request, timeout=10.0) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_its_own_page_is_let_in_by_both_names(server, host) -> None:
    origin = f"http://{host}:{server.get_port()}"
    with shake_hands(server.url, origin, host) as page:
        assert len(page.recv(timeout=10.0)) > 0


def test_other_programs_of_who_knows_the_address_are_let_in(server) -> None:
    with shake_hands(server.url) as page:
        assert page.subprotocol == PROTOCOL


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1", "http://127.0.0.1:1"]
)
def test_a_page_of_another_site_is_refused_even_with_the_token(server, origin) -> None:
    assert refusal(server.url, origin=origin).startswith("Origin: expected http://127.0.0.1:")


def test_both_names_of_this_machine_in_one_request_are_two_sites(server) -> None:
    origin = f"http://localhost:{server.get_port()}"
    assert refusal(server.url, origin=origin).startswith("Origin: ")


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "0.0.0.0"])
def test_a_foreign_name_that_leads_here_is_refused(server, host) -> None:
    origin = f"http://{host}:{server.get_port()}"
    told = refusal(server.url, origin=origin, host=host)
    assert told.startswith("Host: expected 127.0.0.1:") and "ssh -L" in told
    status, text = get(server.url, host)
    assert status == 403 and text.startswith("Host: ")


@pytest.mark.parametrize("query", ["", "token=", "token=x", "token=%ff", "other=1"])
def test_without_the_token_neither_page_nor_socket_is_served(server, query) -> None:
    page = urlsplit(server.url)
    url = f"http://{page.netloc}/?{query}"
    for told in (refusal(url, origin=f"http://{page.netloc}"), get(url)[1]):
        assert told.startswith("token: missing or wrong; open the address that the viewer printed")
    assert get(url)[0] == 403
    assert get(f"http://{page.netloc}/index.html?{query}")[0] == 403


def test_the_token_twice_is_none(server) -> None:
    assert get(f"{server.url}&{urlsplit(server.url).query}")[0] == 403


def test_a_page_of_another_version_is_told_to_reload(server) -> None:
    told = refusal(server.url, protocol="viser-v0.0.1")
    assert told.startswith("Sec-WebSocket-Protocol: ") and told.endswith("reload the page")


def test_the_page_is_told_where_its_socket_is(server) -> None:
    with urllib.request.urlopen(server.url, timeout=10.0) as page:
        page_url = page.url
        assert page.status == 200 and b"<html" in page.read()
    assert f"ws://127.0.0.1:{server.get_port()}/?token=" in page_url
    # A page that came with a socket elsewhere is sent to this one.
    lured = f"{server.url}&websocket=ws://evil.example"
    with urllib.request.urlopen(lured, timeout=10.0) as page:
        assert page.url == page_url


def test_a_port_that_is_taken_is_told_and_another_one_is_used(capsys) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        server = LocalServer(taken)
        try:
            free = server.get_port()
            assert free != taken and get(server.url)[0] == 200
        finally:
            server.stop()
    told = f"viewer: port {taken}: address already in use; taking {free}\n"
    assert capsys.readouterr() == ("", told)


def test_no_port_at_all_is_one_line_at_once(tmp_path) -> None:
    source = (
        "import resource, sys\n"
        "from sphere_sim.viewer.server import LocalServer, ServerError\n"
        "held = [open('/dev/null') for _ in range(30)]\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (len(held), len(held)))\n"
        "try:\n    LocalServer(0)\n"
        "except ServerError as error:\n    sys.exit(str(error))\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, timeout=60.0
    )
    assert ended.stderr == "no port of 127.0.0.1 for the page: too many open files\n"
    assert ended.returncode == 1


def test_each_start_has_a_token_of_its_own() -> None:
    assert Gate(8080).url != Gate(8080).url
    assert len(urlsplit(Gate(8080).url).query) >= len("token=") + 22

"""What the live page's server lets in: nobody but its own page, and nothing that anyone sends."""

from __future__ import annotations

import asyncio
import hmac
import logging
import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import psutil
import pytest
import umsgpack
from pages import answer, port, refuses, status
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

from ffsms_pin.errors import InvalidValue, ViewerError
from ffsms_pin.viewer.server import Access, Server

OBJECT = umsgpack.packb({"type": "set_object", "path": "/a", "object": {}})
CONTROL = umsgpack.packb({"type": "set_control", "name": "x", "callback": "owned()"})


pytestmark = pytest.mark.usefixtures("own_ports")


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    made.scene.put("set_object", "/a", "", OBJECT)
    yield made
    made.close()


def listening() -> set[tuple[str, int]]:
    """Where this process listens."""
    found = psutil.Process().net_connections("all")
    return {tuple(item.laddr) for item in found if item.status == psutil.CONN_LISTEN}


def test_it_listens_on_this_machine_only_and_nowhere_else() -> None:
    before, children = listening(), len(psutil.Process().children())
    server = Server()
    new = listening() - before
    assert {address for address, _ in new} <= {"127.0.0.1", "::1"}
    assert {number for _, number in new} == {port(server.url)}
    assert len(psutil.Process().children()) == children  # no other process either
    for address, number in new:
        assert not refuses(address, number)
    others = [item.address for items in psutil.net_if_addrs().values() for item in items]
    for address in [*others, "127.0.0.2"]:
        if address not in ("127.0.0.1", "::1") and ":" not in address:
            assert refuses(address, port(server.url)), address
    server.close()
    assert refuses("127.0.0.1", port(server.url))
    assert listening() == before


def test_more_is_opened_only_by_name_and_then_the_token_counts() -> None:
    server = Server(host="0.0.0.0")
    try:
        assert ("0.0.0.0", port(server.url)) in listening()
        path = urlsplit(server.url).path
        assert answer(server.url, host="any.name:1")[0] == 200
        assert status(server.url, "http://any.name:1", host="any.name:1") == 101
        assert status(server.url, "http://other.name:1", host="any.name:1") == 403
        for wrong in ("/", "//", path[:-2] + "/", path[:-1] + "x/", path.lower() + "/", "/static/"):
            assert answer(server.url, path=wrong)[0] == 403, wrong
            assert answer(server.url, path=wrong + "main.min.js")[0] == 403, wrong
            assert status(server.url, f"http://127.0.0.1:{port(server.url)}", path=wrong + "socket") == 403
    finally:
        server.close()


@pytest.mark.parametrize("host", ["", " ", 3, "a\0b", "a\nb"])
def test_a_host_that_is_no_name_is_refused(host: Any) -> None:
    with pytest.raises(InvalidValue, match="host"):
        Server(host=host)


def test_a_host_that_is_not_here_is_refused() -> None:
    before = listening()
    for host in ("192.0.2.1", "machine.invalid", ".." * 200):
        with pytest.raises(ViewerError, match="cannot listen"):
            Server(host=host)
    assert listening() == before


def test_tokens_are_random_long_and_compared_in_constant_time(monkeypatch: pytest.MonkeyPatch) -> None:
    tokens = {Access(7000).token for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 32
    compared: list[tuple[bytes, bytes]] = []
    same = hmac.compare_digest

    def noted(one: bytes, other: bytes) -> bool:
        compared.append((one, other))
        return same(one, other)

    monkeypatch.setattr(hmac, "compare_digest", noted)
    access = Access(7000)
    assert access.knows_token(access.token)
    for wrong in ("", "x", access.token[:-1], access.token + "x", "\udcff", "é"):
        assert not access.knows_token(wrong)
    assert len(compared) == 7
    assert access.token not in repr(access)


def test_a_rebound_host_is_refused(server: Server) -> None:
    number = port(server.url)
    for host in (f"127.0.0.1:{number}", f"localhost:{number}", f"LOCALHOST:{number}", f"[::1]:{number}"):
        assert answer(server.url, host=host)[0] == 200, host
        assert status(server.url, f"http://{host.lower()}", host=host) == 101, host
    wrong = ["evil.example", f"evil.example:{number}", f"127.0.0.1.evil.example:{number}", "localhost"]
    wrong += ["127.0.0.1", f"localhost:{number + 1}", f"localhost:{number}.evil", f"0.0.0.0:{number}", ""]
    wrong += [f"user@localhost:{number}", f"127.0.0.1:{number},evil.example"]
    for host in wrong:
        code, got = answer(server.url, host=host)
        assert code in (400, 403), host
        assert host == "" or "@" in host or "," in host or code == 403, host
        assert b"meshcat" not in got.lower()
        # A page of that site names itself as the origin too.
        assert status(server.url, f"http://{host}", host=host) in (400, 403), host
        assert answer(server.url, path="/", host=host)[0] in (400, 403), host
    code, _ = answer(server.url, headers="Host: evil.example\r\n")  # beside the right one
    assert code in (400, 403)


def test_a_foreign_origin_gets_no_socket(server: Server) -> None:
    own = f"127.0.0.1:{port(server.url)}"
    assert status(server.url, f"http://{own}") == 101
    foreign = [None, "", "null", "http://evil.example", f"http://evil.example:{port(server.url)}", "file://"]
    foreign += [f"https://{own}", f"http://{own}.evil.example", f"http://localhost:{port(server.url)}", own]
    foreign += [f"http://127.0.0.1:{port(server.url) + 1}", f"http://evil@{own}"]
    for origin in foreign:
        assert status(server.url, origin) == 403, origin


def test_only_the_page_is_served(server: Server) -> None:
    start = urlsplit(server.url).path
    for name in ("", "page.js", "main.min.js"):
        assert answer(server.url, path=start + name)[0] == 200
    for name in ("page.html", "../server.py", "%2e%2e/server.py", "..%2f..%2fetc/passwd", "x"):
        assert answer(server.url, path=start + name)[0] == 403
    assert answer(server.url, path="/")[0] == 403


def test_the_page_may_evaluate_nothing_and_ask_nobody_else(server: Server) -> None:
    _, got = answer(server.url)
    (policy,) = [line for line in got.split(b"\r\n") if line.startswith(b"Content-Security-Policy:")]
    assert b"default-src 'none'" in policy
    assert b"script-src 'self';" in policy
    assert b"unsafe-eval" not in policy
    assert b"Referrer-Policy: no-referrer" in got


def test_what_others_send_is_not_written_to_the_terminal(
    server: Server, caplog: pytest.LogCaptureFixture
) -> None:
    for path in ("/%ff/", "/x y/", "/\x1b[31m/", "//evil/", "*", "/" + "x" * 100_000):
        assert answer(server.url, path=path)[0] not in (101, 200)
    assert answer(server.url, headers="Content-Length: 99999999\r\n")[0] != 200
    assert status(server.url, None) == 403
    time.sleep(0.2)
    assert [item for item in caplog.records if item.levelno >= logging.WARNING] == []
    assert answer(server.url)[0] == 200


def test_messages_from_outside_go_nowhere(server: Server) -> None:
    origin = {"Origin": f"http://127.0.0.1:{port(server.url)}"}
    address = server.url.replace("http:", "ws:") + "socket"

    async def attack() -> tuple[list[Any], bytes]:
        victim = await websocket_connect(HTTPRequest(address, headers=origin))
        seen = [await victim.read_message()]
        other = await websocket_connect(HTTPRequest(address, headers=origin))
        for message in (CONTROL, b"", b"\xff" * 1000):
            await other.write_message(message, binary=True)
        for text in ('{"type": "img", "data": "x,eA=="}', "set_control", "{"):
            await other.write_message(text)
        await asyncio.sleep(0.3)
        large = await websocket_connect(HTTPRequest(address, headers=origin))
        await large.write_message(b"x" * 1_000_000, binary=True)
        while await asyncio.wait_for(large.read_message(), 10.0) is not None:
            pass  # until it is closed for the size of what it sent
        large.close()
        server.scene.put("set_object", "/b", "", OBJECT + b"\0")
        after = await asyncio.wait_for(victim.read_message(), 10.0)
        seen.append(after)
        new = await websocket_connect(HTTPRequest(address, headers=origin))
        seen += [await new.read_message(), await new.read_message()]
        for client in (victim, other, new):
            client.close()
            while await asyncio.wait_for(client.read_message(), 10.0) is not None:
                pass
        return seen, OBJECT

    seen, first = asyncio.run(attack())
    assert seen == [first, first + b"\0", first, first + b"\0"]


def test_commands_that_are_evaluated_never_leave(server: Server) -> None:
    for kind in ("set_control", "set_control_value", "delete_control", "capture_image", "save_image", ""):
        with pytest.raises(ViewerError, match="not sent commands"):
            server.scene.put(kind, "/x", "", CONTROL)

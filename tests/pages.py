"""Requests to a live page, spelled out, as a browser or somebody else would make them."""

from __future__ import annotations

import socket
from urllib.parse import urlsplit

__all__ = ["answer", "connected", "port", "refuses", "status"]

UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}


def answer(
    url: str, path: str | None = None, host: str | None = None, headers: str = ""
) -> tuple[int, bytes]:
    """Status and everything that came back to GET.

    `path` and `host` replace what the address says; an empty `host` leaves the header out. `headers` are
    further lines, each with its end.
    """
    place = urlsplit(url)
    host = place.netloc if host is None else host
    asked = f"GET {place.path if path is None else path} HTTP/1.1\r\nConnection: close\r\n{headers}"
    asked += f"Host: {host}\r\n\r\n" if host else "\r\n"
    with _opened(url) as plug:
        plug.sendall(asked.encode())
        got = b""
        while chunk := plug.recv(65536):
            got += chunk
    return (int(got.split()[1]) if got else 0), got


def status(url: str, origin: str | None, host: str | None = None, path: str | None = None) -> int:
    """Status of the answer to the opening of a WebSocket; 101 says that it is open."""
    plug, code = _handshake(url, origin, host, path)
    plug.close()
    return code


def connected(url: str) -> socket.socket:
    """A WebSocket as the page itself opens it, of which nothing was read but the first line."""
    plug, code = _handshake(url, "http://" + urlsplit(url).netloc, None, None)
    assert code == 101
    return plug


def port(url: str) -> int:
    """Port that an address names."""
    found = urlsplit(url).port
    assert found is not None
    return found


def refuses(address: str, number: int) -> bool:
    """Whether nobody takes a connection there."""
    try:
        socket.create_connection((address, number), timeout=5.0).close()
    except OSError:
        return True
    return False


def _handshake(url: str, origin: str | None, host: str | None, path: str | None) -> tuple[socket.socket, int]:
    place = urlsplit(url)
    headers = {"Host": place.netloc if host is None else host, **UPGRADE}
    if origin is not None:
        headers["Origin"] = origin
    lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    plug = _opened(url)
    plug.sendall(f"GET {place.path + 'socket' if path is None else path} HTTP/1.1\r\n{lines}\r\n".encode())
    line = b""
    while not line.endswith(b"\r\n"):
        line += plug.recv(1)
    return plug, int(line.split()[1])


def _opened(url: str) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port(url)), timeout=20.0)

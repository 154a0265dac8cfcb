"""What the live page's server answers, and to whom: a page, its scripts, and a WebSocket that only sends."""

from __future__ import annotations

import asyncio
import hmac
import re
import secrets
from dataclasses import dataclass, field
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from ffsms_pin.viewer.page import scripts
from ffsms_pin.viewer.scene import Scene

LOOPBACK = ("127.0.0.1", "::1")
_LOOPBACK_NAMES = ("127.0.0.1", "localhost", "[::1]")  # as a browser writes them
_PERIOD = 1.0 / 60.0  # [s] between two looks for new commands, while a page is open
_MOST_CONNECTIONS = 64  # at a time; each costs this process a file descriptor
_LARGEST = 65_536  # [bytes] of a request; ours are far smaller
_IDLE = 30.0  # [s] until a connection that asks nothing is closed
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "X-Content-Type-Options": "nosniff",
    # Scripts come from this server only, and the browser refuses to evaluate any text as one.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; connect-src 'self'; style-src 'unsafe-inline'; "
        "img-src 'self' data: blob:; font-src data:; worker-src blob:; base-uri 'none'; form-action 'none'"
    ),
}


@dataclass(frozen=True)
class Access:
    """The rules of one server.

    With `any_host` a request may call it by any name; otherwise only by a name of the loopback interface with
    the server's port. A page of another site that had its own name point to this machine (DNS rebinding)
    sends its own name and is refused. The token, of 192 random bits, is part of the address of the page: who
    does not know it gets nothing.
    """

    port: int
    any_host: bool = False
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)

    def knows_token(self, given: str) -> bool:
        """Whether the token is right; takes the same time wherever the first wrong character is."""
        return hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode())

    def allows_host(self, host: str | None) -> bool:
        """Whether a request with this Host header may be answered."""
        if not host:
            return False
        return self.any_host or host.lower() in {f"{name}:{self.port}" for name in _LOOPBACK_NAMES}

    def allows_origin(self, origin: str | None, host: str | None) -> bool:
        """Whether a WebSocket may be opened by a page from `origin`: only by our own, from this `host`.

        A request without an Origin does not come from a browser and is refused too.
        """
        return self.allows_host(host) and origin is not None and origin.lower() == f"http://{host}".lower()


class LiveServer(HTTPServer):
    """An HTTP server that holds a bounded number of connections."""

    def initialize(self, access: Access, scene: Scene, page: str) -> None:  # type: ignore[override]
        """Prepare the answers; tornado calls this with the arguments of the constructor."""
        self._streams: set[IOStream] = set()
        super().initialize(
            _application(access, scene, page),
            idle_connection_timeout=_IDLE,
            body_timeout=_IDLE,
            max_header_size=_LARGEST,
            max_body_size=_LARGEST,
        )

    def handle_stream(self, stream: IOStream, address: tuple[Any, ...]) -> None:
        """Serve a connection, or close it where there are too many."""
        self._streams = {known for known in self._streams if not known.closed()}
        if len(self._streams) >= _MOST_CONNECTIONS:
            stream.close()
            return
        self._streams.add(stream)
        super().handle_stream(stream, address)

    def close(self) -> None:
        """Stop listening, and close every connection."""
        self.stop()
        for stream in self._streams:
            stream.close()


def _application(access: Access, scene: Scene, page: str) -> Application:
    html, javascript = "text/html; charset=utf-8", "text/javascript; charset=utf-8"
    return Application(
        [
            (r"/([^/]*)/", _File, {"content": page.encode(), "kind": html}),
            *(
                (rf"/([^/]*)/{re.escape(name)}", _File, {"content": script, "kind": javascript})
                for name, script in scripts().items()
            ),
            (r"/([^/]*)/socket", _Socket, {"scene": scene}),
        ],
        default_handler_class=_Guarded,  # every other address has no token, so it gets 403
        access=access,
        log_function=lambda handler: None,  # requests are no news to the terminal that simulates
        websocket_max_message_size=_LARGEST,
        websocket_ping_interval=20.0,  # a browser that went away without a word is noticed
    )


class _Guarded(RequestHandler):
    """Answers 403 unless the request calls us by our name and knows the token."""

    def set_default_headers(self) -> None:
        for name, value in _HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        access: Access = self.settings["access"]
        if not access.allows_host(self.request.headers.get("Host")):
            raise HTTPError(403, reason="Forbidden: not a name of this server")
        if not access.knows_token(self.path_args[0] if self.path_args else ""):
            raise HTTPError(403, reason="Forbidden: the address lacks the token")

    def log_exception(self, kind: Any, error: Any, trace: Any) -> None:
        if not isinstance(error, HTTPError):  # what others send is not written to our terminal
            super().log_exception(kind, error, trace)


class _File(_Guarded):
    """One file of the page, from memory."""

    def initialize(self, content: bytes, kind: str) -> None:
        self._content, self._kind = content, kind

    def get(self, token: str) -> None:
        self.set_header("Content-Type", self._kind)
        self.write(self._content)


class _Socket(_Guarded, WebSocketHandler):
    """Sends the scene to one page, and then what changes. What the page sends is dropped unread."""

    def initialize(self, scene: Scene) -> None:
        self._scene = scene
        self._sending: asyncio.Task[None] | None = None

    def prepare(self) -> None:
        super().prepare()
        headers = self.request.headers
        if not self.settings["access"].allows_origin(headers.get("Origin"), headers.get("Host")):
            raise HTTPError(403, reason="Forbidden: a page of another origin")

    def check_origin(self, origin: str) -> bool:
        return True  # `prepare` has checked it, also where there is none

    def open(self, *args: str, **kwargs: str) -> None:
        self._sending = asyncio.get_running_loop().create_task(self._send())

    def on_message(self, message: str | bytes) -> None:
        pass

    def on_close(self) -> None:
        if self._sending is not None:
            self._sending.cancel()

    async def _send(self) -> None:
        count = 0
        try:
            while True:
                count, commands = self._scene.since(count)
                for command in commands:
                    await self.write_message(command, binary=True)  # waits for a slow page
                await asyncio.sleep(_PERIOD)
        except WebSocketClosedError:
            pass

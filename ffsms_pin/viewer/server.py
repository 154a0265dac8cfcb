"""The live page's server: a thread of this process that sends a scene to the browsers that may see it.

What it lets in
---------------
It listens on the loopback interface only (127.0.0.1, and ::1 where there is one) unless `host` names more.
The address of the page holds a random token, and nobody gets anything without it. The Host header must be a
name of the loopback interface with the server's port (with `host`, any name), and a WebSocket is opened only
for the server's own page. Everything else is answered with 403. Nothing that comes in is used: messages of
browsers are dropped unread, since the scene comes from this process through memory; only the page of which a
film is made may send its pictures. It is served with a policy that forbids its scripts to evaluate texts. The
server ends when this process does, however that ends.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import errno
import hmac
import re
import secrets
import socket
import threading
import webbrowser
from dataclasses import dataclass, field
from queue import Queue
from typing import Any, TypeAlias

from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.iostream import IOStream
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from ffsms_pin.errors import InvalidValue, ViewerError
from ffsms_pin.viewer.page import scripts
from ffsms_pin.viewer.scene import Scene

Pictures: TypeAlias = Queue[bytes | None]

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
    """The rules of one server; with `any_host` a request may call it by any name.

    A page of another site that had its own name point to this machine (DNS rebinding) sends that name and is
    refused. The token has 192 random bits.
    """

    port: int
    any_host: bool = False
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)

    def knows_token(self, given: str) -> bool:
        """Whether the token is right; takes the same time wherever the first wrong character is."""
        return hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode())

    def allows_host(self, host: str | None) -> bool:
        """Whether a request with this Host header may be answered."""
        ours = {f"{name}:{self.port}" for name in _LOOPBACK_NAMES}
        return bool(host) and (self.any_host or str(host).lower() in ours)


class LiveServer(HTTPServer):
    """An HTTP server that holds a bounded number of connections."""

    def initialize(self, *answers: Any) -> None:
        """Prepare the answers; tornado calls this with the arguments of the constructor."""
        self._streams: set[IOStream] = set()
        super().initialize(
            _application(*answers),
            idle_connection_timeout=_IDLE,
            body_timeout=_IDLE,
            max_header_size=_LARGEST,
            max_body_size=_LARGEST if answers[-1] is None else None,  # None: as tornado has it, 100 MB
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


def _application(access: Access, scene: Scene, page: str, pictures: Pictures | None) -> Application:
    html, javascript = "text/html; charset=utf-8", "text/javascript; charset=utf-8"
    files = {"": (page.encode(), html)} | {name: (text, javascript) for name, text in scripts().items()}
    routes: list[Any] = [
        (rf"/([^/]*)/{re.escape(name)}", _File, {"content": content, "kind": kind})
        for name, (content, kind) in files.items()
    ]
    routes.append((r"/([^/]*)/socket", _Socket, {"scene": scene}))
    if pictures is not None:
        routes.append((r"/([^/]*)/(picture|trouble)", _Picture, {"pictures": pictures}))
    return Application(
        routes,
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


class _Picture(_Guarded):
    """Takes the pictures of a page from which a film is made; None for its trouble."""

    def initialize(self, pictures: Pictures) -> None:
        self._pictures = pictures

    async def post(self, token: str, kind: str) -> None:
        while self._pictures.full():  # a slow encoder holds the browser up
            await asyncio.sleep(_PERIOD)
        self._pictures.put_nowait(self.request.body if kind == "picture" else None)


class _Socket(_Guarded, WebSocketHandler):
    """Sends the scene to one page, and then what changes. What the page sends is dropped unread."""

    def initialize(self, scene: Scene) -> None:
        self._scene = scene

    def prepare(self) -> None:
        super().prepare()
        headers = self.request.headers  # a browser names the page's origin
        if headers.get("Origin", "").lower() != f"http://{headers['Host']}".lower():
            raise HTTPError(403, reason="Forbidden: a page of another origin")

    def check_origin(self, origin: str) -> bool:
        return True  # `prepare` has checked it, also where there is none

    def open(self, *args: str, **kwargs: str) -> None:
        IOLoop.current().spawn_callback(self._send)

    def on_message(self, message: str | bytes) -> None:
        pass

    async def _send(self) -> None:
        count = 0
        with contextlib.suppress(WebSocketClosedError):
            while self.ws_connection is not None:
                count, commands = self._scene.since(count)
                for command in commands:
                    await self.write_message(command, binary=True)  # waits for a slow page
                await asyncio.sleep(_PERIOD)


_PORTS = range(7000, 8000)


class Server:
    """A live page of a scene, with all that changes in it, at the address `url`, which holds the token.

    With a `host`, "0.0.0.0" for all of IPv4, other machines can open the page, over plain HTTP, if they know
    that address. `InvalidValue`: it is not a name; `ViewerError`: the server cannot listen there. What the
    page draws goes into the queue `pictures`, where there is one.
    """

    def __init__(
        self,
        host: str | None = None,
        scene: Scene | None = None,
        page: str = "",
        pictures: Pictures | None = None,
    ) -> None:
        if host is not None and (not isinstance(host, str) or not host.strip() or not host.isprintable()):
            raise InvalidValue("host", host, "must be the name or address of an interface, or None")
        port, self._sockets = _listen(host)
        self._access = Access(port, any_host=host is not None)
        self.url: str = f"http://{_name(host)}:{port}/{self._access.token}/"
        self.scene = Scene() if scene is None else scene
        self._answers = self._access, self.scene, page, pictures
        self._problem = ""
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ffsms-pin viewer", daemon=True)
        self._thread.start()
        atexit.register(self.close)

    def check(self) -> None:
        """Raise `ViewerError` where the server has ended."""
        if not self._thread.is_alive():
            raise ViewerError(f"the live page's server has ended{self._problem}; open the view again")

    def close(self) -> None:
        """Stop the server; the page stands still from then on. A second time does nothing."""
        atexit.unregister(self.close)
        self._end.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        """What the thread does."""
        try:
            asyncio.run(self._serve())
        except Exception as error:  # told to whoever draws next
            self._problem = f" ({error})"
        finally:
            for item in self._sockets:
                item.close()

    async def _serve(self) -> None:
        server = LiveServer(*self._answers)
        server.add_sockets(self._sockets)
        asyncio.get_running_loop().set_exception_handler(self._handle)
        # The thread that draws never calls into this one's event loop, so neither can hold up the other.
        while not self._end.is_set():
            await asyncio.sleep(0.05)
        server.close()

    def _handle(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """What the event loop does with an error that nobody caught."""
        error = context.get("exception")
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
            # A connection that cannot be accepted stays first in line, and would be tried for ever.
            self._problem = f" ({error.strerror})"
            self._end.set()
        else:
            loop.default_exception_handler(context)


def open_browser(url: str) -> None:
    """Open a window of the default browser, where there is one."""
    with contextlib.suppress(webbrowser.Error, OSError):
        webbrowser.open(url)


def _listen(host: str | None) -> tuple[int, list[socket.socket]]:
    """A port, and the sockets that listen on it: of the host, or of the loopback interface."""
    for port in _PORTS:
        found: list[socket.socket] = []
        try:
            for address in LOOPBACK if host is None else (host,):
                family = socket.AF_INET6 if ":" in address else socket.AF_INET
                found.append(socket.create_server((address, port), family=family))
                found[-1].setblocking(False)
            return port, found
        except UnicodeError:  # no name of a machine can be so
            raise ViewerError(f"the live page cannot listen on '{str(host)[:80]}' (not a name)") from None
        except OSError as error:
            taken = error.errno in (errno.EADDRINUSE, errno.EACCES)
            if host is None and found and not taken:  # a machine without IPv6
                return port, found
            for item in found:
                item.close()
            if not taken:
                raise ViewerError(f"the live page cannot listen on '{host}' ({error.strerror})") from None
    raise ViewerError(f"the live page finds no free port from {_PORTS[0]} to {_PORTS[-1]}; close other views")


def _name(host: str | None) -> str:
    """The host as an address of a page names it."""
    if host in ("0.0.0.0", "::"):
        return socket.gethostname()
    return LOOPBACK[0] if host is None else f"[{host}]" if ":" in host else host

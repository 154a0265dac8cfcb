"""The live page's server: a thread of this process that sends a scene to the browsers that may see it.

What it lets in
---------------
It listens on the loopback interface only (127.0.0.1, and ::1 where there is one) unless `host` names more.
The address of the page holds a random token, and nobody gets anything without it. The Host header must be a
name of the loopback interface with the server's port (with `host`, any name), and a WebSocket is opened only
for the server's own page. Everything else is answered with 403.

Nothing that comes in is used: messages of browsers are dropped unread. There is no other way in, since the
scene comes from this process through memory. The page is served with a policy that forbids its scripts to
evaluate texts.

There is no other process either: the server ends when this process does, however that ends.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import errno
import socket
import threading
import webbrowser
from typing import Any

from ffsms_pin.errors import InvalidValue, ViewerError
from ffsms_pin.viewer.handlers import LOOPBACK, Access, LiveServer
from ffsms_pin.viewer.scene import Scene

_PORTS = range(7000, 8000)
_TICK = 0.05  # [s] the server looks this often whether it should end
_PATIENCE = 5.0  # [s] for its end


class Server:
    """A live page of a scene, with all that changes in it, at the address `url`, which holds the token.

    `host` is the name or address of the interface to listen on, "0.0.0.0" for all of IPv4: other machines can
    then open the page, over plain HTTP, if they know that address. Default: loopback only. `InvalidValue`: it
    is not a name; `ViewerError`: the server cannot listen there.
    """

    def __init__(self, host: str | None = None, scene: Scene | None = None, page: str = "") -> None:
        if host is not None and (not isinstance(host, str) or not host.strip() or not host.isprintable()):
            raise InvalidValue("host", host, "must be the name or address of an interface, or None")
        port, self._sockets = _listen(host)
        self._access = Access(port, any_host=host is not None)
        self.url: str = f"http://{_name(host)}:{port}/{self._access.token}/"
        self.scene, self._page = Scene() if scene is None else scene, page
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
        self._thread.join(_PATIENCE)

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
        server = LiveServer(self._access, self.scene, self._page)
        server.add_sockets(self._sockets)
        asyncio.get_running_loop().set_exception_handler(self._handle)
        # The thread that draws never calls into this one's event loop, so neither can hold up the other.
        while not self._end.is_set():
            await asyncio.sleep(_TICK)
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
    addresses = [host] if host is not None else [*LOOPBACK] if _has_ipv6() else [LOOPBACK[0]]
    for port in _PORTS:
        found = [_listening(address, port) for address in addresses]
        sockets = [item for item in found if item is not None]
        if len(sockets) == len(addresses):
            return port, sockets
        for item in sockets:
            item.close()
    raise ViewerError(f"the live page finds no free port from {_PORTS[0]} to {_PORTS[-1]}; close other views")


def _listening(address: str, port: int) -> socket.socket | None:
    """A socket that listens there; None where the port is taken."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        made = socket.create_server((address, port), family=family)
    except OSError as error:
        if error.errno in (errno.EADDRINUSE, errno.EACCES):
            return None
        raise ViewerError(f"the live page cannot listen on '{address}' ({error.strerror})") from None
    except UnicodeError:  # no name of a machine can be so
        raise ViewerError(f"the live page cannot listen on '{address[:80]}' (not a name)") from None
    made.setblocking(False)
    return made


def _has_ipv6() -> bool:
    """Whether this machine has a loopback address of IPv6."""
    try:
        socket.create_server((LOOPBACK[1], 0), family=socket.AF_INET6).close()
    except OSError:
        return False
    return True


def _name(host: str | None) -> str:
    """The host as an address of a page names it."""
    if host is None:
        return LOOPBACK[0]
    if host in ("0.0.0.0", "::"):
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host

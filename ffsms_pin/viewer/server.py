"""Meshcat's server in a process of its own, started and stopped cleanly."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import umsgpack
import zmq
from meshcat.visualizer import ViewerWindow

from ffsms_pin.errors import ViewerError

__all__ = ["Server"]

_PATIENCE = 20_000  # [ms]


class Server:
    """A page on this machine that shows what it is sent; nobody else's machine can open it.

    Attributes
    ----------
    url : str
        Of the page.
    """

    def __init__(self) -> None:
        try:
            with contextlib.redirect_stdout(
                io.StringIO()
            ):  # it prints the address; so does whoever starts it
                self._window = ViewerWindow(zmq_url=None, start_server=True, server_args=[])
        except (OSError, RuntimeError) as error:
            raise ViewerError(
                f"Meshcat's server does not start ({error}); is a port from 7000 on free?"
            ) from None
        self.url: str = self._window.web_url
        self._socket = self._window.zmq_socket
        self._socket.setsockopt(zmq.RCVTIMEO, _PATIENCE)
        self._socket.setsockopt(zmq.LINGER, 0)

    def forward(self, kind: str, path: str, packed: bytes) -> None:
        """Send one packed command."""
        self._ask([kind.encode(), path.encode(), packed])

    def film(self, animations: list[dict[str, Any]]) -> None:
        """Play an animation, over and over."""
        # Under a path of its own: to a page that opens later the server sends the tree from its root on, and
        # an animation must come after the objects that it moves.
        data = {
            "type": "set_animation",
            "path": "/film",
            "animations": animations,
            "options": {"play": True, "repetitions": 1_000_000},
        }
        self.forward("set_animation", "/film", umsgpack.packb(data))

    def wait(self) -> None:
        """Block until a browser shows the page."""
        self._socket.setsockopt(zmq.RCVTIMEO, -1)
        self._ask([b"wait"])
        self._socket.setsockopt(zmq.RCVTIMEO, _PATIENCE)

    def close(self) -> None:
        """Stop the server; the page stands still from then on."""
        self._socket.close()
        process = self._window.server_proc
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()

    def _ask(self, parts: list[bytes]) -> None:
        try:
            self._socket.send_multipart(parts)
            self._socket.recv()
        except zmq.ZMQError as error:
            raise ViewerError(f"Meshcat's server does not answer ({error}); open the view again") from None

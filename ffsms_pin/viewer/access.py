"""Who may open the live page: checks of what a request says about itself."""

from __future__ import annotations

import hmac
import secrets
from dataclasses import dataclass, field

__all__ = ["LOOPBACK", "Access"]

LOOPBACK = ("127.0.0.1", "::1")
_LOOPBACK_NAMES = ("127.0.0.1", "localhost", "[::1]")  # as a browser writes them


@dataclass(frozen=True)
class Access:
    """The rules of one server.

    Parameters
    ----------
    port : int
        That the server listens on.
    any_host : bool
        Whether a request may call the server by any name; otherwise only by a name of the loopback
        interface with the server's port. A page of another site that had its own name point to this machine
        (DNS rebinding) sends its own name and is refused.

    Attributes
    ----------
    token : str
        Random, 192 bits; part of the address of the page. Who does not know it gets nothing.
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

"""Pictures of a scene's page at given times, drawn by a browser without a window.

The page is served to that browser on this machine's loopback interface, under an address with a random token;
the page draws itself at one time after the other (Meshcat's `capture_image`) and sends each picture back.
"""

from __future__ import annotations

import json
import os
import queue
import secrets
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from tempfile import TemporaryDirectory
from typing import Any

from ffsms_pin.errors import ViewerError

__all__ = ["browser_program", "pictures"]

_BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "msedge",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
)
_FLAGS = (
    "--headless=new",
    "--use-angle=swiftshader",  # the same pictures with and without a graphics card
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
    "--disable-sync",
    "--no-first-run",
    "--no-default-browser-check",
    "--force-device-scale-factor=1",
)
_PATIENCE = 120.0  # [s] for one picture; without a graphics card the first takes a while
_LARGEST = 2**28  # [bytes] of a picture


def browser_program(given: str | None = None) -> str:
    """The program of a browser; a `ViewerError` says what is missing."""
    for name in _BROWSERS if given is None else (given,):
        found = shutil.which(name)
        if found is not None:
            return found
    if given is not None:
        raise ViewerError(f"there is no browser '{given}'")
    raise ViewerError(
        "recording needs Chromium or Chrome, and none was found: install one, or name it "
        "(--browser; in Python browser=...)"
    )


def pictures(
    html: str, times: list[float], width: int, height: int, browser: str | None = None
) -> Iterator[bytes]:
    """PNG pictures of a page at times [s] of its motion, in order.

    Raises
    ------
    ViewerError
        There is no browser, or it does not draw.
    """
    program = browser_program(browser)
    wanted = json.dumps({"times": times, "width": width, "height": height})
    script = f"<script>window.recording = {wanted};</script></head>"
    content = html.replace("</head>", script, 1).encode("utf-8")
    drawn: queue.Queue[bytes | None] = queue.Queue(maxsize=8)
    with _served(content, drawn) as url, _running(program, url) as process:
        for _ in times:
            yield _next(drawn, process)


def _next(drawn: queue.Queue[bytes | None], process: subprocess.Popen[bytes]) -> bytes:
    """The next picture; None from the page is trouble."""
    for _ in range(int(_PATIENCE)):
        try:
            found = drawn.get(timeout=1.0)
        except queue.Empty:
            if process.poll() is not None:
                raise ViewerError(f"the browser ended (exit code {process.returncode})") from None
            continue
        if found is None:
            raise ViewerError("the browser cannot draw the scene: it has no WebGL")
        return found
    raise ViewerError(f"the browser has drawn nothing for {_PATIENCE:g} s")


@contextmanager
def _running(program: str, url: str) -> Iterator[subprocess.Popen[bytes]]:
    """A browser on a page, with a profile of its own that goes with it."""
    flags = list(_FLAGS)
    if sys.platform.startswith("linux") and os.geteuid() == 0:
        flags.append("--no-sandbox")  # Chromium refuses to start for root otherwise
    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        process = subprocess.Popen(
            [program, *flags, f"--user-data-dir={profile}", url],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@contextmanager
def _served(content: bytes, drawn: queue.Queue[bytes | None]) -> Iterator[str]:
    """The address of a page; what it sends back goes to the queue."""
    token = secrets.token_urlsafe(24)

    class Answers(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self._answer(content if self.path == f"/{token}/" else None)

        def do_POST(self) -> None:
            kind = self.path.removeprefix(f"/{token}/")
            size = int(self.headers.get("Content-Length", 0))
            if kind not in ("picture", "trouble") or not 0 <= size <= _LARGEST:
                self._answer(None)
                return
            body = self.rfile.read(size)
            drawn.put(body if kind == "picture" else None)  # a slow encoder holds the browser up
            self._answer(b"")

        def _answer(self, body: bytes | None) -> None:
            self.send_response(404 if body is None else 200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(body or b"")))
            self.end_headers()
            self.wfile.write(body or b"")

        def log_message(self, format: str, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Answers)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, name="ffsms-pin recorder", daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/{token}/"
    finally:
        with suppress(queue.Empty):  # nobody waits to put a picture there any more
            while True:
                drawn.get_nowait()
        server.shutdown()
        server.server_close()
        thread.join(5.0)

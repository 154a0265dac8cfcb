"""A scene as a film: a browser without a window draws picture by picture, an encoder strings them.

The page is served to that browser on this machine's loopback interface, under an address with a random token;
the page draws itself at one time after the other (Meshcat's `capture_image`) and sends each picture back.
"""

from __future__ import annotations

import io
import itertools
import json
import os
import queue
import secrets
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ffsms_pin.checks import positive
from ffsms_pin.errors import DependencyMissing, InvalidValue, ViewerError
from ffsms_pin.storage import path_like, write_atomically, write_content

Put = Callable[[bytes], None]

_COLOURS = 255  # of a gif; all pictures share them, so that what stands still does not flicker
_MOST = 20_000  # pictures
_SMALLEST, _LARGEST = 64, 4096  # [pixels]
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
_MOST_BYTES = 2**28  # of a picture


@contextmanager
def _gif(path: Path, fps: float) -> Iterator[Put]:
    """Gives what takes a picture (PNG); the file is there, whole, after the context."""
    if find_spec("PIL") is None:
        raise DependencyMissing("pillow", "a gif", "record")
    from PIL import Image

    found: list[Any] = []

    def put(picture: bytes) -> None:
        with Image.open(io.BytesIO(picture)) as image:
            found.append(image.convert("RGB"))

    yield put
    width, height = found[0].size
    samples = found[:: max(1, len(found) // 6)]
    together = Image.new("RGB", (width, height * len(samples)))
    for i, one in enumerate(samples):
        together.paste(one, (0, i * height))
    palette = together.quantize(_COLOURS)
    flat = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in found]
    # Hundredths of a second are what the format has; what is lost to rounding is made up for.
    ends = [round(100.0 * (i + 1) / fps) for i in range(len(flat))]
    lasting = [10 * max(b - a, 1) for a, b in zip([0, *ends[:-1]], ends, strict=True)]
    write_atomically(
        path,
        lambda file: flat[0].save(
            file, format="GIF", save_all=True, append_images=flat[1:], duration=lasting, loop=0
        ),
    )


def _ffmpeg() -> str:
    """The program: that on the path, else the one that a package brings."""
    program = shutil.which("ffmpeg")
    if program is not None:
        return program
    if find_spec("imageio_ffmpeg") is None:
        raise DependencyMissing("imageio-ffmpeg", "an mp4, where there is no program ffmpeg,", "record")
    import imageio_ffmpeg

    return str(imageio_ffmpeg.get_ffmpeg_exe())


@contextmanager
def _mp4(path: Path, fps: float) -> Iterator[Put]:
    """As `_gif`."""
    program = _ffmpeg()
    with TemporaryDirectory() as folder:
        film, numbers = Path(folder) / "film.mp4", itertools.count()

        def put(picture: bytes) -> None:
            (Path(folder) / f"{next(numbers):06d}.png").write_bytes(picture)

        yield put
        # H.264 in the form that every player takes.
        command = [program, "-y", "-loglevel", "error", "-framerate", f"{fps:g}"]
        command += ["-i", str(Path(folder) / "%06d.png"), "-c:v", "libx264", "-pix_fmt", "yuv420p", str(film)]
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
        if done.returncode != 0 or not film.is_file():
            words = " ".join(done.stderr.decode(errors="replace").split())
            raise ViewerError(f"ffmpeg did not write the film ({words})")
        write_content(path, film.read_bytes())


# By the ending of the file: pictures a second by default, and what writes it.
_ENCODERS = {".gif": (20.0, _gif), ".mp4": (30.0, _mp4)}


def record(
    html: str,
    length: float,
    speed: float,
    path: str | os.PathLike[str],
    fps: float | None = None,
    size: tuple[int, int] = (800, 600),
    browser: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write a film of a page that `page.page` makes, `length` [s] long and `speed` times as fast as true.

    The rest is as in `View.record`.
    """
    path = path_like("path", path)
    if path.suffix.lower() not in _ENCODERS:
        raise InvalidValue("path", str(path), f"must end in {' or '.join(_ENCODERS)}")
    usual, writing = _ENCODERS[path.suffix.lower()]
    rate = usual if fps is None else positive("fps", fps, "1/s")
    fits = isinstance(size, (tuple, list)) and len(size) == 2
    if not fits or not all(isinstance(x, int) and _SMALLEST <= x <= _LARGEST and x % 2 == 0 for x in size):
        raise InvalidValue("size", size, f"must be two even numbers from {_SMALLEST} to {_LARGEST} [pixels]")
    count = max(2, round(length * rate) + 1)
    if count > _MOST:
        raise InvalidValue("fps", rate, f"must be less: {count} pictures are more than {_MOST}")
    times = [speed * i / rate for i in range(count)]
    with writing(path, rate) as put:
        for i, picture in enumerate(_pictures(html, times, *size, browser), start=1):
            put(picture)
            if progress is not None:
                progress(i / count)


def browser_program(given: str | None = None) -> str:
    """The program of a browser; a `ViewerError` says what is missing."""
    for name in _BROWSERS if given is None else (given,):
        if (found := shutil.which(name)) is not None:
            return found
    if given is not None:
        raise ViewerError(f"there is no browser '{given}'")
    raise ViewerError(
        "recording needs Chromium or Chrome, and none was found: install one, or name it "
        "(--browser; in Python browser=...)"
    )


def _pictures(
    html: str, times: list[float], width: int, height: int, browser: str | None = None
) -> Iterator[bytes]:
    """PNG pictures of a page at times [s] of its motion, in order."""
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
            if kind not in ("picture", "trouble") or not 0 <= size <= _MOST_BYTES:
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

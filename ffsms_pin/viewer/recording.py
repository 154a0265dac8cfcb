"""A scene as a film: a browser without a window draws picture by picture, an encoder strings them.

The page is served to that browser as a live one is, on the loopback interface and under an address with a
random token; it draws itself at one time after the other (Meshcat's `capture_image`) and sends each picture.
"""

from __future__ import annotations

import io
import itertools
import os
import queue
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ffsms_pin.checks import positive
from ffsms_pin.errors import DependencyMissing, InvalidValue, ViewerError
from ffsms_pin.files import path_like, write_atomically, write_content
from ffsms_pin.viewer.page import live_page
from ffsms_pin.viewer.scene import Scene
from ffsms_pin.viewer.server import Server

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
    samples = np.concatenate([np.asarray(one) for one in found[:: max(1, len(found) // 6)]])
    palette = Image.fromarray(samples).quantize(_COLOURS)
    flat = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in found]
    # Hundredths of a second are what the format has; what is lost to rounding is made up for.
    ends = np.round(100.0 / fps * np.arange(len(flat) + 1)).astype(int)
    lasting = (10 * np.diff(ends).clip(min=1)).tolist()
    look: dict[str, Any] = {"save_all": True, "append_images": flat[1:], "duration": lasting, "loop": 0}
    write_atomically(path, lambda file: flat[0].save(file, format="GIF", **look))


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
    scene: Scene,
    title: str,
    facts: dict[str, Any],
    path: str | os.PathLike[str],
    fps: float | None = None,
    size: tuple[int, int] = (800, 600),
    browser: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write a film of a scene with the page that `page.live_page` makes; the rest is as in `View.record`."""
    path = path_like("path", path)
    if path.suffix.lower() not in _ENCODERS:
        raise InvalidValue("path", str(path), f"must end in {' or '.join(_ENCODERS)}")
    usual, writing = _ENCODERS[path.suffix.lower()]
    rate = usual if fps is None else positive("fps", fps, "1/s")
    fits = isinstance(size, (tuple, list)) and len(size) == 2
    if not fits or not all(isinstance(x, int) and _SMALLEST <= x <= _LARGEST and x % 2 == 0 for x in size):
        raise InvalidValue("size", size, f"must be two even numbers from {_SMALLEST} to {_LARGEST} [pixels]")
    speed = facts["speed"]
    count = max(2, round(facts["t"][-1] / speed * rate) + 1)
    if count > _MOST:
        raise InvalidValue("fps", rate, f"must be less: {count} pictures are more than {_MOST}")
    wanted = {"times": [speed * i / rate for i in range(count)], "width": size[0], "height": size[1]}
    page = live_page(title, facts | {"recording": wanted})
    with writing(path, rate) as put:
        for i, picture in enumerate(_pictures(scene, page, count, browser), start=1):
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


def _pictures(scene: Scene, page: str, count: int, browser: str | None) -> Iterator[bytes]:
    """So many PNG pictures that a page of a scene sends."""
    program, drawn = browser_program(browser), queue.Queue[bytes | None](maxsize=8)
    with (
        closing(Server(None, scene, page, drawn)) as server,
        _running(program, server.url) as process,
    ):
        for _ in range(count):
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

"""A scene as a film: a browser without a window draws picture by picture, an encoder strings them."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from ffsms_pin.checks import positive
from ffsms_pin.errors import DependencyMissing, InvalidValue, ViewerError
from ffsms_pin.storage import path_like, write_atomically, write_content
from ffsms_pin.viewer.pictures import pictures

__all__ = ["ENCODERS", "Encoder", "record"]

Put = Callable[[bytes], None]

_COLOURS = 255  # of a gif; all pictures share them, so that what stands still does not flicker
_MOST = 20_000  # pictures
_SMALLEST, _LARGEST = 64, 4096  # [pixels]


class Encoder(NamedTuple):
    """How a kind of file is written.

    Attributes
    ----------
    fps : float
        Pictures a second by default.
    check : callable
        Raises `DependencyMissing` where something is not installed.
    writing : callable
        From a path and pictures a second to a context that gives what takes a picture (PNG). The file is
        there, whole, after the context.
    """

    fps: float
    check: Callable[[], None]
    writing: Callable[[Path, float], AbstractContextManager[Put]]


def _check_gif() -> None:
    if find_spec("PIL") is None:
        raise DependencyMissing("pillow", "a gif", "record")


@contextmanager
def _gif(path: Path, fps: float) -> Iterator[Put]:
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


def _check_mp4() -> None:
    _ffmpeg()


@contextmanager
def _mp4(path: Path, fps: float) -> Iterator[Put]:
    with TemporaryDirectory() as folder:
        film, count = Path(folder) / "film.mp4", 0

        def put(picture: bytes) -> None:
            nonlocal count
            (Path(folder) / f"{count:06d}.png").write_bytes(picture)
            count += 1

        yield put
        # H.264 in the form that every player takes.
        command = [_ffmpeg(), "-y", "-loglevel", "error", "-framerate", f"{fps:g}"]
        command += ["-i", str(Path(folder) / "%06d.png"), "-c:v", "libx264", "-pix_fmt", "yuv420p", str(film)]
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
        if done.returncode != 0 or not film.is_file():
            words = " ".join(done.stderr.decode(errors="replace").split())
            raise ViewerError(f"ffmpeg did not write the film ({words})")
        write_content(path, film.read_bytes())


ENCODERS: Mapping[str, Encoder] = {
    ".gif": Encoder(20.0, _check_gif, _gif),
    ".mp4": Encoder(30.0, _check_mp4, _mp4),
}
"""By the ending of the file."""


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
    """Write a film of a page that `page.page` makes; see `View.record`.

    Parameters
    ----------
    html : str
        The page.
    length : float
        Of the film [s].
    speed : float
        How much faster than true the film plays.
    path : path
    fps, size, browser, progress
        As in `View.record`.
    """
    path = path_like("path", path)
    if path.suffix.lower() not in ENCODERS:
        raise InvalidValue("path", str(path), f"must end in {' or '.join(ENCODERS)}")
    encoder = ENCODERS[path.suffix.lower()]
    encoder.check()
    rate = encoder.fps if fps is None else positive("fps", fps, "1/s")
    width, height = _pixels(size)
    count = max(2, round(length * rate) + 1)
    if count > _MOST:
        raise InvalidValue("fps", rate, f"must be less: {count} pictures are more than {_MOST}")
    times = [speed * i / rate for i in range(count)]
    with encoder.writing(path, rate) as put:
        for i, picture in enumerate(pictures(html, times, width, height, browser), start=1):
            put(picture)
            if progress is not None:
                progress(i / count)


def _pixels(size: tuple[int, int]) -> tuple[int, int]:
    fits = isinstance(size, (tuple, list)) and len(size) == 2
    if not fits or not all(isinstance(x, int) and _SMALLEST <= x <= _LARGEST and x % 2 == 0 for x in size):
        raise InvalidValue("size", size, f"must be two even numbers from {_SMALLEST} to {_LARGEST} [pixels]")
    return size[0], size[1]

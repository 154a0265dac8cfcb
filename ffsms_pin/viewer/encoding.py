"""Pictures as one file: gif by Pillow, mp4 by ffmpeg."""

from __future__ import annotations

import io
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from ffsms_pin.errors import DependencyMissing, ViewerError
from ffsms_pin.storage import write_atomically

__all__ = ["ENCODERS", "Encoder"]

Put = Callable[[bytes], None]

_COLOURS = 255  # of a gif; all pictures share them, so that what stands still does not flicker


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
        write_atomically(path, lambda file: file.write(film.read_bytes()))


ENCODERS: Mapping[str, Encoder] = {
    ".gif": Encoder(20.0, _check_gif, _gif),
    ".mp4": Encoder(30.0, _check_mp4, _mp4),
}
"""By the ending of the file."""

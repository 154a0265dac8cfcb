"""A scene as a film: a browser without a window draws picture by picture, and an encoder strings them."""

from __future__ import annotations

import os
from collections.abc import Callable

from ffsms_pin.checks import positive
from ffsms_pin.errors import InvalidValue
from ffsms_pin.storage import path_like
from ffsms_pin.viewer.encoding import ENCODERS
from ffsms_pin.viewer.pictures import pictures

__all__ = ["record"]

_MOST = 20_000  # pictures
_SMALLEST, _LARGEST = 64, 4096  # [pixels]


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

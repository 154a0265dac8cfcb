"""Film a page of the viewer, `python docs/film.py PAGE.html FILM.gif`, or take one picture, `... FILE.png`.

Headless Chromium, controlled by chromedriver, draws the page at each time of the film, so the film does not
depend on the speed of the machine. Each picture has a clock and, in a capture, the name of the phase. These
commands make the README's film:

    ffsms-pin run capture --out results/capture
    ffsms-pin view results/capture --speed 3 --show robot,panels,client,tracked_path --html capture.html
    python docs/film.py capture.html docs/images/capture.gif --size 640x360 --fps 10 --until 17
"""

from __future__ import annotations

import argparse
import base64
import io
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.support.ui import WebDriverWait

_FLAGS = (
    "--headless=new",
    "--no-sandbox",  # otherwise Chromium does not start as root; the page is trusted
    "--use-angle=swiftshader",  # makes the pictures independent of the graphics card
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--force-device-scale-factor=1",
)
_COLOURS = 255  # size of the palette that all pictures share, so that static parts do not flicker
_PATIENCE = 120.0  # [s] limit for the first picture, which is slow without a graphics card


# The name of a phase by the last mark on the time bar.
_PHASES = {"": "approach", "hold point": "closing in", "rest": "at rest"}


@contextmanager
def opened(page: Path, width: int, height: int) -> Iterator[webdriver.Chrome]:
    """Open a page in a window of the given size [pixels], and stop the animation."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or shutil.which("google-chrome") or ""
    for flag in _FLAGS:
        options.add_argument(flag)
    with webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver"))) as browser:
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.set_script_timeout(_PATIENCE)
        browser.get(page.resolve().as_uri())
        ready = "return document.body.dataset.ready === 'yes'"
        WebDriverWait(browser, _PATIENCE).until(lambda chrome: chrome.execute_script(ready))
        browser.execute_script("setPlaying(false)")
        yield browser


def screenshot(page: Path, time: float, width: int, height: int, bare: bool = False) -> Image.Image:
    """Return a picture of a page at a time of its motion [s]; if `bare`, without the controls."""
    with opened(page, width, height) as browser:
        if bare:
            return scene(browser, time, width, height)
        browser.execute_script("seek(arguments[0])", time)
        drawn = "const done = arguments[0]; viewer.render(); "
        drawn += "requestAnimationFrame(() => requestAnimationFrame(done))"
        browser.execute_async_script(drawn)
        return Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB")


def scene(browser: webdriver.Chrome, time: float, width: int, height: int) -> Image.Image:
    """Return a picture of the scene without the controls, at a time of its motion [s]."""
    fill = "fit({left: 0, top: 0, right: arguments[1], bottom: arguments[2]}, arguments[1], arguments[2]); "
    show = "seek(arguments[0]); return viewer.capture_image()"
    address = browser.execute_script(fill + show, time, width, height)  # a data URL of a PNG image
    return Image.open(io.BytesIO(base64.b64decode(address.split(",")[1]))).convert("RGB")


def pictures(page: Path, rate: float, width: int, height: int, until: float = np.inf) -> list[Image.Image]:
    """Return the pictures of a film of a page, until a time of its motion [s].

    The film has the speed of the page and `rate` pictures per second.
    """
    with opened(page, width, height) as browser:
        script = "return [facts.t.at(-1), facts.speed, facts.marks]"
        end, speed, marks = browser.execute_script(script)
        end = min(end, until)
        images = []
        for time in np.minimum(speed / rate * np.arange(round(end / speed * rate) + 1), end):
            image = scene(browser, float(time), width, height)
            passed = [""] + [mark["name"] for mark in marks if mark["t"] <= time + 1e-6]
            phase = _PHASES.get(passed[-1], passed[-1]) if marks else ""
            write_clock(image, f"t = {time:.1f} s", phase)
            images.append(image)
        return images


def write_clock(image: Image.Image, clock: str, phase: str) -> None:
    """Write the clock and the phase into the lower left corner of a picture."""
    font = Path(mpl.get_data_path()) / "fonts/ttf/DejaVuSans.ttf"
    size = max(6, round(image.height / 20))
    draw, at = ImageDraw.Draw(image), (size, image.height - 2 * size)
    letters = ImageFont.truetype(str(font), size)
    draw.text(at, clock, "white", letters)
    draw.text((at[0] + 6 * size, at[1]), phase, "#FFD27A", letters)


def write_gif(path: Path, images: list[Image.Image], rate: float) -> None:
    """Write pictures as a film that repeats endlessly."""
    sample = np.concatenate([np.asarray(image) for image in images[:: max(1, len(images) // 6)]])
    palette = Image.fromarray(sample).quantize(_COLOURS)
    flat = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    # GIF durations are hundredths of a second; rounding the times avoids an accumulated error.
    ends = np.round(100.0 / rate * np.arange(len(flat) + 1))
    durations = (10.0 * np.diff(ends).clip(min=1.0)).astype(int).tolist()
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=durations, loop=0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Film a page of the viewer.")
    parser.add_argument("page", type=Path, help="file that `ffsms-pin view` or `View.to_html` wrote")
    parser.add_argument("film", type=Path, help="file to write, *.gif or *.png")
    parser.add_argument("--at", type=float, default=0.0, help="time of a *.png [s] (default: %(default)s)")
    parser.add_argument("--bare", action="store_true", help="a *.png without the controls")
    parser.add_argument("--fps", type=float, default=20.0, help="pictures per second (default: %(default)s)")
    parser.add_argument("--size", default="800x600", help="width x height in pixels (default: %(default)s)")
    parser.add_argument("--until", type=float, default=np.inf, help="time of the last picture [s]")
    options = parser.parse_args()
    columns, rows = map(int, options.size.split("x"))
    if options.film.suffix == ".png":
        screenshot(options.page, options.at, columns, rows, options.bare).save(options.film)
    else:
        film = pictures(options.page, options.fps, columns, rows, options.until)
        write_gif(options.film, film, options.fps)

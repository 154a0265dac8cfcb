"""Film a page of the viewer: `python docs/film.py PAGE.html FILM.gif`.

Chromium without a window, driven by its chromedriver, draws the page picture by picture at exact times, so
the film does not depend on the speed of the machine. The README's film is made by

    ffsms-pin run capture --out results/capture
    ffsms-pin view results/capture --speed 3 --show robot,client --html capture.html
    python docs/film.py capture.html docs/images/capture.gif --size 640x360 --fps 10
"""

from __future__ import annotations

import argparse
import base64
import io
import shutil
from pathlib import Path

import numpy as np
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.support.ui import WebDriverWait

_FLAGS = (
    "--headless=new",
    "--no-sandbox",  # Chromium refuses to start for root otherwise; the page is our own
    "--use-angle=swiftshader",  # the same pictures with and without a graphics card
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--force-device-scale-factor=1",
)
_COLOURS = 255  # all pictures share one palette, so that what stands still does not flicker
_PATIENCE = 120.0  # [s] for the first picture; without a graphics card it takes a while


def pictures(page: Path, rate: float, width: int, height: int) -> list[Image.Image]:
    """Draw one pass of a page at its speed, `rate` pictures for each second of film."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or shutil.which("google-chrome") or ""
    for flag in _FLAGS:
        options.add_argument(flag)
    with webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver"))) as browser:
        browser.get(page.resolve().as_uri())
        ready = "return document.body.dataset.ready === 'yes'"
        WebDriverWait(browser, _PATIENCE).until(lambda chrome: chrome.execute_script(ready))
        end, speed = browser.execute_script("setPlaying(false); return [facts.t.at(-1), facts.speed]")
        fill = "viewer.set_3d_pane_size(...arguments); "
        fill += "fit({left: 0, top: 0, right: arguments[0], bottom: arguments[1]}, ...arguments)"
        browser.execute_script(fill, width, height)
        images = []
        for time in np.minimum(speed / rate * np.arange(round(end / speed * rate) + 1), end):
            # A data address of PNG.
            address = browser.execute_script("seek(arguments[0]); return viewer.capture_image()", float(time))
            images.append(Image.open(io.BytesIO(base64.b64decode(address.split(",")[1]))).convert("RGB"))
        return images


def write_gif(path: Path, images: list[Image.Image], rate: float) -> None:
    """Write pictures as a film that is played over and over."""
    sample = np.concatenate([np.asarray(image) for image in images[:: max(1, len(images) // 6)]])
    palette = Image.fromarray(sample).quantize(_COLOURS)
    flat = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    # The format counts in hundredths of a second; a rounded duration does not add up to a delay.
    ends = np.round(100.0 / rate * np.arange(len(flat) + 1))
    durations = (10.0 * np.diff(ends).clip(min=1.0)).astype(int).tolist()
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=durations, loop=0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Film a page of the viewer.")
    parser.add_argument("page", type=Path, help="file that `ffsms-pin view` or `View.to_html` wrote")
    parser.add_argument("film", type=Path, help="file to write, *.gif")
    parser.add_argument("--fps", type=float, default=20.0, help="pictures a second (default: %(default)s)")
    parser.add_argument("--size", default="800x600", help="width x height in pixels (default: %(default)s)")
    options = parser.parse_args()
    columns, rows = map(int, options.size.split("x"))
    write_gif(options.film, pictures(options.page, options.fps, columns, rows), options.fps)

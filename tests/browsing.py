"""Start headless Chromium, and check its screenshots of the viewer's pages, for tests.

Debian's chromium and chromium-driver are required. If they are missing, the tests are skipped; under CI they
fail.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.viewer import View

__all__ = [
    "ARM",
    "SIDE",
    "SceneCamera",
    "check",
    "chromium",
    "configuration_at",
    "errors",
    "is_shade",
    "places",
    "requests",
    "wait_for",
    "wait_for_script",
]

Array = NDArray[np.float64]

_PATIENCE = 60.0  # [s]
_FLAGS = (
    "--headless=new",
    "--no-sandbox",  # required because CI runs as root
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",  # draws without a graphics card
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--force-device-scale-factor=1",
    "--hide-scrollbars",
    "--window-size=1000,760",
)
# Colours of the packaged planar robot's materials, divided by their largest component.
_BODY, ARM = np.array([0.80, 0.78, 0.72]) / 0.80, np.array([0.20, 0.42, 0.63]) / 0.63
_TARGET = np.array([0xD5, 0x5E, 0x00])


@contextmanager
def chromium(profile: Path) -> Iterator[webdriver.Chrome]:
    """Open a headless browser with its files in the folder `profile`."""
    names = ("chromium", "chromium-browser", "google-chrome")
    program = next((path for name in names if (path := shutil.which(name))), None)
    driver = shutil.which("chromedriver")
    if program is None or driver is None:
        missing = "the browser tests were not run: they need chromium and chromium-driver"
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (*_FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
    chrome = webdriver.Chrome(options=options, service=Service(driver))
    chrome.get("about:blank")  # leave the browser's start page, which sends requests
    try:
        yield chrome
    finally:
        chrome.quit()


_TWO_FRAMES = """const done = arguments[arguments.length - 1];
    const next = (then) => requestAnimationFrame(then);
    next(() => { viewer.set_dirty(); next(() => next(done)); });"""


_CAMERA = """const camera = viewer.camera, view = camera.view;
    return [camera.position.toArray(), viewer.controls.target.toArray(), camera.fov,
            view.offsetX, view.offsetY, innerWidth, innerHeight]"""


class SceneCamera:
    """Screenshots of a scene, and the projection of positions into them.

    The projection is computed from the camera's position, its target and the vertical field of view. The
    camera must be on the given side of its target, with z up.
    """

    def __init__(self, browser: webdriver.Chrome, scene: View, side: tuple[float, float, float]) -> None:
        centre = np.array(scene._facts["centre"])
        camera, target, field, *self._offset, self._width, self._height = browser.execute_script(_CAMERA)
        place, looks_at = (np.array([x, -z, y]) + centre for x, y, z in (camera, target))
        away = np.array(side) / np.linalg.norm(side)
        np.testing.assert_allclose((place - looks_at) / np.linalg.norm(place - looks_at), away, atol=1e-5)
        self._browser, self._camera = browser, place
        self._scale = 0.5 * self._height / np.tan(0.5 * np.radians(field))
        right = np.cross(-away, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        self._axes = np.array([right, np.cross(right, -away), -away])

    def position(self, place: Array) -> Array:
        """Return the position of a point in the window, from the upper left corner [pixels]."""
        x, y, depth = self._axes @ (place - self._camera)
        middle = 0.5 * np.array([self._width, self._height]) - self._offset
        return np.asarray(middle + self._scale / depth * np.array([x, -y]))

    def pixel(self, place: Array) -> tuple[int, int]:
        column, row = self.position(place)
        return round(column), round(row)

    def picture(self) -> Array:
        """Return a screenshot (height, width, 3), 0 to 255."""
        self._browser.execute_async_script(_TWO_FRAMES)  # the next frame shows recent changes
        with Image.open(io.BytesIO(self._browser.get_screenshot_as_png())) as image:
            return np.asarray(image.convert("RGB"), dtype=np.float64)

    def colour(self, picture: Array, place: Array) -> Array:
        """Return the mean colour of 3 x 3 pixels at a position."""
        column, row = self.pixel(place)
        patch = picture[row - 1 : row + 2, column - 1 : column + 2]
        assert patch.shape == (3, 3, 3), f"{place} is outside the picture, at {column}, {row}"
        return np.asarray(patch.reshape(9, 3).mean(axis=0))


def is_shade(colour: Array, of: Array) -> bool:
    """Return whether a colour is a material's colour at any brightness above that of the background."""
    return bool(colour.max() > 45.0 and np.abs(colour / colour.max() - of).max() < 0.12)


def places(sms: ffsms.SpaceManipulator, q: Array) -> tuple[Array, list[Array]]:
    """Return a point on the top of the base beside the solar cells, and the middle of each link."""
    data = sms.model.createData()
    pin.forwardKinematics(sms.model, data, q)
    assert sms.base_size is not None
    length, _, height = sms.base_size
    top = data.oMi[1].act(np.array([-0.475 * length, 0.12, 0.5 * height]))
    return np.array(top), [np.array(data.oMi[j].act(np.array([0.15, 0.0, 0.0]))) for j in (2, 3, 4)]


def check(eye: SceneCamera, sms: ffsms.SpaceManipulator, q: Array, target: Array, others: Array) -> None:
    """Check that base, arm and target are drawn at q (nq,), and the arm not at `others` (nq,)."""
    base, links = places(sms, q)
    elsewhere = places(sms, others)[1][2]

    def differences() -> list[str]:
        picture = eye.picture()
        faults = [f"base {eye.colour(picture, base)}"] * (not is_shade(eye.colour(picture, base), _BODY))
        faults += [
            f"link at {link} {eye.colour(picture, link)}"
            for link in links
            if not is_shade(eye.colour(picture, link), ARM)
        ]
        if np.abs(eye.colour(picture, target) - _TARGET).max() > 12.0:
            faults.append(f"target {eye.colour(picture, target)}")
        if is_shade(eye.colour(picture, elsewhere), ARM):
            faults.append(f"an arm at {elsewhere}")
        return faults

    wait_for(lambda: not differences(), differences)


def wait_for(holds: Callable[[], bool], explain: Callable[[], object]) -> None:
    """Wait up to 15 s for a condition, because drawing without a graphics card is slow."""
    started = time.monotonic()
    while not holds():
        if time.monotonic() - started > 15.0:
            pytest.fail(str(explain()))
        time.sleep(0.2)


def wait_for_script(browser: webdriver.Chrome, script: str) -> None:
    started = time.monotonic()
    while not browser.execute_script(script):
        if time.monotonic() - started > _PATIENCE:
            pytest.fail(f"the page never came to: {script}; it says {errors(browser)}")
        time.sleep(0.05)


def requests(browser: webdriver.Chrome) -> list[str]:
    """Return the addresses of requests since the last call."""
    entries: list[Any] = browser.get_log("performance")  # type: ignore[no-untyped-call]
    messages = [json.loads(entry["message"])["message"] for entry in entries]
    return [
        str(item["params"]["request"]["url"])
        for item in messages
        if item["method"] == "Network.requestWillBeSent"
    ]


def errors(browser: webdriver.Chrome) -> list[str]:
    entries: list[Any] = browser.get_log("browser")  # type: ignore[no-untyped-call]
    return [str(entry["message"]) for entry in entries if entry["level"] == "SEVERE"]


def configuration_at(sms: ffsms.SpaceManipulator, trajectory: opt.Trajectory, t: float) -> Array:
    """Return the configuration at a time between two nodes."""
    k = min(int(t / trajectory.dt), len(trajectory.t) - 2)
    share = t / trajectory.dt - k
    return np.array(pin.interpolate(sms.model, trajectory.q[k], trajectory.q[k + 1], share))


SIDE = (-0.12, -0.75, 1.5)  # a planar motion is seen from above

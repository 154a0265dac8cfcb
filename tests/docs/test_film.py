"""Test the positions of the arm and the durations of the pictures of `docs/film.py`."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from PIL import Image
from scripts import load_script

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.viewer import view

WIDTH, HEIGHT, RATE = 160, 120, 4.0


@pytest.fixture(scope="module", autouse=True)
def chromium() -> None:
    if shutil.which("chromedriver") is None:
        missing = "no film was made: it needs chromium and chromium-driver"
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)


def test_a_film_shows_the_motion_at_its_speed(planar: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    q0 = planar.configuration([0.4, 0.7, -0.5])
    plan = measure(opt.Problem(planar, q0, [0.5, 0.5, 0.0], 2.0, 0.1), 0.4 * np.ones((21, 3)))
    scene = view(planar, plan, show="robot", speed=2.0, camera="top")
    scene.to_html(tmp_path / "page.html")
    script = load_script("docs/film.py")
    images = script.pictures(tmp_path / "page.html", RATE, WIDTH, HEIGHT)
    assert len(images) == 5  # one second of film, and the last instant
    # The camera is above, with a vertical field of view of 40 degrees, and all points are within nine tenths
    # of the picture. The pose of the last link is computed by Pinocchio.
    centre, points = np.array(scene._facts["centre"]), np.array(scene._facts["seen"])
    slope, shares = np.tan(np.radians(20.0)), 0.9 * np.tan(np.radians(20.0)) * np.array([WIDTH / HEIGHT, 1.0])
    high, low = (points[:, 2:] + s * points[:, :2] / shares for s in (1.0, -1.0))
    high, low = high.max(axis=0), low.max(axis=0)
    distance, middle = 0.5 * (high + low).max(), 0.5 * shares * (high - low)
    data = planar.model.createData()
    for image, row in zip(images, (0, 5, 10, 15, 20), strict=True):
        assert image.size == (WIDTH, HEIGHT)
        pin.forwardKinematics(planar.model, data, plan.q[row])
        x, y, z = data.oMi[4].act(np.array([0.15, 0.0, 0.0])) - centre
        scale = 0.5 * HEIGHT / slope / (distance - z)
        column, line = (
            round(0.5 * WIDTH + scale * (x - middle[0])),
            round(0.5 * HEIGHT - scale * (y - middle[1])),
        )
        patch = np.asarray(image, dtype=np.float64)[line - 1 : line + 2, column - 1 : column + 2]
        assert (patch[..., 2] - patch[..., 0]).max() > 60.0

    script.write_gif(tmp_path / "film.gif", images, RATE)
    with Image.open(tmp_path / "film.gif") as film:
        assert film.size == (WIDTH, HEIGHT)
        assert film.info["loop"] == 0
        for k in range(len(images)):
            film.seek(k)
            assert film.info["duration"] == 250  # [ms]
            assert np.abs(np.asarray(film.convert("RGB"), float) - np.asarray(images[k], float)).mean() < 2.0

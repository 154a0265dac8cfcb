"""Films of a scene: pictures that a browser without a window draws, as gif and as mp4."""

from __future__ import annotations

import io
import os
import shutil
import stat
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from PIL import Image

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.cli import main
from ffsms_pin.errors import DependencyMissing, InvalidValue, ViewerError
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.viewer import View, recording, view
from ffsms_pin.viewer.frames import surroundings
from ffsms_pin.viewer.recording import browser_program

# Writes what it was asked for and the pictures that it got, in place of ffmpeg.
STAND_IN = f"""#!{sys.executable}
import sys, pathlib
pattern = pathlib.Path(sys.argv[sys.argv.index("-i") + 1])
pictures = b"".join(one.read_bytes() for one in sorted(pattern.parent.glob("*.png")))
pathlib.Path(sys.argv[-1]).write_bytes(" ".join(sys.argv[1:-1]).encode() + bytes([10]) + pictures)
"""


@pytest.fixture(scope="module")
def moved(planar: ffsms.SpaceManipulator) -> opt.Trajectory:
    problem = opt.Problem(planar, planar.configuration([0.4, 0.7, -0.5]), [0.5, 0.5, 0.0], 2.0, 0.1)
    return measure(problem, 0.4 * np.ones((21, 3)))


@pytest.fixture(scope="module")
def scene(planar: ffsms.SpaceManipulator, moved: opt.Trajectory) -> View:
    return view(planar, moved, show="robot", speed=2.0, camera="top")


def frames(film: Any) -> int:
    """How many pictures a film has."""
    return int(film.n_frames)


@pytest.fixture
def browser() -> str:
    try:
        return browser_program()
    except ViewerError as error:
        if os.environ.get("CI"):
            pytest.fail(str(error))
        pytest.skip(f"no film was recorded: {error}")


@pytest.mark.usefixtures("browser")
def test_a_gif_shows_the_motion_in_its_time(
    planar: ffsms.SpaceManipulator, moved: opt.Trajectory, scene: View, tmp_path: Path
) -> None:
    shares: list[float] = []
    path = tmp_path / "film.gif"
    scene.record(path, fps=4.0, size=(160, 120), progress=shares.append)
    with Image.open(path) as film:
        assert film.size == (160, 120)
        assert frames(film) == 5  # a second of film, and the last instant
        pictures, lasting = [], []
        for i in range(5):
            film.seek(i)
            pictures.append(np.asarray(film.convert("RGB"), dtype=np.float64))
            lasting.append(film.info["duration"])
        assert film.info["loop"] == 0
    assert lasting == [250] * 5
    assert shares == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    # The last link is where Pinocchio and the camera put it, from above at 1.65 radii.
    centre, radius = surroundings(scene._frames)
    data = planar.model.createData()
    for picture, row in zip(pictures, (0, 5, 10, 15, 20), strict=True):
        pin.forwardKinematics(planar.model, data, moved.q[row])
        x, y, z = data.oMi[4].act(np.array([0.15, 0.0, 0.0])) - centre
        scale = 60.0 / np.tan(np.radians(37.5)) / (1.65 * radius - z)
        column, line = round(80.0 + scale * x), round(60.0 - scale * y)
        blue = picture[line - 1 : line + 2, column - 1 : column + 2]
        assert (blue[..., 2] - blue[..., 0]).max() > 60.0
    assert [one.name for one in tmp_path.iterdir()] == ["film.gif"]


@pytest.mark.skipif(sys.platform == "win32", reason="a script as a program")
@pytest.mark.usefixtures("browser")
def test_an_mp4_is_what_ffmpeg_makes_of_the_pictures(
    scene: View, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text(STAND_IN)
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    scene.record(tmp_path / "film.mp4", fps=2.0, size=(160, 120))
    asked, _, pictures = (tmp_path / "film.mp4").read_bytes().partition(b"\n")
    assert b"-framerate 2 " in asked
    assert b"libx264 -pix_fmt yuv420p" in asked
    start = b"\x89PNG"
    found = [start + part for part in pictures.split(start)[1:]]
    assert len(found) == 3
    for one in found:
        with Image.open(io.BytesIO(one)) as image:
            assert image.size == (160, 120)

    program.write_text(f"#!{sys.executable}\nimport sys\nsys.exit('no such encoder')\n")
    with pytest.raises(ViewerError, match="no such encoder"):
        scene.record(tmp_path / "other.mp4", fps=2.0, size=(160, 120))
    assert not (tmp_path / "other.mp4").exists()


def test_what_cannot_be_recorded_is_said_before_a_browser_starts(
    scene: View, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InvalidValue, match=r"must end in .gif or .mp4"):
        scene.record(tmp_path / "film.avi")
    with pytest.raises(InvalidValue, match="two even numbers"):
        scene.record(tmp_path / "film.gif", size=(161, 120))
    with pytest.raises(InvalidValue, match="fps"):
        scene.record(tmp_path / "film.gif", fps=0.0)
    with pytest.raises(ViewerError, match="no browser 'netscape'"):
        scene.record(tmp_path / "film.gif", browser="netscape")
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(ViewerError, match="needs Chromium or Chrome"):
        scene.record(tmp_path / "film.gif")
    monkeypatch.setattr(recording, "find_spec", lambda name: None)
    with pytest.raises(DependencyMissing, match=r"pillow.*ffsms-pin\[record\]"):
        scene.record(tmp_path / "film.gif")
    with pytest.raises(DependencyMissing, match=r"imageio-ffmpeg.*ffsms-pin\[record\]"):
        scene.record(tmp_path / "film.mp4")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="a script as a program")
def test_a_browser_that_ends_is_told(scene: View, tmp_path: Path) -> None:
    program = tmp_path / "browser"
    program.write_text(f"#!{sys.executable}\nraise SystemExit(3)\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    with pytest.raises(ViewerError, match=r"the browser ended \(exit code 3\)"):
        scene.record(tmp_path / "film.gif", browser=str(program))
    assert not (tmp_path / "film.gif").exists()


@pytest.mark.usefixtures("browser")
def test_on_the_command_line(
    planar: ffsms.SpaceManipulator,
    moved: opt.Trajectory,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    results = tmp_path / "results"
    results.mkdir()
    moved.save(results / "trajectory.npz")
    film = tmp_path / "film.gif"
    asked = ["view", str(results), "--robot", "planar_3r", "--record", str(film)]
    wanted = ["--speed", "4", "--camera", "side", "--fps", "4", "--size", "160x120"]
    assert main([*asked, *wanted]) == 0
    assert f"film: {film}" in capsys.readouterr().out
    with Image.open(film) as opened:
        assert frames(opened) == 3
    assert main([*asked, "--size", "large"]) == 2
    assert main([*asked, "--html", "other.html"]) == 2
    assert main([*asked, "--camera", "behind"]) == 2
    words = capsys.readouterr().err.splitlines()
    assert [part in line for part, line in zip(["800x600", "--html", "camera"], words, strict=True)] == [
        True
    ] * 3

"""Test the viewer's page as a file, in a notebook and from the command line."""

from __future__ import annotations

import json
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from exported import ExportedPage

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.cli import main
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidValue, ResultError
from ffsms_pin.viewer import View, view


def test_the_file_is_written_whole_or_not_at_all(scene: View, tmp_path: Path) -> None:
    path = tmp_path / "scene.html"
    scene.to_html(path)
    assert path.read_text("utf-8").rstrip().endswith("</html>")
    assert [item.name for item in tmp_path.iterdir()] == ["scene.html"]
    with pytest.raises(ResultError):
        scene.to_html(tmp_path / "nowhere" / "scene.html")


def test_a_notebook_shows_the_same_page(scene: View) -> None:
    inline = scene._repr_html_()
    assert inline.startswith("<iframe srcdoc=")
    assert inline.count('"') == 4  # quotes within the attribute are escaped


def test_titles_are_escaped(planar: ffsms.SpaceManipulator, plan: opt.Trajectory) -> None:
    text = view(planar, plan, fps=1.0, title="</script><b>x").html()
    assert "</script><b>x" not in text
    assert "&lt;/script&gt;&lt;b&gt;x" in text


def test_results_of_another_robot_are_refused(
    plan: opt.Trajectory, refused: Callable[..., FfsmsError]
) -> None:
    refused(lambda: view(ffsms.load("space_arm_7"), plan), InvalidValue, "another robot")
    wrong: Any = "plan.npz"
    refused(lambda: view(ffsms.load("space_arm_7"), wrong), InvalidValue, "Trajectory")


def test_the_command_writes_a_scene(
    planar: ffsms.SpaceManipulator,
    plan: opt.Trajectory,
    tracking: ffsms.Tracking,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    plan.save(tmp_path / "trajectory.npz")
    tracking.save(tmp_path / "tracking.npz")
    (tmp_path / "summary.json").write_text(json.dumps({"scenario": "mine", "robot": "planar_3r"}))
    out = tmp_path / "out.html"
    assert main(["view", str(tmp_path), "--html", str(out), "--show", "robot,limits"]) == 0
    assert str(out) in capsys.readouterr().out
    opened = ExportedPage(out.read_text("utf-8"))
    assert {x["name"] for x in opened.facts["layers"] if x["shown"]} == {"robot", "limits"}
    assert "mine" in opened.text


def test_errors_of_the_view_command_are_single_lines(
    plan: opt.Trajectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def line(*arguments: str) -> str:
        assert main(["view", *arguments]) == 2
        printed_error = capsys.readouterr().err
        assert printed_error.count("\n") == 1
        return printed_error

    assert "not a folder" in line(str(tmp_path / "nothing"))
    assert "trajectory.npz" in line(str(tmp_path))
    plan.save(tmp_path / "trajectory.npz")
    assert "--robot" in line(str(tmp_path))  # there is no summary with the robot
    assert "not a motion of" in line(str(tmp_path), "--robot", "space_arm_7")
    (tmp_path / "summary.json").write_text("[")
    assert "summary.json" in line(str(tmp_path))
    (tmp_path / "summary.json").write_text('{"scenario": "x", "robot": "gone.urdf"}')
    assert "gone.urdf" in line(str(tmp_path))


def test_the_result_may_come_first(planar: ffsms.SpaceManipulator) -> None:
    plan = ffsms.opt.plan(planar, planar.configuration([0.4, 0.7, -0.5]), [0.75, 0.5, 0.0], 2.0, 0.1)
    result_first, robot_first = ffsms.view(plan, planar).html(), ffsms.view(planar, plan).html()
    assert abs(len(result_first) - len(robot_first)) < 100  # the names of the scene's objects are random
    with pytest.raises(InvalidValue, match="must be a SpaceManipulator"):
        ffsms.view(plan, plan)


def test_a_scene_opens_in_the_browser_and_its_file_is_kept(
    scene: View, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[str] = []
    monkeypatch.setenv("DISPLAY", ":0")

    def show(url: str) -> bool:
        shown.append(url)
        return True

    monkeypatch.setattr(webbrowser, "open", show)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    named = scene.open(tmp_path / "mine.html")
    unnamed = scene.open()
    assert shown == [named.as_uri(), unnamed.as_uri()]
    assert named == tmp_path / "mine.html"
    assert unnamed.read_text("utf-8") == named.read_text("utf-8") == scene.html()


def test_a_scene_without_a_display_names_its_file(
    scene: View, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.warns(FfsmsWarning, match=r"mine\.html, but there is no browser or no display"):
        scene.open(tmp_path / "mine.html")
    assert (tmp_path / "mine.html").exists()

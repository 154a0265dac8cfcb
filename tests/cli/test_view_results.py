"""Test that the scenes of `run --show` and `view` have the obstacles of the scenario."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from scenario_files import QUICK, write

from ffsms_pin.cli import main

OBSTACLE = '[[obstacle]]\nshape = "sphere"\nradius = 0.05\nposition = [1.2, 1.0, 0.0]\n'


def layers(page: Path) -> set[str]:
    """Return the names of the layers of a page."""
    return set(re.findall(r'"name": "(\w+)", "shown"', page.read_text("utf-8")))


def test_show_writes_the_scene_with_its_obstacles(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    out = tmp_path / "out"
    file = write(tmp_path, QUICK + OBSTACLE)
    assert main(["run", str(file), "--out", str(out), "--no-figures", "--show"]) == 0
    assert f"to see the motion, open {out / 'view.html'}" in capsys.readouterr().out
    assert {"robot", "obstacles", "tracked_path"} <= layers(out / "view.html")

    file.unlink()  # the results contain the scenario
    assert main(["view", str(out), "--html", str(tmp_path / "plan.html"), "--plan"]) == 0
    names = layers(tmp_path / "plan.html")
    assert "obstacles" in names
    assert "tracked_path" not in names
    (out / "scenario.json").unlink()
    assert main(["view", str(out), "--html", str(tmp_path / "plain.html")]) == 0
    assert "obstacles" not in layers(tmp_path / "plain.html")

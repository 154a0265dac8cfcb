"""Test that errors name a missing extra, and that everything else works without it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HIDE = """
import importlib.util, sys
hidden = {hidden!r}
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *a: None if name.split(".")[0] in hidden else found(name, *a)
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hidden())
"""


def without(hidden: tuple[str, ...], code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run `code` in a new interpreter in which some modules cannot be imported."""
    return subprocess.run(
        [sys.executable, "-c", HIDE.format(hidden=hidden) + code],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.mark.parametrize(
    ("hidden", "code", "extra"),
    [
        ("matplotlib", "import ffsms_pin.plotting", "plot"),
        ("meshcat", "import ffsms_pin; ffsms_pin.view", "view"),
        ("umsgpack", "import ffsms_pin; ffsms_pin.view", "view"),
        ("example_robot_data", "import ffsms_pin; ffsms_pin.load('satellite_panda')", "robots"),
    ],
)
def test_the_error_names_the_extra(hidden: str, code: str, extra: str, tmp_path: Path) -> None:
    done = without((hidden,), code, tmp_path)
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("ffsms_pin.errors.DependencyMissing")
    assert f"pip install 'ffsms-pin[{extra}]'" in last


@pytest.mark.slow
def test_a_scenario_runs_without_optional_packages(tmp_path: Path) -> None:
    hidden = ("matplotlib", "meshcat", "umsgpack", "example_robot_data")
    code = "from ffsms_pin.cli import main; sys.exit(main(['run', 'case-1', '--out', 'here']))"
    done = without(hidden, code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "pip install 'ffsms-pin[plot]'" in done.stderr
    assert sorted(path.name for path in (tmp_path / "here").iterdir()) == [
        "scenario.json",
        "summary.json",
        "tracking.npz",
        "trajectory.npz",
    ]

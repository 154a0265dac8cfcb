"""Run the scripts of examples/, and check that they succeed in time and print a result."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))
ARGUMENTS = {"coupling_map": ["map.png"]}
# Notebooks and the code of pages run the same functions in .ci/run.
SLOWEST = {
    "capture",
    "follow_path",
    "meet_client",
    "noisy_sensors",
    "hold_attitude",
    "campaign",
    "basilisk_orbit",
}
SLOWEST |= {
    "reach_pose",
    "two_arms",
    "live_meshcat",
    "disturbance",
    "wrong_model",
    "compare_laws",
    "identify_base",
}
LONGEST = 180.0  # [s] of wall time on a busy machine; a script takes a few seconds alone


def test_the_page_lists_every_script_once() -> None:
    page = (Path(__file__).parents[2] / "docs" / "examples.md").read_text(encoding="utf-8")
    listed = re.findall(r"\[`(\w+)\.py`\]\(\.\./examples/\1\.py\)", page)
    assert sorted(listed) == [path.stem for path in SCRIPTS], "add a line to docs/examples.md"


def test_the_page_shows_a_picture_of_every_script_that_draws() -> None:
    """The page has a picture with the name of every script that writes a page or a figure."""
    page = (Path(__file__).parents[2] / "docs" / "examples.md").read_text(encoding="utf-8")
    shown = re.findall(r"!\[[^]]+\]\(images/(?:example-)?([\w-]+)\.png\) `(\w+)\.py`", page)
    assert all(picture.replace("-", "_") == script for picture, script in shown)
    draws = [path.stem for path in SCRIPTS if re.search(r"\.to_html\(|\.savefig\(", path.read_text("utf-8"))]
    assert sorted(script for _, script in shown) == draws


@pytest.mark.slow
@pytest.mark.parametrize(
    "script",
    [pytest.param(path, id=path.stem, marks=[pytest.mark.long] * (path.stem in SLOWEST)) for path in SCRIPTS],
)
def test_a_script_runs_and_keeps_what_it_asserts(script: Path, tmp_path: Path) -> None:
    """Scripts contain assertions; missing packages are failures, because `[dev]` has all packages."""
    text = script.read_text(encoding="utf-8")
    assert ast.get_docstring(ast.parse(text)), "a script begins by saying what it shows"
    done = subprocess.run(
        [sys.executable, str(script), *ARGUMENTS.get(script.stem, [])],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=LONGEST,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr, done.stderr
    assert done.stdout.strip(), "a script prints its result"
    if ".to_html(" in text:
        assert (tmp_path / f"{script.stem}.html").is_file()
    for figure in (word for word in ARGUMENTS.get(script.stem, []) if word.endswith(".png")):
        assert (tmp_path / figure).stat().st_size > 10_000

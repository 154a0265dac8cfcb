"""Test that measured numbers of pages come from records, and that help texts list all names."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

import pytest
from scripts import load_script

from ffsms_pin.cli.main import parser
from ffsms_pin.robot import satellite_names
from ffsms_pin.scenarios import scenario_names
from ffsms_pin.urdf import model_names

ROOT = Path(__file__).parents[2]
TABLE = "| robot | off by [mm] |\n|---|---|\n| `planar_3r` | 0.4 |\n"
SHOWN = f"<!-- record: mine -->\n\n{TABLE}\n*`python mine.py`, 2026-11-23, two cores.*\n\n<!-- end -->\n\n"

records = load_script("docs/records.py")


@pytest.mark.parametrize("page", records.pages(), ids=lambda page: page.name)
def test_every_page_shows_what_was_measured(page: Path) -> None:
    assert records.faults(page) == []


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        ("The rate is @@RATE@@ deg/s.\n", "placeholder"),
        (f"As measured:\n\n{TABLE}", "numbers that are in no record"),
        (f"<!-- record: mine -->\n\n{TABLE.replace('0.4', '0.3')}\n<!-- end -->\n", "shows old records"),
        (f"{TABLE}\n*Copied from `python mine.py`, 2026-11-23.*\n", None),
        (f"{TABLE}\n<!-- not measured -->\n", None),
        ("The tip ends 0.4 mm off.\n", "no record of the page"),
        (f"{SHOWN}It ends 0.4 mm off.\n", None),
        (f"{SHOWN}It ends 0.5 mm off.\n", "no record of the page"),
        ("The tip ends 0.4 mm off (`tests/opt/test_tips.py`).\n", None),
        ("The tolerance is 0.4 mm. <!-- given -->\n", None),
    ],
)
def test_a_number_without_a_source_is_found(
    text: str, fragment: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(records, "ROOT", tmp_path)
    monkeypatch.setattr(records, "KEPT", tmp_path)
    record = records.Record("python mine.py", "2026-11-23", "two cores", "0", TABLE.strip())
    (tmp_path / "mine.md").write_text(record.text(), "utf-8")
    page = tmp_path / "page.md"
    page.write_text(text, "utf-8")
    faults = records.faults(page)
    assert (not faults) if fragment is None else (len(faults) == 1 and fragment in faults[0])


def test_a_command_that_changed_is_marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "ROOT", tmp_path)
    (tmp_path / "mine.py").write_text("import part\nfrom other import thing\n", "utf-8")
    for name in ("part", "other"):
        (tmp_path / f"{name}.py").write_text("thing = 1\n", "utf-8")
    source = records.source_of("python mine.py --fast")
    monkeypatch.setattr(records, "KEPT", tmp_path)
    record = records.Record("python mine.py --fast", "2026-11-23", "two cores", source, TABLE.strip())
    (tmp_path / "mine.md").write_text(record.text(), "utf-8")
    page = records.with_records("<!-- record: mine -->\n<!-- end -->\n")
    assert records.marked(page) == page
    (tmp_path / "other.py").write_text('"""A thing."""\n\nthing = 1  # of a kind\n', "utf-8")
    assert records.marked(page) == page
    (tmp_path / "other.py").write_text("thing = 2\n", "utf-8")
    assert records.CHANGED in records.marked(page)


def helped(command: str) -> str:
    """Return the help of a command in one line."""
    actions = parser()._subparsers
    assert actions is not None
    made: ArgumentParser = actions._group_actions[0].choices[command]  # type: ignore[index]
    return " ".join(made.format_help().split())


def test_help_lists_every_robot_and_scenario() -> None:
    for name in (*model_names(), *satellite_names()):
        assert name in helped("info")
    for name in scenario_names():
        assert name in helped("run")
        assert name in helped("scenario")

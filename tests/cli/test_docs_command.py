"""`ffsms-pin docs`: every page that a message or a help text names can be read where the library is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import ffsms_pin
from ffsms_pin.cli import main
from ffsms_pin.cli.docs import page_path, page_titles

PACKAGE = Path(ffsms_pin.__file__).parent


def test_pages_are_listed_with_their_titles(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (line,) = [line for line in lines if line.split()[:1] == ["scenarios"]]
    assert line.split(maxsplit=1)[1].strip() == "Scenario files"


def test_a_page_is_printed_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs", "viewer"]) == 0
    assert capsys.readouterr().out.strip() == page_path("viewer").read_text("utf-8").strip()


def test_a_misspelt_page_is_guessed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs", "scenrios"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "scenarios" in error.partition("; ")[2]


def test_every_page_that_is_named_is_there() -> None:
    """In messages, help texts and docstrings, of the library and of opt."""
    named: dict[str, str] = {}
    for folder in (PACKAGE, PACKAGE.parent / "opt"):
        for path in folder.rglob("*.py"):
            text = path.read_text("utf-8")
            found = re.findall(r"docs/([a-z0-9-]+)\.md", text) + re.findall(r"ffsms-pin docs ([a-z-]+)", text)
            named.update(dict.fromkeys(found, str(path)))
    named.pop("scenrios", None)
    assert {"scenarios", "campaigns", "horizon"} <= named.keys()
    missing = {page: where for page, where in named.items() if page not in page_titles()}
    assert not missing

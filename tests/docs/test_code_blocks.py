"""Run the Python blocks of README and docs, and parse their commands."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from page_code import PYTHON, run_page, shown

from ffsms_pin.cli.main import parser

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# Pages with their own tests, tests/docs/test_own_parts.py and test_bases_that_act.py.
OWN_TEST = {"own-parts.md", "bases-that-act.md"}
GENERATED = {"agreement.md", "paper-map.md"}
NAMES = [path.name for path in PAGES if path.name not in GENERATED]
SHELL = re.compile(r"^```sh\n(.*?)^```$", re.S | re.M)


def path_of(name: str) -> Path:
    return next(path for path in PAGES if path.name == name)


def text_of(name: str) -> str:
    return path_of(name).read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in NAMES if n not in OWN_TEST and PYTHON.search(text_of(n))])
def test_python_blocks_run_in_order_and_draw_the_pictures_of_the_page(name: str, tmp_path: Path) -> None:
    run_page(path_of(name), tmp_path)
    assert set(shown(path_of(name))) <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.parametrize("name", NAMES)
def test_pictures_exist_and_are_small_and_their_page_has_code(name: str) -> None:
    pictures = shown(path_of(name))
    assert not pictures or PYTHON.search(text_of(name))
    for picture in pictures:
        assert (ROOT / "docs" / "images" / picture).stat().st_size <= 100_000


@pytest.mark.parametrize("name", [name for name in NAMES if SHELL.search(text_of(name))])
def test_commands_can_be_parsed(name: str) -> None:
    for block in SHELL.findall(text_of(name)):
        for line in block.splitlines():
            arguments = shlex.split(line, comments=True)
            if arguments[:1] == ["ffsms-pin"] and arguments[1:] not in (["--help"], []):
                parser().parse_args(arguments[1:])  # exits for an unknown argument

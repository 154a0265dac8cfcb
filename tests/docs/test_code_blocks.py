"""Every Python block of README and docs runs as printed, and every command of theirs is one of ours."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

from ffsms_pin.cli.main import parser

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# Run, and looked at, by tests of their own: tests/docs/test_own_parts.py and test_bases_that_act.py.
OWN_TEST = {"own-parts.md", "bases-that-act.md"}
GENERATED = {"agreement.md", "paper-map.md"}
NAMES = [path.name for path in PAGES if path.name not in GENERATED]
PYTHON = re.compile(r"^```python\n(.*?)^```$", re.S | re.M)
FILE = re.compile(r"^```toml\n# (\S+\.toml)\n(.*?)^```$", re.S | re.M)  # a file that the page uses
SHELL = re.compile(r"^```sh\n(.*?)^```$", re.S | re.M)


def text_of(name: str) -> str:
    return next(path for path in PAGES if path.name == name).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", [n for n in NAMES if n not in OWN_TEST and PYTHON.search(text_of(n))])
def test_python_blocks_run_one_after_the_other(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mpl.use("Agg")
    for title, text in FILE.findall(text_of(name)):
        (tmp_path / title).write_text(text, encoding="utf-8")
    names: dict[str, Any] = {}
    for block in PYTHON.findall(text_of(name)):
        exec(compile(block, name, "exec"), names)


@pytest.mark.parametrize("name", [name for name in NAMES if SHELL.search(text_of(name))])
def test_commands_are_understood(name: str) -> None:
    for block in SHELL.findall(text_of(name)):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            if words[:1] == ["ffsms-pin"] and words[1:] not in (["--help"], []):
                parser().parse_args(words[1:])  # ends the test where it does not know a word

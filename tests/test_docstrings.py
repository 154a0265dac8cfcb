"""Test that docstrings begin with a verb, or with an article and its noun."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
HEADLESS = re.compile(
    r"(What|Of|How|Where|Whether|As|Those|Like|From|In|One|With|To|At|By|If|On|When|For)\b"
    r"|(?!(Bring|Need|Embed|Feed|Speed)\b)\w+(ed|ing)\b"
)
KINDS = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def test_docstrings_begin_with_a_verb_or_a_noun() -> None:
    faults = [
        f"{path.relative_to(ROOT)}: {text.splitlines()[0]}"
        for path in [*ROOT.glob("ffsms_pin/**/*.py"), *ROOT.glob("opt/**/*.py")]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, KINDS) and HEADLESS.match(text := ast.get_docstring(node) or "")
    ]
    assert faults == []


def test_the_pattern_matches_docstrings_without_verb_or_noun() -> None:
    for text in ("What is left", "Of values", "Planned numbers", "Whether it rests"):
        assert HEADLESS.match(text)
    for text in ("Return the slack", "The slack", "Bring the arm to rest", "Check a name", "A goal"):
        assert not HEADLESS.match(text)

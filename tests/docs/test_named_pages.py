"""Test that pages of the documentation that messages, help texts and docstrings name exist."""

from __future__ import annotations

import re
from pathlib import Path

import ffsms_pin

PACKAGE = Path(ffsms_pin.__file__).parent


def test_every_named_page_exists() -> None:
    named: dict[str, str] = {}
    for folder in (PACKAGE, PACKAGE.parent / "opt"):
        for path in (*folder.rglob("*.py"), *folder.rglob("*.toml")):
            named.update(
                dict.fromkeys(re.findall(r"docs/([a-z0-9-]+)\.md", path.read_text("utf-8")), str(path))
            )
    assert {"scenario-keys", "planner"} <= named.keys()
    pages = {path.stem for path in (PACKAGE.parent / "docs").glob("*.md")}
    assert not {page: where for page, where in named.items() if page not in pages}

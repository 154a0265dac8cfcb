"""Make the README for package indexes, with absolute links instead of relative ones.

Without an address (`Source` of `[project.urls]`) pictures are left out, and links become plain text.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_PICTURE = re.compile(r"!\[([^\]]*)\]\((?!https?:)([^)]+)\)")
_LINK = re.compile(r"(?<!!)\[([^\]]*)\]\((?!https?:)([^)]+)\)")
_TABLE = re.compile(r"^\|.*!\[.*\]\((?!https?:).*\|\n\|[-|]+\|\n", re.M)  # a table that has only pictures


def long_description(readme: str, source: str | None = None) -> str:
    """Return the README's text with absolute links to files, or without links if there is no address.

    Parameters
    ----------
    readme : str
        Text of the README.
    source : str, optional
        Address of the repository.
    """
    if source is None:
        return _LINK.sub(r"\1", _PICTURE.sub("", _TABLE.sub("", readme)))
    source = source.rstrip("/")
    pictured = _PICTURE.sub(rf"![\1]({source}/raw/main/\2)", readme)
    return _LINK.sub(rf"[\1]({source}/blob/main/\2)", pictured)


def dynamic_metadata(settings: Mapping[str, Any], project: Mapping[str, Any]) -> dict[str, Any]:
    """Return the dynamic field `readme` of pyproject.toml; scikit-build-core calls this function."""
    text = Path("README.md").read_text(encoding="utf-8")
    source = project.get("urls", {}).get("Source")
    return {"readme": {"content-type": "text/markdown", "text": long_description(text, source)}}

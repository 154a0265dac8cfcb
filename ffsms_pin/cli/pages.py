"""The pages of the documentation as files: beside the package in a clone, inside it where it is installed."""

from __future__ import annotations

from pathlib import Path

import ffsms_pin
from ffsms_pin.errors import InvalidValue, meant

__all__ = ["page_path", "page_titles"]


def _folder() -> Path:
    package = Path(ffsms_pin.__file__).parent
    inside = package / "docs"
    return inside if inside.is_dir() else package.parent / "docs"


def page_titles() -> dict[str, str]:
    """Titles of all pages by their names, as {"scenarios": "Scenario files"}."""
    found = {}
    for path in sorted(_folder().glob("*.md")):
        first = path.read_text("utf-8").lstrip().partition("\n")[0]
        found[path.stem] = first.lstrip("# ").strip()
    return found


def page_path(name: str) -> Path:
    """The file of a page.

    Raises
    ------
    InvalidValue
        There is no page of that name; the message says which are near.
    """
    titles = page_titles()
    word = name.removeprefix("docs/").removesuffix(".md")
    if word not in titles:
        guess = meant(word, list(titles))
        raise InvalidValue(
            "PAGE", name, f"must be one of {', '.join(titles)}" + (f"; {guess}" if guess else "")
        )
    return _folder() / f"{word}.md"

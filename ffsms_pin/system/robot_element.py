"""Reads the XML of a URDF, and refuses what would take its readers' stacks and time."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from ffsms_pin.errors import InvalidUrdf

__all__ = ["read_robot"]

DEEPEST = 100  # elements within each other; a URDF needs five
MOST_ELEMENTS = 20_000  # some thousand links


def read_robot(path: Path) -> ElementTree.Element:
    """The <robot> element of a file; comments are kept."""
    parser = ElementTree.XMLParser(target=_Builder(insert_comments=True))
    try:
        robot = ElementTree.fromstring(path.read_bytes(), parser)
    except OSError as error:
        raise InvalidUrdf(path, f"cannot be read ({error.strerror})") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InvalidUrdf(path, f"is not an XML file ({error})") from None
    if robot.tag != "robot":
        raise InvalidUrdf(path, f"is not a URDF: its root element is <{robot.tag}>, not <robot>")
    return robot


class _Builder(ElementTree.TreeBuilder):
    """Makes the elements, and refuses what no robot needs: it would take other readers' stacks and time."""

    depth = count = 0

    def start(self, tag: Any, attrs: Any, /) -> ElementTree.Element:
        """Open an element."""
        self.depth, self.count = self.depth + 1, self.count + 1
        if self.depth > DEEPEST:
            raise ValueError(f"elements within each other deeper than {DEEPEST}")
        if self.count > MOST_ELEMENTS:
            raise ValueError(f"more than {MOST_ELEMENTS} elements")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        """Close it."""
        self.depth -= 1
        return super().end(tag)

"""Numbers in a URDF: decimal, finite and of a sane size, or an error that says where."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TypeAlias
from xml.etree import ElementTree

from ffsms_pin.checks import LARGEST_POSITIVE
from ffsms_pin.errors import InvalidUrdf

__all__ = ["is_number", "number_of", "origin_of", "triple_of"]

Triple: TypeAlias = tuple[float, float, float]

# The C locale's decimal numbers, which is what URDF readers accept.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
# Above anything that is built, and small enough for products of it to stay finite. Limits may be larger: one
# beyond this is none.
_LARGEST = LARGEST_POSITIVE


def is_number(text: str) -> bool:
    """Whether `text` is a finite decimal number as every URDF reader takes it: no blanks, no formula."""
    return _NUMBER.fullmatch(text) is not None and math.isfinite(float(text))


def number_of(
    path: Path,
    element: ElementTree.Element,
    key: str,
    where: str,
    default: float | None = None,
    largest: float = _LARGEST,
) -> float:
    """The number that an element has as its attribute `key`; `where` names the link or joint for errors."""
    text = element.get(key)
    if text is None:
        if default is not None:
            return default
        raise InvalidUrdf(path, f"{where} has no {key} in <{element.tag}>")
    return _parse(path, text, key, where, largest)


def triple_of(path: Path, element: ElementTree.Element, key: str, where: str) -> Triple:
    """Three numbers of an attribute; zeros where it is not there."""
    words = element.get(key, "0 0 0").split()
    if len(words) != 3:
        raise InvalidUrdf(path, f'{where} has {key}="{element.get(key)}": three numbers are needed')
    x, y, z = (_parse(path, word, key, where, _LARGEST) for word in words)
    return x, y, z


def origin_of(path: Path, parent: ElementTree.Element, where: str) -> tuple[Triple, Triple]:
    """Xyz [m] and rpy [rad] of an element's <origin>; zeros where it has none."""
    origin = parent.find("origin")
    if origin is None:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return triple_of(path, origin, "xyz", where), triple_of(path, origin, "rpy", where)


def _parse(path: Path, text: str, key: str, where: str, largest: float) -> float:
    if not is_number(text):
        raise InvalidUrdf(path, f'{where} has {key}="{text}", which is not a finite decimal number')
    if abs(float(text)) > largest:
        raise InvalidUrdf(path, f'{where} has {key}="{text}", which is too large')
    return float(text)

"""What the quantities of an atlas are called, and their units."""

from __future__ import annotations

import re

__all__ = ["long_name", "unit"]

_NAMES_AND_UNITS = {
    "joints": ("joint position", "rad"),
    "end_effector": ("end effector from the base's centre of mass, base axes", "m"),
    "sigma": ("singular value of C_bm", "m/rad, rad/rad"),
    "entropy": ("entropy of the coupling", "1"),
    "manipulability": ("manipulability of J*", "volume of twists per rad"),
    "base_translation": ("base translation per end-effector metre", "m/m"),
    "base_rotation": ("base rotation per end-effector metre", "rad/m"),
    "assistance": ("coupling assistance", "1"),
    "count": ("samples in the cell", "1"),
}
_NUMBERED = re.compile(r"(sigma|assistance)_(\d+)")


def long_name(name: str) -> str:
    """A quantity in words; `sigma_1` is the first of several."""
    found = _NUMBERED.fullmatch(name)
    return f"{_NAMES_AND_UNITS[found[1]][0]} {found[2]}" if found else _NAMES_AND_UNITS[name][0]


def unit(name: str) -> str:
    """A quantity's unit."""
    found = _NUMBERED.fullmatch(name)
    return _NAMES_AND_UNITS[found[1] if found else name][1]

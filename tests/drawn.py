"""A run to draw, and what was drawn on a panel, for the tests of figures."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from ffsms_pin.checks import FloatArray
from ffsms_pin.scenarios import Outcome, run, scenario

__all__ = ["curves", "dotted", "flown", "points", "untidy"]

SCENARIO = """
robot.model = "planar_3r"
start.joints_deg = [23.0, 40.0, -29.0]
target.position = [0.75, 0.5, 0.0]
plan = {duration = 3.0, dt = 0.05}
control.dt = 0.01
"""


_FLOWN: dict[str, Outcome] = {}


def flown(folder: Path, more: str = "") -> Outcome:
    """Return a run of three seconds, made once a process; `more` are further lines of its scenario."""
    if more not in _FLOWN:
        path = folder / "quick.toml"
        path.write_text(SCENARIO + more)
        _FLOWN[more] = run(scenario(path))
    return _FLOWN[more]


def curves(ax: Axes) -> list[Line2D]:
    """The lines that follow the data, without limits and legend entries."""
    return [curve for curve in ax.get_lines() if len(points(curve)) > 2]


def points(curve: Line2D) -> FloatArray:
    """The points (k, 2) of a curve."""
    return np.asarray(curve.get_xydata(), dtype=np.float64)


def dotted(ax: Axes) -> list[float]:
    """Heights of the dotted lines, ascending."""
    lines = [points(curve) for curve in ax.get_lines() if curve.get_linestyle() == ":"]
    return sorted(float(curve[0, 1]) for curve in lines if len(curve) == 2)


def untidy(figure: Figure) -> list[str]:
    """What is wrong with the words of a figure: what is cut off, and pairs that overlap."""
    written: list[Text] = []

    def draw(text: Text, *arguments: Any, **named: Any) -> None:
        plain(text, *arguments, **named)
        if text.get_visible() and text.get_text().strip():
            written.append(text)

    plain = Text.draw
    with pytest.MonkeyPatch.context() as patched:
        canvas: Any = FigureCanvasAgg(figure)
        canvas.draw()  # lays the panels out
        patched.setattr(Text, "draw", draw)
        canvas.draw()
    boxes = {text: text.get_window_extent().padded(-1.0) for text in written}  # [pixels] of 100 an inch
    inside = figure.bbox
    cut = [
        text.get_text()
        for text, box in boxes.items()
        if min(box.x0 - inside.x0, box.y0 - inside.y0, inside.x1 - box.x1, inside.y1 - box.y1) < 0.0
    ]
    pairs = itertools.combinations(boxes.items(), 2)
    return cut + [f"{a.get_text()} / {b.get_text()}" for (a, one), (b, other) in pairs if one.overlaps(other)]

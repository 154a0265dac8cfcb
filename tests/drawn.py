"""Return a run to draw, and inspect what a figure shows, for tests."""

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

__all__ = ["curves", "dotted", "points", "quick_run", "text_faults"]

SCENARIO = """
robot.model = "planar_3r"
start.joints_deg = [23.0, 40.0, -29.0]
target.position = [0.75, 0.5, 0.0]
plan = {duration = 3.0, dt = 0.05}
control.dt = 0.01
"""


_FLOWN: dict[str, Outcome] = {}


def quick_run(folder: Path, more: str = "") -> Outcome:
    """Return a run of 3 s, computed once per process; `more` are further lines of its scenario."""
    if more not in _FLOWN:
        path = folder / "quick.toml"
        path.write_text(SCENARIO + more)
        _FLOWN[more] = run(scenario(path))
    return _FLOWN[more]


def curves(ax: Axes) -> list[Line2D]:
    """Return the curves of data, without lines of limits and legend entries."""
    return [curve for curve in ax.get_lines() if len(points(curve)) > 2]


def points(curve: Line2D) -> FloatArray:
    """Return the points (k, 2) of a curve."""
    return np.asarray(curve.get_xydata(), dtype=np.float64)


def dotted(ax: Axes) -> list[float]:
    """Return the heights of the dotted lines in ascending order."""
    lines = [points(curve) for curve in ax.get_lines() if curve.get_linestyle() == ":"]
    return sorted(float(curve[0, 1]) for curve in lines if len(curve) == 2)


def text_faults(figure: Figure) -> list[str]:
    """Return the texts of a figure that are cut off, and the pairs of texts that overlap."""
    written: list[Text] = []

    def draw(text: Text, *arguments: Any, **named: Any) -> None:
        plain(text, *arguments, **named)
        if text.get_visible() and text.get_text().strip():
            written.append(text)

    plain = Text.draw
    with pytest.MonkeyPatch.context() as patched:
        canvas: Any = FigureCanvasAgg(figure)
        canvas.draw()  # computes the layout
        patched.setattr(Text, "draw", draw)
        canvas.draw()
    boxes = {text: text.get_window_extent().padded(-1.0) for text in written}  # [pixels], 100 per inch
    inside = figure.bbox
    cut = [
        text.get_text()
        for text, box in boxes.items()
        if min(box.x0 - inside.x0, box.y0 - inside.y0, inside.x1 - box.x1, inside.y1 - box.y1) < 0.0
    ]
    pairs = itertools.combinations(boxes.items(), 2)
    return cut + [f"{a.get_text()} / {b.get_text()}" for (a, box), (b, other) in pairs if box.overlaps(other)]

"""A run to draw, and what was drawn on a panel, for the tests of figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from ffsms_pin.checks import FloatArray
from ffsms_pin.scenarios import Outcome, run, scenario

__all__ = ["curves", "dotted", "flown", "points"]

SCENARIO = """
robot.model = "planar_3r"
start.joints_deg = [23.0, 40.0, -29.0]
target.position = [0.75, 0.5, 0.0]
plan = {duration = 3.0, dt = 0.05}
control.dt = 0.01
"""


def flown(folder: Path, more: str = "") -> Outcome:
    """A run of three seconds; `more` are further lines of its scenario."""
    path = folder / "quick.toml"
    path.write_text(SCENARIO + more)
    return run(scenario(path))


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

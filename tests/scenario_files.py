"""Define and write scenario files that run in about a second, for tests."""

from __future__ import annotations

from pathlib import Path

__all__ = ["CAPTURE", "COARSE", "IN_DEGREES", "IN_RADIANS", "NEARER", "QUICK", "SECOND", "write"]

# Robot, start and target. The starts of IN_DEGREES and IN_RADIANS differ by a fraction of a degree.
IN_DEGREES = """
[robot]
model = "planar_3r"
[start]
joints_deg = [23.0, 40.0, -29.0]
[target]
position = [0.75, 0.5, 0.0]
"""
NEARER = IN_DEGREES.replace("[0.75, 0.5, 0.0]", "[0.7, 0.5, 0.0]")  # with a nearer target
IN_RADIANS = IN_DEGREES.replace("joints_deg = [23.0, 40.0, -29.0]", "joints = [0.4, 0.7, -0.5]")

QUICK = f"""{IN_DEGREES}\
[plan]
duration = 3.0
dt = 0.05
[control]
dt = 0.004
offset_deg = [0.5, 0.0, -0.5]
"""
COARSE = QUICK.replace("dt = 0.004\noffset_deg = [0.5, 0.0, -0.5]", "dt = 0.01").lstrip()

# A motion of 1 s without a target.
SECOND = """
[robot]
model = "planar_3r"
[start]
joints = [0.4, 0.7, -0.5]
[plan]
duration = 1.0
dt = 0.1
"""

# A client that is met and caught within ten seconds.
CAPTURE = """
[robot]
model = "satellite_panda"
[start]
joints = [0.0, -0.6, 0.0, -2.2, 0.0, 2.9, 0.8]
[client]
mass = 80.0
inertia = [6.0, 9.0, 11.0]
joints = [0.1, -0.4, 0.1, -2.0, 0.0, 3.1, 0.9]
spin_deg = [1.0, 2.0, -1.0]
size = [0.5, 0.6, 0.7]
[meet]
grasp = [0.0, 0.0, -0.4]
standoff = 0.05
[plan]
duration = 6.0
dt = 0.02
[control]
law = "computed-torque"
K_p = 100.0
K_d = 20.0
dt = 0.004
[contact]
after = 4.0
"""


def write(folder: Path, text: str, name: str = "mine.toml") -> Path:
    """Write a text to a file, and return its path."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path

"""Measure how the normalised entropy depends on the unit of length and on the base's reference point.

Run from the repository's root: python benchmarks/metrics.py. docs/coupling.md shows the tables.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import ffsms_pin as ffsms

UNITS = (1.0, 0.1, 0.001)  # m, dm and mm as characteristic lengths [m]


def reference_points(sms: ffsms.SpaceManipulator) -> list[tuple[str, NDArray[np.float64] | None]]:
    """Return points of the base in the root frame; None is the base's centre of mass, as in the paper."""
    assert sms.base_size is not None
    box, half = sms.base_box_placement, np.array(sms.base_size) / 2.0
    return [
        ("base's centre of mass", None),
        ("box: centre of the +x face, where the arm is mounted", box.act(half * [1.0, 0.0, 0.0])),
        ("box: centre of the -x face", box.act(half * [-1.0, 0.0, 0.0])),
        ("box: corner (+x, +y, +z)", box.act(half)),
    ]


def table(name: str, posture: str, joints: NDArray[np.float64], sms: ffsms.SpaceManipulator) -> str:
    """Return a Markdown table of the entropies of one robot at one posture."""
    state = sms.at(sms.configuration(joints))
    degrees = ", ".join(f"{x:.1f}" for x in np.round(np.degrees(joints), 1) + 0.0)  # + 0.0: no "-0.0"
    lines = [
        f"`{name}` {posture} ({degrees}) deg:",
        "",
        "| reference point | m | dm | mm | translation only | rotation only |",
        "|---|---|---|---|---|---|",
    ]
    for label, point in reference_points(sms):
        values = [state.coupling_at(length, point).entropy for length in UNITS]
        values += [state.coupling_at(1.0, point, rows).entropy for rows in ("translation", "rotation")]
        lines.append(f"| {label} | " + " | ".join(f"{value:.3f}" for value in values) + " |")
    return "\n".join(lines)


def tables() -> str:
    """Return both tables of docs/coupling.md."""
    planar, panda = ffsms.load("planar_3r"), ffsms.load("satellite_panda")
    middle = 0.5 * (panda.limits.lower + panda.limits.upper)
    return "\n\n".join(
        [
            table("planar_3r", "at the paper's start", np.radians([1.0, 1.0, 1.0]), planar),
            table("satellite_panda", "with every joint in the middle of its range", middle, panda),
        ]
    )


if __name__ == "__main__":
    print(tables())

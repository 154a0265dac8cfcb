"""What the one-file page's legend and read-out show."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.viewer.colours import ASSISTANCE_STOPS, USAGE_STOPS
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.layers import LAYERS

__all__ = ["facts"]


def facts(
    frames: Frames, shown: dict[str, bool], speed: float, play: bool, seen: dict[str, Any]
) -> dict[str, Any]:
    """The facts that `page.html` reads: `shown` says which layers are visible at first, `seen` from where."""
    readings: list[dict[str, Any]] = [
        {"label": "entropy", "unit": "", "digits": 3, "values": _short(frames.entropy)}
    ]
    scales = [{"label": "use of a limit", "stops": list(USAGE_STOPS), "ends": ["0", "all of it"]}]
    if frames.target is not None:
        distance = 1e3 * np.linalg.norm(frames.target - frames.tips, axis=1)
        readings += [
            {"label": "cos θₐ", "unit": "", "digits": 3, "values": _short(frames.assistance)},
            {"label": "to target", "unit": " mm", "digits": 1, "values": _short(distance)},
        ]
        ends = ["−1 away", "0 across", "1 at it"]
        scales.insert(0, {"label": "assistance cos θₐ", "stops": list(ASSISTANCE_STOPS), "ends": ends})
    layers = [
        {"name": name, "shown": on, "label": LAYERS[name].label, "colour": LAYERS[name].colour}
        | {"nodes": list(LAYERS[name].nodes)}
        for name, on in shown.items()
    ]
    return {
        "t": _short(frames.t - frames.t[0]),
        "speed": speed,
        "play": play,
        **seen,
        "layers": layers,
        "scales": scales,
        "readings": readings,
    }


def _short(values: FloatArray) -> list[float]:
    """Numbers as they are read, not as they are computed."""
    return [round(float(value), 4) for value in values]

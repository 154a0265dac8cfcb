"""Colours of the scene: few, apart for colour-blind eyes, and the same as in the figures."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = [
    "ASSISTANCE_STOPS",
    "BACKGROUND",
    "COLOURS",
    "USAGE_STOPS",
    "as_number",
    "assistance_colour",
    "rgb",
    "usage_colour",
]

# Top and bottom of the background.
BACKGROUND = ([1.0, 1.0, 1.0], [0.86, 0.90, 0.94])

COLOURS = {
    "target": "#D55E00",
    "tracked": "#222222",
    "base_linear": "#CC79A7",
    "base_turn": "#AA4499",
    "principal": "#009E73",
    "direction": "#111111",
    "start": "#E69F00",
    "end": "#56B4E9",
    "trail": "#777777",
    "obstacle": "#A03030",
    "client": "#C9A227",
    "wheel": "#5B6C7D",
    "thruster": "#3A3A3A",
}

# cos(theta_a) from -1 (straight away) over 0 (across) to 1 (straight at the target).
ASSISTANCE_STOPS = ("#8C3A00", "#B5B0A8", "#0072B2")
# How much of a limit, or of a clearance, is used up: 0 to 1.
USAGE_STOPS = ("#56B4E9", "#F0E442", "#D55E00")


def rgb(colour: str) -> FloatArray:
    """Red, green and blue (3,), 0 to 1, of "#RRGGBB"."""
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0


def as_number(colour: str) -> int:
    """The colour as Meshcat's materials take it."""
    return int(colour[1:], 16)


def assistance_colour(cosine: float) -> FloatArray:
    """Colour (3,) of coupling assistance in [-1, 1]."""
    return _between(ASSISTANCE_STOPS, 0.5 + 0.5 * cosine)


def usage_colour(share: float) -> FloatArray:
    """Colour (3,) of a share in [0, 1] of a limit."""
    return _between(USAGE_STOPS, share)


def _between(stops: tuple[str, ...], place: float) -> FloatArray:
    at = np.linspace(0.0, 1.0, len(stops))
    table = np.array([rgb(stop) for stop in stops])
    return np.array([np.interp(place, at, table[:, i]) for i in range(3)])

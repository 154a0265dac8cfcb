"""The texts of quantities in notes, reasons and tables."""

from __future__ import annotations


def length_text(metres: float) -> str:
    """Return a length with its unit: millimetres below 1 m, metres from there on."""
    return f"{1e3 * metres:.3g} mm" if abs(metres) < 1.0 else f"{metres:.4g} m"

"""Inertias of files that no rigid body has: refused, kept as published, or set to the nearest of a body."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidInertia
from ffsms_pin.system import urdf_elements as urdf

Inertias = Literal["check", "keep", "repair"]


def refusal(tensor: FloatArray, any_tensor: bool = False) -> str:
    """Return why an inertia (3, 3) [kg m^2] is refused, as a clause with the remedy; empty if it is not.

    With `any_tensor` it may break the triangle inequality.
    """
    a, b, c = (float(x) for x in np.linalg.eigvalsh(tensor))
    problem = urdf.inertia_problem(tensor)
    if problem == "negative":
        return f'has a negative principal inertia, {a:.6g} kg m^2; load it with inertias="repair"'
    if problem == "triangle" and not any_tensor:
        # A body that turns needs inertia about every axis, so zero cannot be kept.
        ways = 'inertias="keep" or inertias="repair"' if a > urdf.ROUNDING * c else 'inertias="repair"'
        message = f"principal inertias {a:.6g} + {b:.6g} < {c:.6g} kg m^2; load it with {ways}"
        return f"breaks the triangle inequality: {message}"
    return ""


def settle(model: str | Path, body: str, tensor: FloatArray, inertias: Inertias) -> tuple[FloatArray, str]:
    """Return the inertia (3, 3) [kg m^2] that counts for a body, and what changed, empty for nothing.

    Raises
    ------
    InvalidInertia
        It is refused; `model` names the file or the robot in the message.
    """
    problem = urdf.inertia_problem(tensor)
    if problem and inertias == "repair":
        nearest = positive(tensor)
        return nearest, f"from ({urdf.principal_text(tensor)}) to ({urdf.principal_text(nearest)})"
    if reason := refusal(tensor, any_tensor=inertias == "keep"):
        raise InvalidInertia(model, body, reason)
    return tensor, f"({urdf.principal_text(tensor)})" if problem else ""


def settled(changes: Mapping[str, str], inertias: Inertias) -> str:
    """Return the sentence on the changes by `settle`, by the names of the bodies."""
    message = "principal inertias [kg m^2] set to the nearest of a rigid body:"
    if inertias == "keep":
        message = (
            "inertias that break the triangle inequality are kept as published, though no rigid body has"
        )
        message += " them (principal ones [kg m^2]):"
    listed = ", ".join(f"'{name}' {change}" for name, change in changes.items())
    return f"{message} {listed}"


def positive(tensor: FloatArray) -> FloatArray:
    """Return the nearest inertia of a rigid body that is positive definite: not that of a thin rod."""
    nearest = urdf.nearest_inertia(tensor, 0.0)
    principal = np.linalg.eigvalsh(nearest)
    if principal[0] > 1e-9 * principal[2]:
        return nearest
    return urdf.nearest_inertia(tensor, urdf.ROUNDING * float(np.abs(np.linalg.eigvalsh(tensor)).max()))

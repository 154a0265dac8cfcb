"""Functions that refuse, keep or repair inertias that no rigid body has."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidInertia
from ffsms_pin.system import urdf_elements as urdf

Inertias = Literal["check", "keep", "repair"]


def settle(model: str | Path, body: str, tensor: FloatArray, inertias: Inertias) -> tuple[FloatArray, str]:
    """Return the inertia (3, 3) [kg m^2] to use for a body, and a text for `settled`, "" for a valid inertia.

    For error messages, `model` is the name of the robot or its file, and `body` is the name of the body.

    Raises
    ------
    InvalidInertia
        The inertia has a fault that `inertias` does not allow.
    """
    problem = urdf.inertia_problem(tensor)
    if problem and inertias == "repair":
        nearest = positive(tensor)
        return nearest, f"from ({urdf.principal_text(tensor)}) to ({urdf.principal_text(nearest)})"
    if reason := urdf.refusal(tensor, any_tensor=inertias == "keep"):
        raise InvalidInertia(model, body, reason)
    return tensor, f"({urdf.principal_text(tensor)})" if problem else ""


def settled(changes: Mapping[str, str], inertias: Inertias) -> str:
    """Return a sentence for a warning; `changes` maps the names of bodies to the texts of `settle`."""
    message = "principal inertias [kg m^2] set to the nearest that a rigid body can have:"
    if inertias == "keep":
        message = "inertias that break the triangle inequality, which no rigid body has, are kept as"
        message += " published (principal inertias [kg m^2]):"
    listed = ", ".join(f"'{name}' {change}" for name, change in changes.items())
    return f"{message} {listed}"


def positive(tensor: FloatArray) -> FloatArray:
    """Return the inertia (3, 3) [kg m^2] of a rigid body that is nearest to `tensor` and positive definite.

    If the result of `nearest_inertia` has a zero principal inertia, such as that of a thin rod, the principal
    second moments are raised to a small positive minimum.
    """
    nearest = urdf.nearest_inertia(tensor, 0.0)
    principal = np.linalg.eigvalsh(nearest)
    if principal[0] > 1e-9 * principal[2]:
        return nearest
    return urdf.nearest_inertia(tensor, urdf.ROUNDING * float(np.abs(np.linalg.eigvalsh(tensor)).max()))

"""What every moving body of a model must have."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.errors import InvalidInertia
from ffsms_pin.system.joints import JointLayout

__all__ = ["check_bodies"]


def check_bodies(model: Any, layout: JointLayout) -> None:
    """Raise `InvalidInertia` where a body's inertia is not positive definite: H could not be inverted."""
    for j in range(1, model.njoints):
        body = model.inertias[j]
        finite = np.isfinite(body.mass) and np.isfinite(body.lever).all() and np.isfinite(body.inertia).all()
        if not finite or body.mass <= 0.0 or np.linalg.eigvalsh(body.inertia)[0] <= 0.0:
            raise InvalidInertia(
                model.name,
                layout.body_name(model, j),
                f"moves but its inertia is not positive definite (mass {body.mass:g} kg)",
            )

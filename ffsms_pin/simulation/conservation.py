"""Whether a simulated plant kept its total momentum, which nothing from outside changed."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator

__all__ = ["momentum_lost"]

TOLERANCE = 1e-4  # share of what moves within the plant
ROUNDING = 1e-12  # [kg m/s; kg m^2/s] of a plant that hardly moves


def momentum_lost(
    plant: SpaceManipulator, q: FloatArray, before: FloatArray, after: FloatArray, energy: float
) -> str:
    """What to say of a change of total momentum, in words; empty where it was kept.

    The change is compared with what a body of the plant's mass m and largest inertia I has at the largest
    kinetic energy E of the run: sqrt(2 m E) and sqrt(2 I E). No part of the plant has more.
    The inertia is taken at q (nq,); `before` and `after` (6,) are momenta [linear; angular] [kg m/s;
    kg m^2/s] about the centre of mass, inertial axes, and `energy` the largest in between [J].
    """
    data = plant.model.createData()
    pin.ccrba(plant.model, data, q, np.zeros(plant.nv))
    whole = data.Ig  # about the centre of mass
    sizes = (
        math.sqrt(2.0 * whole.mass * energy),
        math.sqrt(2.0 * np.linalg.eigvalsh(whole.inertia)[-1] * energy),
    )
    changes = np.linalg.norm(after[:3] - before[:3]), np.linalg.norm(after[3:] - before[3:])
    kinds = ("linear", "kg m/s"), ("angular", "kg m^2/s")
    lost = [
        f"{kind} by {change:.3g} {unit}"
        for (kind, unit), change, size in zip(kinds, changes, sizes, strict=True)
        if not change <= TOLERANCE * size + ROUNDING
    ]
    if not lost:
        return ""
    return (
        f"the total momentum changed though nothing acts from outside ({', '.join(lost)}): "
        "use a smaller dt, or the stiff integrator where friction is steep"
    )

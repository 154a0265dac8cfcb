"""The paper's cost as a residual of the whole horizon, with its slopes.

The paper's residual C~ - (1 - H_norm) does not see speed, and jumps where the end effector stands still or
has arrived. To be fit for Gauss-Newton it is multiplied by two factors that fall to zero below a small speed
and near the target; the search takes them back as it goes on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.stacks import dot

__all__ = ["CostResidual", "cost_residual"]

_TINY_WAY = 1e-10  # [m^2] keeps the direction to the target defined
_TINY_SPEED = 1e-12  # [(m/s)^2] and that of motion


class CostResidual(NamedTuple):
    """The residual at stacked points (...,).

    Attributes
    ----------
    value : ndarray, shape (...,)
    exact : ndarray, shape (...,)
        The paper's residual, whatever `value` is.
    by_velocity, by_tip : ndarray, shape (3, ...)
        Slopes by the end effector's velocity and position.
    by_entropy : ndarray, shape (...,)
    """

    value: FloatArray
    exact: FloatArray
    by_velocity: FloatArray
    by_tip: FloatArray
    by_entropy: FloatArray


def cost_residual(
    way: FloatArray,
    velocity: FloatArray,
    entropy: FloatArray,
    kappa: float,
    pace: float,
    slow: float,
    close: float,
) -> CostResidual:
    """Residual of the paper's cost at points of motions.

    Parameters
    ----------
    way, velocity : ndarray, shape (3, ...)
        From the end effector to the target [m]; velocity of the end effector [m/s]. In the same axes, any.
    entropy : ndarray, shape (...,)
    kappa : float
    pace : float
        Scale of speeds [m/s].
    slow : float
        The residual fades below this share of the pace; 0: not at all.
    close : float
        And nearer than this to the target [m].
    """
    length = np.sqrt(dot(way, way) + _TINY_WAY)
    speed = np.sqrt(dot(velocity, velocity) + _TINY_SPEED)
    d, e = way / length, velocity / speed
    cosine = dot(d, e)
    exact = np.logaddexp(0.0, kappa * cosine) / kappa - (1.0 - entropy)

    # The velocity's parts along d and across it; `side` is the unit vector across.
    along = dot(d, velocity)
    rest = velocity - along * d
    across = np.sqrt(dot(rest, rest) + 1e-14)
    side = rest / across

    fade = speed / np.hypot(speed, slow * pace)
    value = exact * fade
    by_angle = -fade / (1.0 + np.exp(-kappa * cosine)) * across / speed
    by_speed = value * (1.0 - fade * fade)
    near = length / np.hypot(length, close)
    value, by_entropy = near * value, near * fade
    by_angle, by_speed = near * by_angle, near * by_speed

    # Turning the velocity away from d by an angle, and stretching it.
    away = (side * along - d * across) / speed
    by_velocity = (by_angle * away + by_speed * e) / speed
    by_tip = (by_angle * side - value * (1.0 - near * near) * d) / length
    return CostResidual(value, exact, by_velocity, by_tip, by_entropy)

"""Gauss-Newton sums of whole motions: gradient and Hessian by the control points, by the compiled kernel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Indices, JointResidual, Residual

__all__ = ["Weighted", "sums"]


class Weighted(NamedTuple):
    """A residual, and the weight of the square of each of its values.

    Attributes
    ----------
    residual : Residual or JointResidual
    weight : ndarray, shape (K,), or (V,) of a residual with entries
    """

    residual: Residual | JointResidual
    weight: FloatArray

    @classmethod
    def of(cls, residual: Residual | JointResidual, factor: float, over_time: FloatArray) -> Weighted:
        """A weight that is the same for all values, times the quadrature's where the square is integrated."""
        if isinstance(residual, JointResidual):
            return cls(residual, factor * over_time)
        if residual.over_time:
            return cls(residual, factor * over_time[residual.instants])
        return cls(residual, np.full(residual.value.shape[-1], factor))


def sums(
    spline: RateSpline, motions: Motions, chosen: Indices, residuals: list[Weighted]
) -> tuple[FloatArray, FloatArray]:
    """Gradient (T, Mn) and Hessian (T, Mn, Mn) of half the weighted sum of squares of T chosen motions.

    The control points come first, the joints last. A base that floats reacts to the joints; that its own
    momentum turns it otherwise is left out (see `motions_of`).
    """
    every, entropy = np.arange(len(motions.times)), None
    single, rest = [], []
    for residual, weight in residuals:
        if isinstance(residual, JointResidual):
            slopes = (residual.by_position, residual.by_rate, residual.by_acceleration)
            single.append((weight, residual.value, *slopes))
        elif residual.value.size:
            where = every[residual.instants]
            rest.append((where, residual.motion, weight, residual.value, residual.slopes()))
            if residual.by_entropy is not None:
                entropy = motions.entropy_slope
    maps = (spline.rates.free, spline.travel.free, spline.accelerations.free)
    given = (motions.joints, motions.rates, motions.base_attitude, motions.own_spin, entropy)
    return kernel.sums(motions.stack.tree, maps, spline.quadrature, given, rest, single, chosen)

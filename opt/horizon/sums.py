"""Gauss-Newton sums of whole motions: gradient and Hessian by the control points, by the compiled kernel."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import _kernel
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Indices, JointResidual, Residual
from ffsms_pin.opt.batch.slopes import coupling_slopes, spin_slopes, velocity_slopes
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.system.batch.arm import ArmValues

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
    stack, arm, size = motions.stack, motions.arm, spline.size * motions.stack.n
    single, rest, names = [], [], set[str]()
    every = np.arange(len(motions.times))
    for residual, weight in residuals:
        if isinstance(residual, JointResidual):
            slopes = (residual.by_position, residual.by_rate, residual.by_acceleration)
            single.append((weight, residual.value, *slopes))
        elif residual.value.size:
            where, by = every[residual.instants], residual.slopes()
            if "by_coupling" in by:
                by["by_joints"] = _joints_by_coupling(motions, residual, by.pop("by_coupling"))
            names.update(by)
            rest.append((where, residual.motion, weight, residual.value, by))
    spin_q, jstar_q = velocity_slopes(stack, arm, motions.rates)
    tip_spin_q = spin_slopes(stack, arm, motions.rates, spin_q) if "by_spin" in names else None
    entropy_q = coupling_slopes(stack, arm, motions.entropy_slope) if "by_entropy" in names else None
    gradient, hessian = np.zeros((len(chosen), size)), np.zeros((len(chosen), size, size))
    maps = (spline.rates.free, spline.travel.free, spline.accelerations.free)
    quadrature = (spline.integral_to_points, spline.integral_over, spline.late_interval)
    given = (motions.own_spin, arm.com, arm.tip, motions.rates, motions.base_attitude)
    columns = (arm.spin, arm.jstar, arm.axes, arm.linear, spin_q, jstar_q, tip_spin_q, entropy_q)
    robot = (stack.mass, stack.base_com, stack.moves_tip)
    _kernel.sums((*maps, *quadrature), (*robot, *given, *columns), rest, single, chosen, gradient, hessian)
    return gradient, hessian


def _joints_by_coupling(motions: Motions, residual: Residual, by_coupling: FloatArray) -> FloatArray:
    """Slopes by the joint positions: those that there are, and through C_bm."""
    where: Any = residual.instants
    if residual.motion is not None:
        where = (residual.motion, residual.instants)
    picked = ArmValues(
        *(x[(..., *where)] if isinstance(where, tuple) else x[..., where] for x in motions.arm.arrays())
    )
    slopes = coupling_slopes(motions.stack, picked, by_coupling)
    return slopes if residual.by_joints is None else residual.by_joints + slopes

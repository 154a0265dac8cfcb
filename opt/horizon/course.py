"""Where motions go: joints, base and end effector along the quadrature points of several motions at once.

The base's attitude follows from the joints by the momentum equation: dR/dt = R [omega]x, with omega the sum
of spin @ u and of what the total momentum adds, where there is one. Vectors of a point are in the base's axes
there; only sums along a motion need common ones.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.arm import ArmValues
from ffsms_pin.opt.batch.entropy import entropy_and_gradient
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.batch.stacks import apply, cross, exp3, products
from ffsms_pin.opt.horizon.task import Task

__all__ = ["Course", "apply_rates", "base_turns", "course"]

# Picard's iteration for the attitude of a tumbling base: at most so many times, until it changes by less.
_PICARD, _SETTLED = 20, 1e-10


@dataclass(frozen=True, eq=False)
class Course:
    """S motions at the spline's Q quadrature points, then at 0.9 T and T.

    Attributes
    ----------
    joints, rates : ndarray, shape (n, S, Q + 2)
        Joint positions and rates.
    arm : ArmValues
    R : ndarray, shape (3, 3, S, Q + 2)
        Base attitude, from the start's.
    omega : ndarray, shape (3, S, Q + 2)
        Its angular velocity, base axes.
    way, velocity, relative : ndarray, shape (3, S, Q + 2)
        From the end effector to the target; its velocity, and that relative to the system's centre of mass;
        base axes.
    entropy, by_coupling : ndarray, shape (S, Q + 2), (6, n, S, Q + 2)
        H_norm, and its slopes by `ArmValues.coupling`.
    """

    joints: FloatArray
    rates: FloatArray
    arm: ArmValues
    R: FloatArray
    omega: FloatArray
    way: FloatArray
    velocity: FloatArray
    relative: FloatArray
    entropy: FloatArray
    by_coupling: FloatArray

    def take(self, index: Any) -> Course:
        """The motions at an index."""
        names = [field.name for field in fields(self) if field.name != "arm"]
        taken = {name: getattr(self, name)[..., index, :] for name in names}
        return Course(arm=self.arm.take(index), **taken)


def course(task: Task, spline: RateSpline, p: FloatArray) -> Course:
    """Where motions with control points p (S, M, n) go."""
    by_joint = p.transpose(2, 0, 1)
    joints = task.joints0[:, None, None] + by_joint @ spline.travel.T
    rates = by_joint @ spline.rates.T
    arm = task.arm.evaluate(joints)
    omega, relative = apply_rates(arm.spin, rates), apply_rates(arm.jstar, rates)
    R, velocity, goal = base_turns(spline, omega), relative, task.goal[:, None]
    if task.momentum is not None:
        R, own = _drifting_turns(spline, omega, arm.inverse, task.spin)
        omega, relative = omega + own, relative + cross(own, arm.rho)
        velocity = relative + np.einsum("yx...,y->x...", R, task.drift)
        goal = goal - spline.times * task.drift[:, None]
    way = np.einsum("yxsq,yq->xsq", R, np.broadcast_to(goal, (3, len(spline.times)))) - arm.rho
    entropy, by_coupling = entropy_and_gradient(arm.coupling)
    return Course(joints, rates, arm, R, omega, way, velocity, relative, entropy, by_coupling)


def apply_rates(columns: FloatArray, rates: FloatArray) -> FloatArray:
    """Columns (3, n, ...) times joint rates (n, ...)."""
    return np.asarray(np.einsum("xj...,j...->x...", columns, rates))


def base_turns(spline: RateSpline, omega: FloatArray) -> FloatArray:
    """Base rotations (3, 3, S, Q + 2) from the start, of angular velocities (3, S, Q + 2) in base axes."""
    m, g = spline.whole.shape
    omega = omega[..., : spline.points].reshape(3, -1, m, g)
    turned = np.empty((*omega.shape[:-1], g + 1))
    np.einsum("kij,xskj->xski", spline.part, omega, out=turned[..., :g])
    np.einsum("kj,xskj->xsk", spline.whole, omega, out=turned[..., g])
    turns = exp3(turned)
    whole = products(turns[..., g])
    starts = np.empty_like(whole)
    starts[..., 0], starts[..., 1:] = np.eye(3)[:, :, None], whole[..., :-1]
    points = apply(starts[..., None], turns[..., :g])
    return np.concatenate([points.reshape(3, 3, -1, m * g), whole[..., [spline.late - 1, -1]]], axis=-1)


def _drifting_turns(
    spline: RateSpline, reaction: FloatArray, inverse: FloatArray, spin: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The same with angular momentum `spin` (3,), and the angular velocity that this adds.

    What it adds depends on the attitude: Picard's iteration. How it changes with the control points is left
    out of the Jacobian; the values are exact, so a motion that arrives does arrive.
    """
    R = base_turns(spline, reaction)
    for _ in range(_PICARD):
        own = apply(inverse, np.einsum("yx...,y->x...", R, spin))
        last, R = R, base_turns(spline, reaction + own)
        if np.abs(R - last).max() < _SETTLED:
            break
    return R, own

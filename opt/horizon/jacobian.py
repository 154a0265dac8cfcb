"""From slopes by what moves at an instant to slopes by the control points of the whole motion.

The base's attitude follows from the joints by the momentum equation. Its change under a change of p, as a
rotation of everything about the centre of mass, is the integral of the change of its angular velocity: so
the same quadrature that gives the attitude gives its derivative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.base_limits import BaseLimits
from ffsms_pin.opt.batch.slopes import coupling_slopes, velocity_slopes
from ffsms_pin.opt.horizon.base_residual import BaseShares, base_shares
from ffsms_pin.opt.horizon.course import Course
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.batch.stacks import apply, cross, dot
from ffsms_pin.opt.horizon.task import Task

__all__ = ["Jacobian", "Residual"]

# Of the quadrature's points: Q of them, then 0.9 T and T.
Points: TypeAlias = NDArray[np.signedinteger[Any]] | slice


@dataclass(frozen=True)
class Residual:
    """Values at K points of S motions, weighted, and their slopes by what moves there.

    Attributes
    ----------
    value : ndarray, shape (S, K)
    points : ndarray, shape (K,), or slice
    by_velocity, by_tip : ndarray, shape (3, S, K), optional
        By the end effector's velocity and position; base axes.
    by_turn : ndarray, shape (3, S, K), optional
        By a turn of the end effector; axes of the base at the start.
    by_entropy : ndarray, shape (S, K), optional
    """

    value: FloatArray
    points: Points
    by_velocity: FloatArray | None = None
    by_tip: FloatArray | None = None
    by_turn: FloatArray | None = None
    by_entropy: FloatArray | None = None

    def take(self, index: Any) -> Residual:
        """The motions at an index."""
        slopes = (self.by_velocity, self.by_tip, self.by_turn, self.by_entropy)
        taken = (None if x is None else x[..., index, :] for x in slopes)
        return Residual(self.value[index], self.points, *taken)


class Jacobian:
    """The Jacobian of motions, one residual after the other: transposed, and joints first."""

    def __init__(self, task: Task, spline: RateSpline, at: Course) -> None:
        self._at, self._spline, self._stack = at, spline, task.arm
        self._rates, self._travel = spline.rates.T, spline.travel.T
        self._spin_q, self._jstar_q = velocity_slopes(task.arm, at.arm, at.rates)
        self._entropy_q = coupling_slopes(task.arm, at.arm, at.by_coupling)
        # How the base's angular velocity changes with p, in the axes of its start: its integral is the turn
        # of everything about the centre of mass, (S, 3, n, M, Q + 2).
        count = spline.points
        by_rates, by_travel = (
            apply(at.R[..., :count], x[..., :count]).transpose(2, 0, 1, 3)[:, :, :, None]
            for x in (at.arm.spin, self._spin_q)
        )
        change = by_rates * self._rates[:, :count]
        change += by_travel * self._travel[:, :count]
        turned = change.reshape(-1, count) @ spline.sweep.T
        self._turned: FloatArray = turned.reshape(*change.shape[:-1], len(spline.sweep))

    def rows(self, residual: Residual) -> FloatArray:
        """Rows of a residual, (S, n M, K)."""
        at, points, by_tip, by_velocity = self._at, residual.points, residual.by_tip, residual.by_velocity
        jstar, R = at.arm.jstar[..., points], at.R[..., points]
        by_travel, by_rates = np.zeros(jstar.shape[1:]), None
        turn = np.zeros((3, *jstar.shape[2:]))
        if by_tip is not None:
            moment = cross(at.arm.rho[..., points], by_tip)
            by_travel += dot(jstar, by_tip[:, None]) - dot(at.arm.spin[..., points], moment[:, None])
            turn += moment
        if by_velocity is not None:
            by_rates = dot(jstar, by_velocity[:, None])
            by_travel += dot(self._jstar_q[..., points], by_velocity[:, None])
            turn += cross(at.relative[..., points], by_velocity)
        turn = apply(R, turn)
        if residual.by_entropy is not None:
            by_travel += residual.by_entropy * self._entropy_q[..., points]
        if residual.by_turn is not None:
            here = apply(np.swapaxes(R, 0, 1), residual.by_turn)
            moves = self._stack.moves_tip[:, None, None]
            by_travel += moves * dot(at.arm.axes[..., points], here[:, None])
            turn += residual.by_turn
        rows = np.einsum("sxjmk,xsk->sjmk", self._turned[..., points], turn)
        rows += by_travel.swapaxes(0, 1)[:, :, None] * self._travel[:, points]
        if by_rates is not None:
            rows += by_rates.swapaxes(0, 1)[:, :, None] * self._rates[:, points]
        return np.asarray(rows.reshape(len(rows), -1, rows.shape[-1]))

    def base_shares(self, task: Task, limits: BaseLimits) -> BaseShares:
        """What base limits are exceeded by, for every motion; stack first, control points before joints."""
        at, arm, spline = self._at, self._at.arm, self._spline
        count, turn = spline.points, self._turned.transpose(0, 4, 1, 3, 2)
        base = self._stack.base_com[:, None, None] - arm.com
        return base_shares(
            limits,
            spline,
            at.R.transpose(2, 3, 0, 1),
            turn.reshape(*turn.shape[:3], -1),
            at.omega[..., :count].transpose(1, 2, 0),
            arm.spin[..., :count].transpose(2, 3, 0, 1),
            self._spin_q[..., :count].transpose(2, 3, 0, 1),
            base.transpose(1, 2, 0),
            arm.linear.transpose(2, 3, 0, 1) / -self._stack.mass,
            spline.times[:, None] * task.drift - task.base0,
        )

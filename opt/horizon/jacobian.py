"""Slopes of residuals by the control points of whole motions.

A base that floats follows the joints by the momentum equation. Its change under a change of p, as a rotation
of everything about the centre of mass, is the integral of the change of its angular velocity: so the same
quadrature that gives the attitude gives its derivative.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Indices, Residual
from ffsms_pin.opt.batch.slopes import coupling_slopes, spin_slopes, velocity_slopes
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.system.batch.arm import ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot

__all__ = ["Jacobian"]


class Jacobian:
    """Turns the slopes of residuals into rows by the control points, joints first: (n M, ...).

    Parameters
    ----------
    spline : RateSpline
    motions : Motions
    chosen : ndarray of int
        The motions that rows are wanted for; residuals are those of these, numbered anew.
    """

    def __init__(self, spline: RateSpline, motions: Motions, chosen: Indices) -> None:
        self._spline, self._whole, self._chosen = spline, motions, chosen
        self._motions = at = motions if len(chosen) == motions.count else motions.take(chosen)
        self._stack, self._rates, self._travel = at.stack, spline.rates.free.T, spline.travel.free.T
        spin_q, self._jstar_q = velocity_slopes(at.stack, at.arm, at.rates)
        self._spin_q = spin_q
        # How the base's angular velocity changes with p, inertial axes: its integral is the turn of
        # everything about the centre of mass, (S, 3, n, M, Q + 2).
        count = spline.points
        by_rates, by_travel = (
            apply(at.base_attitude[..., :count], x[..., :count]).transpose(2, 0, 1, 3)[:, :, :, None]
            for x in (at.arm.spin, spin_q)
        )
        shape = (at.count, 3, at.stack.n, spline.size, len(spline.sweep))
        self._turned: FloatArray = np.empty(shape)
        for axis in range(3):  # one by one: large temporary arrays take longer than their arithmetic
            change = by_rates[:, axis] * self._rates[:, :count]
            change += by_travel[:, axis] * self._travel[:, :count]
            np.matmul(change, spline.sweep.T, out=self._turned[:, axis])

    @cached_property
    def _entropy_q(self) -> FloatArray:
        slope = self._whole.entropy_slope
        if len(self._chosen) < self._whole.count:
            slope = slope[..., self._chosen, :]
        return coupling_slopes(self._stack, self._motions.arm, slope)

    @cached_property
    def _tip_spin_q(self) -> FloatArray:
        return spin_slopes(self._stack, self._motions.arm, self._motions.rates, self._spin_q)

    def rows(self, residual: Residual) -> FloatArray:
        """Rows of a residual: (S, n M, K) of a dense one, (n M, V) of one with entries."""
        where: Any = residual.instants
        if residual.motion is not None:
            where = (residual.motion, residual.instants)
        travel, rates, turn = self._own_slopes(residual, where)
        instants = residual.instants
        if residual.motion is None:
            rows = np.zeros((*travel.swapaxes(0, 1).shape[:2], self._spline.size, travel.shape[-1]))
            if turn is not None:
                rows = np.einsum("sxjmk,xsk->sjmk", self._turned[..., instants], turn)
            rows += travel.swapaxes(0, 1)[:, :, None] * self._travel[:, instants]
            if rates is not None:
                rows += rates.swapaxes(0, 1)[:, :, None] * self._rates[:, instants]
            return np.asarray(rows.reshape(len(rows), -1, rows.shape[-1]))
        made = travel[:, None] * self._travel[:, instants]
        if rates is not None:
            made += rates[:, None] * self._rates[:, instants]
        if residual.by_accelerations is not None:
            made += residual.by_accelerations[:, None] * self._spline.accelerations.free.T[:, instants]
        if turn is not None:
            # Entry by entry: the index arrays come first in numpy's order, (V, 3, n, M).
            made += np.einsum("vxjm,xv->jmv", self._turned[residual.motion, :, :, :, instants], turn)
        return np.asarray(made.reshape(len(made) * made.shape[1], -1))

    def _own_slopes(self, r: Residual, where: Any) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
        """Slopes by the joint positions and rates where the base stays, and by a turn of everything."""
        at, arm, stack = self._motions, self._motions.arm, self._stack

        def pick(values: FloatArray) -> FloatArray:
            return values[(..., *where)] if isinstance(where, tuple) else values[..., where]

        R = pick(at.base_attitude)

        def inward(slope: FloatArray) -> FloatArray:
            """Into base axes."""
            return np.asarray(np.einsum("yx...,y...->x...", R, slope))

        shape = r.value.shape
        travel = np.zeros((stack.n, *shape)) if r.by_joints is None else r.by_joints.copy()
        rates = None if r.by_rates is None else r.by_rates.copy()
        turn: FloatArray | None = None

        def turned(moment: FloatArray) -> None:
            nonlocal turn
            turn = moment if turn is None else turn + moment

        def by_rate(slope: FloatArray) -> None:
            nonlocal rates
            rates = slope if rates is None else rates + slope

        if r.by_tip is not None:
            g, rho = inward(r.by_tip), pick(arm.rho)
            travel += dot(pick(arm.jstar), g[:, None]) - dot(pick(arm.spin), cross(rho, g)[:, None])
            turned(apply(R, cross(rho, g)))
        if r.by_velocity is not None:
            g = inward(r.by_velocity)
            by_rate(dot(pick(arm.jstar), g[:, None]))
            travel += dot(pick(self._jstar_q), g[:, None])
            turned(cross(pick(at.relative_velocity), r.by_velocity))
        if r.by_turn is not None:
            g = inward(r.by_turn)
            travel += _along(stack.moves_tip, g.ndim) * dot(pick(arm.axes), g[:, None])
            turned(r.by_turn)
        if r.by_spin is not None:
            g = inward(r.by_spin)
            by_rate(dot(pick(arm.spin), g[:, None]))
            by_rate(_along(stack.moves_tip, g.ndim) * dot(pick(arm.axes), g[:, None]))
            travel += dot(pick(self._tip_spin_q), g[:, None])
            turned(cross(pick(at.spin), r.by_spin))
        if r.by_base is not None:
            travel -= dot(pick(arm.linear), inward(r.by_base)[:, None]) / stack.mass
            turned(cross(pick(at.base_from_com), r.by_base))
        if r.by_base_turn is not None:
            turned(r.by_base_turn)
        if r.by_base_spin is not None:
            g = inward(r.by_base_spin)
            by_rate(dot(pick(arm.spin), g[:, None]))
            travel += dot(pick(self._spin_q), g[:, None])
            turned(cross(pick(at.base_spin), r.by_base_spin))
        if r.by_entropy is not None:
            travel += r.by_entropy * pick(self._entropy_q)
        if r.by_coupling is not None:
            picked = ArmValues(*(pick(value) for value in arm.arrays()))
            travel += coupling_slopes(stack, picked, r.by_coupling)
        return travel, rates, turn


def _along(values: FloatArray, dimensions: int) -> FloatArray:
    """A value a joint (n,), to be multiplied with (n, ...) of so many dimensions."""
    return values.reshape(-1, *(1,) * (dimensions - 1))

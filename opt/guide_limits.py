"""The limits of the joints and the steps' box, as residuals of a guide."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.guide_unknowns import Unknowns
from ffsms_pin.opt.step_kinetics import KineticsAt
from ffsms_pin.system import SpaceManipulator

__all__ = ["OVER", "JointResiduals", "Residuals"]

OVER = 1.02  # share of a limit that a guide may use: the step that follows it keeps the limit itself
_SHARE = 0.96  # of the limits that a guide should use: the step that follows it needs some
_BOX = 1.0  # [rad/s] of the steps' |alpha_i|
_RATE, _ACCELERATION = 10.0, 5.0  # weights
_MARGIN = 0.05  # of the joints' distance from the middle of their range at the end
_EDGE, _CALM = 0.5, 0.9  # joints keep within this share of their range where they can: room for corrections
_INSIDE = 0.99  # of the range: bounds of the unknowns


class Residuals(NamedTuple):
    """Values (m,) and slopes (m, k) by the unknowns."""

    value: FloatArray
    slope: FloatArray


class JointResiduals:
    """What exceeds shares of the joints' limits and of the box |alpha_i| <= 1, and how the joints end.

    Parameters
    ----------
    sms : SpaceManipulator
    q : ndarray, shape (nq,)
        Any configuration.
    unknowns : Unknowns

    Attributes
    ----------
    lower, upper : ndarray, shape (k,)
        Bounds of the unknowns: a spline lies within the range of its control points.
    """

    def __init__(self, sms: SpaceManipulator, q: FloatArray, unknowns: Unknowns) -> None:
        self._sms, self._unknowns, self._limits = sms, unknowns, sms.limits
        self._kinetics, self._trial = KineticsAt(sms), q.copy()
        lower, upper = self._limits.lower, self._limits.upper
        ranged = np.isfinite(lower) & np.isfinite(upper)
        low, high = np.where(ranged, lower, -np.pi), np.where(ranged, upper, np.pi)
        self._half, self._middle = 0.5 * (high - low), 0.5 * (high + low)
        least = np.where(ranged, self._middle - _INSIDE * self._half, lower)
        most = np.where(ranged, self._middle + _INSIDE * self._half, upper)
        rows, joints = unknowns.free.shape[1], unknowns.joints
        self.lower, self.upper = np.tile(least[joints], rows), np.tile(most[joints], rows)

    def residuals(self, P: FloatArray) -> list[Residuals]:
        """Weighted residuals for control points P (K, n); what exceeds nothing is left out."""
        maps, limits = self._unknowns, self._limits
        speeds = maps.rates @ P
        return [
            self._boxed(maps.positions @ P, speeds),
            self._exceeding(_RATE, maps.rates, speeds, limits.velocity),
            self._exceeding(_ACCELERATION, maps.accelerations, maps.accelerations @ P, limits.acceleration),
            self._exceeding(_EDGE, maps.free.T, (P - self._middle)[2:-1], self._half, _CALM),
            self._last(P[-1]),
        ]

    def kept(self, P: FloatArray) -> bool:
        """Whether rates and box hold at the nodes, and accelerations everywhere."""
        maps, limits, joints = self._unknowns, self._limits, self._unknowns.joints
        speeds = maps.rates @ P
        used = [
            (np.abs(speeds) / limits.velocity)[:, joints],
            (np.abs(maps.accelerations @ P) / limits.acceleration)[:, joints],
            np.abs(self._sides(maps.positions @ P, speeds)[0]) / _BOX,
        ]
        return all(share.max(initial=0.0) < OVER for share in used)

    def _exceeding(
        self, weight: float, B: FloatArray, values: FloatArray, most: FloatArray, share: float = _SHARE
    ) -> Residuals:
        """What the values (m, n), to which the maps B (m, K) lead, exceed a share of a limit by."""
        excess = np.abs(values) / most - share
        joints = self._unknowns.joints
        row, j = np.nonzero(excess[:, joints] > 0.0)
        j = joints[j]
        gradients = np.zeros((len(row), values.shape[1]))
        gradients[np.arange(len(row)), j] = weight * np.sign(values[row, j]) / most[j]
        return Residuals(weight * excess[row, j], self._unknowns.slopes(B[row], gradients))

    def _boxed(self, path: FloatArray, speeds: FloatArray) -> Residuals:
        """The same for the box |alpha_i| <= 1 of the steps; slopes leave out that V turns."""
        alphas, where, V = self._sides(path, speeds)
        k, i = np.nonzero(np.abs(alphas) > _SHARE * _BOX)
        gradients = (_RATE * np.sign(alphas[k, i]))[:, None] * V[k, :, i]
        slope = self._unknowns.slopes(self._unknowns.rates[where[k]], gradients)
        return Residuals(_RATE * (np.abs(alphas[k, i]) - _SHARE * _BOX), slope)

    def _sides(self, path: FloatArray, speeds: FloatArray) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
        """V^T rates (m, n), the steps' alpha, at nodes with rates so large that it matters, and their V."""
        where = np.flatnonzero((speeds**2).sum(axis=1) > (_SHARE * _BOX) ** 2)
        V = np.empty((len(where), *2 * path.shape[1:]))
        for k, positions in enumerate(path[where]):
            self._sms.layout.set_positions(self._trial, positions)
            V[k] = self._kinetics(self._trial).V
        return np.einsum("kji,kj->ki", V, speeds[where]), where, V

    def _last(self, last: FloatArray) -> Residuals:
        """The squares of the shares of their ranges that the joints end at, counted from the middle."""
        joints = self._unknowns.joints
        share = (last - self._middle) / self._half
        gradients = np.diag(_MARGIN * 2.0 * share / self._half)[joints]
        end = np.zeros((len(joints), len(self._unknowns.free)))
        end[:, -1] = 1.0
        return Residuals(_MARGIN * share[joints] ** 2, self._unknowns.slopes(end, gradients))

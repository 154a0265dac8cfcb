"""The least-squares problem whose solution is a guide."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.guide_base import BaseResiduals
from ffsms_pin.opt.guide_clearances import Shortfalls
from ffsms_pin.opt.guide_limits import JointResiduals, Residuals
from ffsms_pin.opt.guide_roll import Roll, roll
from ffsms_pin.opt.guide_unknowns import Unknowns
from ffsms_pin.opt.targets import Goal
from ffsms_pin.system import SpaceManipulator

__all__ = ["BEYOND", "GuideProblem"]

BEYOND = 3e-3  # [m] that a guide keeps beyond the clearance asked for
_POSITION = 200.0  # [1/m] weights of the residuals
_ROTATION = 100.0  # [1/rad]
_CLEARANCE = 200.0  # [1/m]
_EASE = 0.02  # [1/rad] of the way from control point to control point


class GuideProblem:
    """Residuals of a guide: where the end effector ends, every limit, clearances, and a short way.

    Parameters
    ----------
    sms : SpaceManipulator
    q : ndarray, shape (nq,)
        Present configuration.
    goal : Goal
    duration : float
        [s]
    unknowns : Unknowns
    shortfalls : Shortfalls, or None
        Of the clearances, where some are kept.
    base : BaseResiduals, or None
        Where the base's motion is limited.
    momentum : ndarray, shape (6,), or None
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        q: FloatArray,
        goal: Goal,
        duration: float,
        unknowns: Unknowns,
        shortfalls: Shortfalls | None,
        base: BaseResiduals | None,
        momentum: FloatArray | None,
    ) -> None:
        self._sms, self._q, self._goal, self._duration, self._momentum = sms, q, goal, duration, momentum
        self._unknowns, self._shortfalls, self._base = unknowns, shortfalls, base
        self.joints = JointResiduals(sms, q, unknowns)
        self._watched = unknowns.positions  # where the clearances are residuals
        n = len(unknowns.joints)
        ease = np.kron(np.diff(unknowns.free, axis=0), np.eye(n))
        self._ease: FloatArray = np.asarray(_EASE * ease, dtype=np.float64)

    def residuals(self, x: FloatArray) -> Residuals:
        """Values and slopes at x; how many there are differs from place to place."""
        P = self._unknowns.points(x)
        end = self.roll(P, slopes=True)
        parts = [self._aim(end), *self.joints.residuals(P)]
        if self._shortfalls is not None:
            parts.append(self._near(self._shortfalls, P))
        if self._base is not None:
            parts.append(self._base.residuals(end, self._unknowns))
        way = np.diff(P, axis=0)[:, self._unknowns.joints]
        parts.append(Residuals(_EASE * way.ravel(), self._ease))
        return Residuals(np.concatenate([part.value for part in parts]), np.vstack([p.slope for p in parts]))

    def roll(self, P: FloatArray, slopes: bool = False) -> Roll:
        """Where control points P (K, n) lead."""
        path, speeds = self._unknowns.positions @ P, self._unknowns.rates @ P
        return roll(self._sms, self._q, path, speeds, P[-1], self._duration, self._momentum, slopes)

    def fits(self, P: FloatArray, end: Roll) -> bool:
        """Whether the limits of the joints and of the base, the steps' box and the clearances are kept."""
        return self.joints.kept(P) and (self._base is None or self._base.kept(end)) and self.clear(P)

    def clear(self, P: FloatArray) -> bool:
        """Whether the clearances are kept, between the nodes too."""
        if self._shortfalls is None:
            return True
        return bool((self._shortfalls.along(self._unknowns.dense @ P)[0] <= BEYOND).all())

    def watch_closely(self) -> None:
        """From now on ask for the clearances between the nodes too: a thin edge may lie between two."""
        self._watched = self._unknowns.dense

    def _aim(self, end: Roll) -> Residuals:
        """How far the end effector ends from the goal."""
        slopes, unknowns = end.slopes, self._unknowns
        assert slopes is not None
        tip = unknowns.summed(unknowns.positions, slopes.positions)
        tip += unknowns.summed(unknowns.rates, slopes.rates)
        last = np.zeros((6, len(unknowns.free)))
        last[:, -1] = 1.0
        tip += unknowns.slopes(last, slopes.last)
        value, slope = _POSITION * (end.position - self._goal.position), _POSITION * tip[:3]
        if self._goal.rotation is None:
            return Residuals(value, slope)
        apart = self._goal.rotation @ end.rotation.T
        turn = -_ROTATION * (pin.Jlog3(apart) @ tip[3:])
        return Residuals(np.append(value, _ROTATION * pin.log3(apart)), np.vstack([slope, turn]))

    def _near(self, shortfalls: Shortfalls, P: FloatArray) -> Residuals:
        """What the clearances fall short by."""
        value, gradients = shortfalls.along(self._watched @ P, gradient=True)
        k, i = np.nonzero(value > 0.0)
        slope = self._unknowns.slopes(self._watched[k], gradients[k, i])
        return Residuals(_CLEARANCE * value[k, i], _CLEARANCE * slope)

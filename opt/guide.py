"""A guide: a smooth joint motion that brings the end effector to its target, the base reacting.

A step sees one step ahead. Where joint limits or the base's reaction stop it short, a whole motion has to be
chosen: a cubic spline in joint space, from the present positions and rates to rest, found by least squares on
where the end effector ends (the base rolled out on the momentum equation) and on the limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import lapack
from scipy.optimize import least_squares

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator

__all__ = ["Guide", "find_guide"]

_SAMPLES = 32  # of the roll-out
_SHARE = 0.96  # of the limits that a guide uses: the step that follows it needs some
_POSITION = 200.0  # [1/m] weights of the residuals
_ROTATION = 100.0  # [1/rad]
_RATE, _ACCELERATION, _MARGIN, _EASE = 10.0, 5.0, 0.05, 0.02


@dataclass(frozen=True)
class Guide:
    """A joint motion over `duration`, from `start` on.

    Attributes
    ----------
    start, duration : float
        [s]
    points : ndarray, shape (K, n)
        Control points of the spline.
    miss : float
        Distance to the target at the end, on the model [m].
    fits : bool
        Whether the limits hold.
    """

    start: float
    duration: float
    points: FloatArray
    miss: float
    fits: bool

    def sample(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Positions and rates, each (n,), at t [s]; at rest after the end."""
        s = min(max((t - self.start) / self.duration, 0.0), 1.0)
        spline = BSpline(_knots(len(self.points)), self.points, 3)
        return spline(s), spline.derivative()(s) / self.duration


def find_guide(
    sms: SpaceManipulator,
    q: FloatArray,
    rates: FloatArray,
    goal: FloatArray,
    start: float,
    duration: float,
    first: FloatArray,
    rotation: FloatArray | None = None,
    fixed: NDArray[np.bool_] | None = None,
) -> Guide:
    """The guide from a state to a goal.

    Parameters
    ----------
    sms : SpaceManipulator
    q, rates : ndarray, shape (nq,), (n,)
        Present configuration and joint rates.
    goal, rotation : ndarray, shape (3,), (3, 3)
        End-effector position, and attitude where one is wanted.
    start, duration : float
        [s]
    first : ndarray, shape (m, n)
        A first guess: joint positions at evenly spaced instants.
    fixed : ndarray of bool, shape (n,), optional
        Joints that cannot be moved.
    """
    n = sms.n
    knots = 10 if duration > 3.0 else 7
    basis = [_basis(knots, order) / duration**order for order in (0, 1, 2)]
    head = _head(sms.layout.positions(q), rates, knots, duration)
    limits = sms.limits
    half, middle = 0.5 * (limits.upper - limits.lower), 0.5 * (limits.upper + limits.lower)
    half, middle = np.where(np.isfinite(half), half, np.pi), np.where(np.isfinite(middle), middle, 0.0)
    free = np.ones(n, dtype=bool) if fixed is None else ~fixed
    rows = knots - 3  # the last control point is there twice: at rest at the end

    def points(x: FloatArray) -> FloatArray:
        P = np.tile(head[1], (rows, 1))
        P[:, free] = x.reshape(rows, -1)
        return np.vstack([head, P, P[-1:]])

    def residuals(x: FloatArray) -> FloatArray:
        P = points(x)
        end, turned = _roll(sms, q, basis[0] @ P, basis[1] @ P, P[-1], duration)
        rate = np.abs(basis[1] @ P) / limits.velocity
        acceleration = np.abs(basis[2] @ P) / limits.acceleration
        parts = [
            _POSITION * (end - goal),
            _RATE * np.maximum(rate - _SHARE, 0.0).ravel(),
            _ACCELERATION * np.maximum(acceleration - _SHARE, 0.0).ravel(),
            _MARGIN * ((P[-1] - middle) / half)[free] ** 2,
            _EASE * np.diff(P, axis=0)[:, free].ravel(),
        ]
        if rotation is not None:
            parts.append(_ROTATION * pin.log3(rotation @ turned.T))
        return np.concatenate(parts)

    at = np.linspace(0.0, len(first) - 1.0, rows + 2)[1:-1]
    guess = np.array([np.interp(at, np.arange(len(first)), first[:, i]) for i in range(n)]).T
    edge = 0.99 * half
    bounds = np.where(np.isfinite(limits.upper), edge, 1e3)
    x0 = np.clip(guess, middle - 0.98 * bounds, middle + 0.98 * bounds)[:, free].ravel()
    lower, upper = (middle - bounds)[free], (middle + bounds)[free]
    done = least_squares(
        residuals, x0, bounds=(np.tile(lower, rows), np.tile(upper, rows)), max_nfev=30, ftol=1e-7, xtol=1e-7
    )
    P = points(done.x)
    end, _ = _roll(sms, q, basis[0] @ P, basis[1] @ P, P[-1], duration)
    excess = (np.abs(basis[1] @ P) / limits.velocity)[:, free].max() if free.any() else 0.0
    return Guide(start, duration, P, float(np.linalg.norm(end - goal)), bool(excess < 1.02))


def _knots(count: int) -> FloatArray:
    inner = np.arange(1.0, count - 3) / (count - 3)
    return np.concatenate([np.zeros(4), inner, np.ones(4)])


def _basis(count: int, derivative: int) -> FloatArray:
    """Basis functions, or their derivatives, at the middles of the samples (samples, count)."""
    at = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    spline = BSpline(_knots(count), np.eye(count), 3)
    values: FloatArray = spline(at) if derivative == 0 else spline.derivative(derivative)(at)
    return values


def _head(positions: FloatArray, rates: FloatArray, count: int, duration: float) -> FloatArray:
    """The first two control points, which say where the motion starts and how fast."""
    return np.array([positions, positions + rates * duration / (3.0 * (count - 3))])


def _roll(
    sms: SpaceManipulator,
    q: FloatArray,
    path: FloatArray,
    rates: FloatArray,
    last: FloatArray,
    duration: float,
) -> tuple[FloatArray, Any]:
    """Where the end effector ends: its position and rotation."""
    step = duration / len(path)
    pose, trial = pin.XYZQUATToSE3(q[:7]), q.copy()
    for positions, speed in zip(path, rates, strict=True):
        sms.layout.set_positions(trial, positions)
        M = pin.crba(sms.model, sms._data, trial)
        _, root, _ = lapack.dposv(M[:6, :6], -(M[:6, 6:] @ speed))
        pose = pose * pin.exp6(pin.Motion(step * root))
    trial[:7] = pin.SE3ToXYZQUAT(pose)
    sms.layout.set_positions(trial, last)
    pin.forwardKinematics(sms.model, sms._data, trial)
    tip = pin.updateFramePlacement(sms.model, sms._data, sms.frame_id)
    return tip.translation.copy(), tip.rotation.copy()

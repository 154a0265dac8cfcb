"""A guide: a smooth joint motion that brings the end effector to its target, the base reacting.

A step sees one step ahead. Where joint limits or the base's reaction stop it short, a whole motion has to be
chosen: a cubic spline in joint space, from the present positions and rates to rest, found by least squares on
where the end effector ends (the base rolled out on the momentum equation), on the limits and on clearances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.clearances import ClearanceModel
from ffsms_pin.opt.guide_roll import roll
from ffsms_pin.opt.least_squares import least_squares
from ffsms_pin.opt.step_kinetics import KineticsAt
from ffsms_pin.system import SpaceManipulator

__all__ = ["Guide", "find_guide", "followed_on"]

# Samples of the roll-out, as shares of the time: two Gauss points a panel. Samples at the middles of equal
# spans would put the end of a motion of 12 s off by millimetres.
_SAMPLES = 32
_GAUSS = (0.5 - np.sqrt(3.0) / 6.0, 0.5 + np.sqrt(3.0) / 6.0)
_NODES = np.array([(panel + place) * 2.0 / _SAMPLES for panel in range(_SAMPLES // 2) for place in _GAUSS])
_EVERY = 2  # clearances are kept at every second of them
_SHARE = 0.96  # of the limits that a guide uses: the step that follows it needs some
_POSITION = 200.0  # [1/m] weights of the residuals
_ROTATION = 100.0  # [1/rad]
_CLEARANCE = 100.0  # [1/m]
_RATE, _ACCELERATION, _MARGIN, _EASE = 10.0, 5.0, 0.05, 0.02
_EDGE, _CALM = 0.5, 0.9  # joints keep within this share of their range where they can: room for corrections
_BEYOND = 3e-3  # [m] that a guide keeps beyond the clearance asked for
_ITERATIONS = 30


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
        Whether the rate limits and the clearances hold.
    """

    start: float
    duration: float
    points: FloatArray
    miss: float
    fits: bool

    def sample(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Positions and rates, each (n,), at t [s]; at rest after the end."""
        s = min(max((t - self.start) / self.duration, 0.0), 1.0)
        at = np.array([s])
        count = len(self.points)
        return (
            (_basis(count, 0, at) @ self.points)[0],
            (_basis(count, 1, at) @ self.points)[0] / self.duration,
        )


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
    clearances: ClearanceModel | None = None,
    clearance: float = 0.0,
    momentum: FloatArray | None = None,
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
    clearances : ClearanceModel, optional
        What is to be kept apart, by at least `clearance` [m] or by as much as it is apart at the start.
    momentum : ndarray, shape (6,), optional
        As for `SpaceManipulator.velocity`.
    """
    n = sms.n
    knots = 10 if duration > 3.0 else 7
    basis = [_basis(knots, order, _NODES) / duration**order for order in (0, 1, 2)]
    head = _head(sms.layout.positions(q), rates, knots, duration)
    limits = sms.limits
    half, middle = 0.5 * (limits.upper - limits.lower), 0.5 * (limits.upper + limits.lower)
    half, middle = np.where(np.isfinite(half), half, np.pi), np.where(np.isfinite(middle), middle, 0.0)
    free = np.flatnonzero(np.ones(n, dtype=bool) if fixed is None else ~fixed)
    rows, count = (
        knots - 3,
        (knots - 3) * len(free),
    )  # the last control point is there twice: at rest at the end
    kinetics, trial = KineticsAt(sms), q.copy()
    keep = None if clearances is None else _Keep(sms, clearances, q, clearance + _BEYOND)
    # Control points are linear in the unknowns: the last of these moves the last two of those.
    spread = np.zeros((knots, rows))
    spread[2 : knots - 1] = np.eye(rows)
    spread[-1, -1] = 1.0
    inner = [B @ spread for B in basis]

    ease = np.asarray(_EASE * np.kron(np.diff(spread, axis=0), np.eye(len(free))), dtype=np.float64)

    def points(x: FloatArray) -> FloatArray:
        P = np.tile(head[1], (rows, 1))
        P[:, free] = x.reshape(rows, -1)
        return np.vstack([head, P, P[-1:]])

    def sides(path: FloatArray, speeds: FloatArray) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
        """alpha = V^T rates (k, n) of the samples whose rates are long enough for it to matter, and their V."""
        where = np.flatnonzero((speeds**2).sum(axis=1) > _SHARE**2)
        V = np.empty((len(where), n, n))
        for k, positions in enumerate(path[where]):
            sms.layout.set_positions(trial, positions)
            V[k] = kinetics(trial).V
        return np.einsum("kji,kj->ki", V, speeds[where]), where, V

    def columns(slopes: FloatArray, B: FloatArray) -> FloatArray:
        """Slopes (S, m, n) with the samples' values, as slopes (m, unknowns)."""
        summed: FloatArray = np.einsum("smj,sk->mkj", slopes[:, :, free], B)
        return summed.reshape(slopes.shape[1], count)

    def bounded(
        B: FloatArray, values: FloatArray, most: FloatArray, share: float = _SHARE
    ) -> tuple[FloatArray, FloatArray]:
        """What exceeds a share of a limit, and its slopes; rows that exceed nothing are left out."""
        excess = np.abs(values) / most - share
        s, j = np.nonzero(excess[:, free] > 0.0)
        S = np.zeros((len(s), rows, len(free)))
        S[np.arange(len(s)), :, j] = (np.sign(values[:, free]) / most[free])[s, j][:, None] * B[s]
        return excess[:, free][s, j], S.reshape(len(s), count)

    def boxed(path: FloatArray, speeds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same for the box |alpha_i| <= 1 of the steps; slopes leave out that V turns."""
        alphas, where, V = sides(path, speeds)
        k, i = np.nonzero(np.abs(alphas) > _SHARE)
        along = np.sign(alphas[k, i])[:, None] * V[k, :, i][:, free]
        S = inner[1][where[k]][:, :, None] * along[:, None, :]
        return np.abs(alphas[k, i]) - _SHARE, S.reshape(len(k), count)

    def residuals(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        P = points(x)
        path = basis[0] @ P
        speeds = basis[1] @ P
        end = roll(sms, q, path, speeds, P[-1], duration, momentum, slopes=True)
        assert end.slopes is not None
        tip = columns(end.slopes.positions, inner[0]) + columns(end.slopes.rates, inner[1])
        tip.reshape(6, rows, len(free))[:, -1] += end.slopes.last[:, free]
        parts = [(_POSITION * (end.position - goal), _POSITION * tip[:3])]
        if rotation is not None:
            apart = rotation @ end.rotation.T
            parts.append((_ROTATION * pin.log3(apart), -_ROTATION * (pin.Jlog3(apart) @ tip[3:])))
        value, slope = boxed(path, speeds)
        parts.append((_RATE * value, _RATE * slope))
        for weight, B, order, most in (
            (_RATE, inner[1], 1, limits.velocity),
            (_ACCELERATION, inner[2], 2, limits.acceleration),
        ):
            value, slope = bounded(B, basis[order] @ P, most)
            parts.append((weight * value, weight * slope))
        if keep is not None:
            value, slopes = keep.short(path[::_EVERY], gradient=True)
            S = np.einsum("smj,sk->smkj", slopes[:, :, free], inner[0][::_EVERY])
            near = value.ravel() > 0.0
            parts.append((_CLEARANCE * value.ravel()[near], _CLEARANCE * S.reshape(len(near), count)[near]))
        off = (P[-1] - middle)[free] / half[free]
        S = np.zeros((len(free), rows, len(free)))
        S[:, -1] = np.diag(2.0 * off / half[free])
        parts.append((_MARGIN * off**2, _MARGIN * S.reshape(len(free), count)))
        value, slope = bounded(spread[2:-1], P[2:-1] - middle, half, _CALM)
        parts.append((_EDGE * value, _EDGE * slope))
        parts.append((_EASE * np.diff(P, axis=0)[:, free].ravel(), ease))
        return np.concatenate([part[0] for part in parts]), np.vstack([part[1] for part in parts])

    # The spline nearest to the first guess: one that is nearly right already hardly has to change.
    B = _basis(knots, 0, np.linspace(0.0, 1.0, len(first)))
    guess = np.linalg.lstsq(B @ spread, first - B[:, :2] @ head, rcond=None)[0]
    bounds = np.where(np.isfinite(limits.upper), 0.99 * half, 1e3)[free]
    lower, upper = np.tile(middle[free] - bounds, rows), np.tile(middle[free] + bounds, rows)
    x = least_squares(residuals, guess[:, free].ravel(), lower, upper, _ITERATIONS)
    P = points(x)
    path, speeds = basis[0] @ P, basis[1] @ P
    end = roll(sms, q, path, speeds, P[-1], duration, momentum)
    # Its ends are given, and steps that brake late still follow: accelerations are not looked at.
    excess = (np.abs(speeds) / limits.velocity)[:, free].max(initial=np.abs(sides(path, speeds)[0]).max(initial=0.0))
    clear = True
    if keep is not None:
        dense = _basis(knots, 0, np.linspace(0.0, 1.0, 2 * _SAMPLES + 1)) @ P
        clear = bool((keep.short(dense)[0] <= _BEYOND).all())
    return Guide(
        start, duration, P, float(np.linalg.norm(end.position - goal)), bool(excess < 1.02) and clear
    )


def followed_on(
    guide: Guide,
    sms: SpaceManipulator,
    q: FloatArray,
    t: float,
    goal: FloatArray,
    momentum: FloatArray | None,
) -> Guide:
    """The same guide with the miss that it has from the state q at t [s] on, on this robot."""
    left = guide.start + guide.duration - t
    at = t + left * _NODES
    path, rates = (np.array(part) for part in zip(*(guide.sample(float(s)) for s in at), strict=True))
    end = roll(sms, q, path, rates, guide.points[-1], left, momentum)
    return replace(guide, miss=float(np.linalg.norm(end.position - goal)))


class _Keep:
    """How far clearances fall short of what is asked for along a motion."""

    def __init__(
        self, sms: SpaceManipulator, clearances: ClearanceModel, q: FloatArray, least: float
    ) -> None:
        self._sms, self._clearances, self._trial = sms, clearances, q.copy()
        self._least = np.minimum(least, clearances.evaluate(q).value)

    def short(self, path: FloatArray, gradient: bool = False) -> tuple[FloatArray, FloatArray]:
        """Shortfalls (S, m) [m], and where wanted their slopes (S, m, n), at joint positions (S, n)."""
        values, slopes = [], []
        sms, trial, model = self._sms, self._trial, self._clearances
        for positions in path:
            sms.layout.set_positions(trial, positions)
            if gradient:
                value, slope = model.evaluate(trial)
                slopes.append(-slope)
            else:
                pin.forwardKinematics(sms.model, sms._data, trial)
                pin.updateFramePlacement(sms.model, sms._data, sms.frame_id)
                value = model.values(sms._data)
            values.append(self._least - value)
        return np.array(values), np.array(slopes)


def _basis(count: int, derivative: int, at: FloatArray) -> FloatArray:
    """Cubic B-splines on [0, 1] with ends clamped, or their derivatives, at some places (places, count)."""
    inner = np.arange(1.0, count - 3) / (count - 3)
    knots = np.concatenate([np.zeros(4), inner, np.ones(4)])
    degree = 3 - derivative
    # Recursion of Cox and de Boor; the last span holds the end as well.
    span = np.clip(np.searchsorted(knots, at, side="right") - 1, 3, count - 1)
    values = np.zeros((len(at), count + 3))
    values[np.arange(len(at)), span] = 1.0
    for d in range(1, degree + 1):
        width = knots[d:] - knots[:-d]
        share = np.divide(1.0, width, out=np.zeros_like(width), where=width > 0.0)
        left = (at[:, None] - knots[: -d - 1]) * share[:-1]
        right = (knots[d + 1 :] - at[:, None]) * share[1:]
        m = len(knots) - d - 1
        values = left[:, :m] * values[:, :m] + right[:, :m] * values[:, 1 : m + 1]
    for d in range(degree + 1, 4):
        width = knots[d:] - knots[:-d]
        share = np.divide(d, width, out=np.zeros_like(width), where=width > 0.0)
        m = len(knots) - d - 1
        values = share[:m] * values[:, :m] - share[1 : m + 1] * values[:, 1 : m + 1]
    return values


def _head(positions: FloatArray, rates: FloatArray, count: int, duration: float) -> FloatArray:
    """The first two control points, which say where the motion starts and how fast."""
    return np.array([positions, positions + rates * duration / (3.0 * (count - 3))])

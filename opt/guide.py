"""A guide: a smooth joint motion that brings the end effector to its target, the base reacting.

A step sees one step ahead. Where joint limits or the base's reaction stop it short, a whole motion has to be
chosen: a cubic spline in joint space, from the present positions and rates to rest, found by least squares on
where the end effector ends (the base rolled out on the momentum equation), on the limits and on clearances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.clearances import ClearanceModel
from ffsms_pin.opt.guide_clearances import Shortfalls
from ffsms_pin.opt.guide_roll import roll
from ffsms_pin.opt.guide_spline import basis, head
from ffsms_pin.opt.least_squares import least_squares
from ffsms_pin.opt.step_kinetics import KineticsAt
from ffsms_pin.system import SpaceManipulator

__all__ = ["Guide", "find_guide", "followed_on"]

# Samples of the roll-out, as shares of the time: two Gauss points a panel. Samples at the middles of equal
# spans would put the end of a motion of 12 s off by millimetres.
_SAMPLES = 32
_GAUSS = (0.5 - np.sqrt(3.0) / 6.0, 0.5 + np.sqrt(3.0) / 6.0)
_NODES = np.array([(panel + place) * 2.0 / _SAMPLES for panel in range(_SAMPLES // 2) for place in _GAUSS])
_SHARE = 0.96  # of the limits that a guide uses: the step that follows it needs some
_BOX = 1.0  # [rad/s] of the steps' |alpha_i|
_POSITION = 200.0  # [1/m] weights of the residuals
_ROTATION = 100.0  # [1/rad]
_CLEARANCE = 200.0  # [1/m]
_RATE, _ACCELERATION, _MARGIN, _EASE = 10.0, 5.0, 0.05, 0.02
_EDGE, _CALM = 0.5, 0.9  # joints keep within this share of their range where they can: room for corrections
_BEYOND = 3e-3  # [m] that a guide keeps beyond the clearance asked for
_ITERATIONS = 30
_ENOUGH = 2e-4  # decrease of the sum of squares that is not worth an iteration: a miss of 0.07 mm


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
        Whether the rate limits, the steps' box |alpha_i| <= 1 and the clearances hold.
    """

    start: float
    duration: float
    points: FloatArray
    miss: float
    fits: bool

    def sample(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Positions and rates, each (n,), at t [s]; at rest after the end."""
        # Between two knots it is a cubic, which its ends and their rates give.
        at, positions, rates = self._knots
        pieces = len(at) - 1
        place = min(max((t - self.start) / self.duration, 0.0), 1.0) * pieces
        k = min(int(place), pieces - 1)
        u, h = place - k, self.duration / pieces
        first, last = rates[k], rates[k + 1]
        mean = (positions[k + 1] - positions[k]) / h
        c, b = 3.0 * mean - 2.0 * first - last, first + last - 2.0 * mean
        return positions[k] + (h * u) * (first + u * (c + u * b)), first + u * (2.0 * c + (3.0 * u) * b)

    @cached_property
    def _knots(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Instants of the spline's knots, and positions and rates there."""
        at = np.linspace(self.start, self.start + self.duration, len(self.points) - 2)
        return at, *self.along(at)

    def along(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same at many instants t (m,) [s]: positions and rates, each (m, n)."""
        s, count = np.clip((t - self.start) / self.duration, 0.0, 1.0), len(self.points)
        return basis(count, 0, s) @ self.points, basis(count, 1, s) @ self.points / self.duration


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
    bases = [basis(knots, order, _NODES) / duration**order for order in (0, 1, 2)]
    begin = head(sms.layout.positions(q), rates, knots, duration)
    limits = sms.limits
    half, middle = 0.5 * (limits.upper - limits.lower), 0.5 * (limits.upper + limits.lower)
    half, middle = np.where(np.isfinite(half), half, np.pi), np.where(np.isfinite(middle), middle, 0.0)
    free = np.flatnonzero(np.ones(n, dtype=bool) if fixed is None else ~fixed)
    rows = knots - 3  # the last control point is there twice: at rest at the end
    count = rows * len(free)
    kinetics, trial = KineticsAt(sms), q.copy()
    keep = None if clearances is None else Shortfalls(sms, clearances, q, clearance + _BEYOND)
    # Control points are linear in the unknowns: the last of these moves the last two of those.
    spread = np.zeros((knots, rows))
    spread[2 : knots - 1] = np.eye(rows)
    spread[-1, -1] = 1.0
    inner = [B @ spread for B in bases]

    ease = np.asarray(_EASE * np.kron(np.diff(spread, axis=0), np.eye(len(free))), dtype=np.float64)

    def points(x: FloatArray) -> FloatArray:
        P = np.tile(begin[1], (rows, 1))
        P[:, free] = x.reshape(rows, -1)
        return np.vstack([begin, P, P[-1:]])

    def sides(path: FloatArray, speeds: FloatArray) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
        """V^T rates (k, n), the steps' alpha, of samples with rates so large that it matters, and their V."""
        where = np.flatnonzero((speeds**2).sum(axis=1) > (_SHARE * _BOX) ** 2)
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
        k, i = np.nonzero(np.abs(alphas) > _SHARE * _BOX)
        along = np.sign(alphas[k, i])[:, None] * V[k, :, i][:, free]
        S = inner[1][where[k]][:, :, None] * along[:, None, :]
        return np.abs(alphas[k, i]) - _SHARE * _BOX, S.reshape(len(k), count)

    def residuals(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        P = points(x)
        path = bases[0] @ P
        speeds = bases[1] @ P
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
            value, slope = bounded(B, bases[order] @ P, most)
            parts.append((weight * value, weight * slope))
        if keep is not None:
            value, slopes = keep.along(path, gradient=True)
            S = np.einsum("smj,sk->smkj", slopes[:, :, free], inner[0])
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
    B = basis(knots, 0, np.linspace(0.0, 1.0, len(first)))
    ends = np.vstack([begin, first[-1], first[-1]])
    inside = np.linalg.lstsq(B[:, 2:-2], first - B[:, [0, 1, -2, -1]] @ ends, rcond=None)[0]
    guess = np.vstack([inside, first[-1:]])
    bounds = np.where(np.isfinite(limits.upper), 0.99 * half, 1e3)[free]
    lower, upper = np.tile(middle[free] - bounds, rows), np.tile(middle[free] + bounds, rows)
    x = least_squares(residuals, guess[:, free].ravel(), lower, upper, _ITERATIONS, _ENOUGH)
    P = points(x)
    path, speeds = bases[0] @ P, bases[1] @ P
    end = roll(sms, q, path, speeds, P[-1], duration, momentum)
    excess = (np.abs(speeds) / limits.velocity)[:, free].max(initial=0.0)
    boxed_in = bool(np.abs(sides(path, speeds)[0]).max(initial=0.0) < 1.02 * _BOX)
    clear = True
    if keep is not None:
        dense = basis(knots, 0, np.linspace(0.0, 1.0, 2 * _SAMPLES + 1)) @ P
        clear = bool((keep.along(dense)[0] <= _BEYOND).all())
    fits = bool(excess < 1.02) and boxed_in and clear
    return Guide(start, duration, P, float(np.linalg.norm(end.position - goal)), fits)


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
    path, rates = guide.along(t + left * _NODES)
    end = roll(sms, q, path, rates, guide.points[-1], left, momentum)
    return replace(guide, miss=float(np.linalg.norm(end.position - goal)))

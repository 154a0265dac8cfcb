"""Residuals of whole motions and their Jacobians, for several motions at once.

The unknowns of a motion are the control points p (M, n) of its joint rates. Its residuals are the paper's
cost, the distance to the target at the deadline, const8 in the last tenth, clearances that are too small,
and the integral of the squared acceleration. To add one, return another `Residual` from `_residuals`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.base_residual import BaseShares
from ffsms_pin.opt.horizon.cost_residual import cost_residual
from ffsms_pin.opt.horizon.course import Course, course
from ffsms_pin.opt.horizon.jacobian import Jacobian, Residual
from ffsms_pin.opt.horizon.orientation import orientation_residual
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.batch.stacks import apply, dot
from ffsms_pin.opt.horizon.task import Task
from ffsms_pin.opt.horizon.weights import Weights

__all__ = ["AIM_TAIL", "CLEARANCE_MARGIN", "Linearisation", "linearise"]

# [m] What const8 asks, 0.02 m, less what the spline and its penalty may miss.
AIM_TAIL = 0.018
# [m] Nearer than this to the target at the deadline there is nothing to gain; arrival asks for 1e-3.
AIM_END = 4e-4
# [arm lengths] Kept beyond the asked clearance: a penalty gives way, and only the points of the quadrature
# are watched.
CLEARANCE_MARGIN = 0.01


@dataclass
class Linearisation:
    """S motions: every array has S rows, so that rows can be taken, replaced and joined.

    Attributes
    ----------
    merit : ndarray, shape (S,)
        The weighted sum of squares.
    cost : ndarray, shape (S,)
        The paper's cost integral [s], by quadrature.
    gradient : ndarray, shape (S, Mn)
        Half of the merit's; zero where it was not asked for.
    hessian : ndarray, shape (S, Mn, Mn)
        Half of the merit's, Gauss-Newton; likewise.
    error, tail, lack : ndarray, shape (S,)
        Distance at T, the largest in the last tenth, and the largest lack of clearance [m]; where an
        attitude is wanted, the angle to it counts if it is larger [rad].
    base_lack : ndarray, shape (S,)
        The largest share of a base limit that is used beyond 1 less its margin.
    way : ndarray, shape (S, 3)
        From the end effector to the target at T, axes of the base at the start [m].
    """

    merit: FloatArray
    cost: FloatArray
    gradient: FloatArray
    hessian: FloatArray
    error: FloatArray
    tail: FloatArray
    lack: FloatArray
    base_lack: FloatArray
    way: FloatArray

    def take(self, index: Any) -> Linearisation:
        """The motions at an index."""
        return Linearisation(*(getattr(self, field.name)[index] for field in fields(self)))

    def put(self, index: Any, other: Linearisation) -> None:
        """Replace the motions at an index."""
        for field in fields(self):
            getattr(self, field.name)[index] = getattr(other, field.name)

    def join(self, other: Linearisation) -> Linearisation:
        """These motions and then the others."""
        names = [field.name for field in fields(self)]
        return Linearisation(*(np.concatenate([getattr(self, n), getattr(other, n)]) for n in names))


def linearise(
    task: Task, spline: RateSpline, p: FloatArray, w: Weights, below: float | FloatArray = np.inf
) -> Linearisation:
    """Residuals of motions with control points p (S, M, n), squared and linearised.

    Motions whose merit is not less than `below`, a number or (S,), are not worth derivatives and get none;
    minus infinity asks for none at all.
    """
    w = w.fitted(task)
    motions, size, n = p.shape
    at = course(task, spline, p)
    result, residuals = _measured(task, spline, at, w)
    lack = np.maximum(_lack(task, at, spline.points), 0.0)
    rough = spline.roughness @ p
    result.lack = lack.max(axis=(0, 2), initial=0.0)
    result.merit += w.clear * np.einsum("msq,msq,q->s", lack, lack, spline.weights)
    result.merit += w.rough * np.einsum("smj,smj->s", p, rough)
    result.gradient, result.hessian = np.zeros((motions, size * n)), np.zeros((motions, size * n, size * n))
    # What base limits add to the merit comes with its derivatives.
    good = np.flatnonzero(result.merit < (below if task.base_limits is None else np.inf))
    if not good.size:
        return result
    if good.size < motions:
        at, lack, residuals = at.take(good), lack[:, good], [one.take(good) for one in residuals]
    jacobian = Jacobian(task, spline, at)
    S = np.concatenate([jacobian.rows(one) for one in residuals], axis=-1)
    value = np.concatenate([one.value for one in residuals], axis=1)
    gradient, hessian = (S @ value[..., None])[..., 0], S @ np.swapaxes(S, 1, 2)
    _add_clearances(task, spline, at, w, lack, gradient, hessian)
    # So far the joints came first; outside of here the control points do.
    blocks = hessian.reshape(-1, n, size, n, size)
    for j in range(n):
        blocks[:, j, :, j] += w.rough * spline.roughness
    result.hessian[good] = blocks.transpose(0, 2, 1, 4, 3).reshape(hessian.shape)
    gradient = gradient.reshape(-1, n, size).transpose(0, 2, 1) + w.rough * rough[good]
    result.gradient[good] = gradient.reshape(len(good), -1)
    if task.base_limits is not None:
        _add_base_limits(spline, w, task.duration, jacobian.base_shares(task, task.base_limits), result)
    return result


def _measured(task: Task, spline: RateSpline, at: Course, w: Weights) -> tuple[Linearisation, list[Residual]]:
    """What needs no derivatives, clearances and roughness left out; and the residuals."""
    count = spline.points
    c = cost_residual(at.way, at.velocity, at.entropy, task.kappa, task.pace, w.slow, w.close)
    root = spline.roots
    cost = Residual(
        root * c.value,
        slice(None),
        by_velocity=root * c.by_velocity,
        by_tip=root * c.by_tip,
        by_entropy=root * c.by_entropy,
    )

    # The last tenth: what the distance exceeds. The end: the way beyond AIM_END, as a vector.
    late, last = spline.last_tenth, count + 1
    tail, end = at.way[..., late], at.way[..., last]
    far, error = np.sqrt(dot(tail, tail)), np.sqrt(dot(end, end))
    towards, unit = tail / np.maximum(far, 1e-9), end / np.maximum(error, 1e-9)
    excess, short = np.maximum(far - AIM_TAIL, 0.0), np.maximum(error - AIM_END, 0.0)
    share = short / np.maximum(error, 1e-9)
    by_end = share * np.eye(3)[..., None] + ((short > 0.0) - share) * (unit[:, None] * unit)
    root_tail, root_end = np.sqrt(w.tail), np.sqrt(w.end)
    arrival = Residual(
        np.concatenate([root_tail * excess, root_end * (short * unit).T], axis=1),
        np.append(late, [last] * 3),
        by_tip=-np.concatenate(
            [root_tail * (excess > 0.0) * towards, root_end * by_end.transpose(0, 2, 1)], axis=-1
        ),
    )

    residuals, furthest = [cost, arrival], far.max(axis=1)
    if task.rotation is not None:
        turned, angle = _orientation(task, at, late, root_tail, AIM_TAIL)
        furthest = np.maximum(furthest, angle.max(axis=1))
        turned_last, angle = _orientation(task, at, np.full(1, last), root_end, AIM_END)
        error = np.maximum(error, angle[:, 0])
        residuals += turned + turned_last
    empty = np.empty(0)
    result = Linearisation(
        merit=sum((np.einsum("sk,sk->s", one.value, one.value) for one in residuals), np.zeros(len(error))),
        cost=(c.exact * c.exact)[:, :count] @ spline.weights,
        gradient=empty,
        hessian=empty,
        error=error,
        tail=furthest,
        lack=empty,
        base_lack=np.zeros(len(error)),
        way=np.einsum("xys,ys->sx", at.R[..., -1], end),
    )
    return result, residuals


def _orientation(
    task: Task, at: Course, points: NDArray[np.signedinteger[Any]], root: float, tolerance: float
) -> tuple[list[Residual], FloatArray]:
    """The components of the turn to the wanted attitude; and its angle. A radian weighs like a metre."""
    assert task.rotation is not None
    attitude = apply(at.R[..., points], at.arm.tip_rotation[..., points])
    value, by_turn, angle = orientation_residual(task.rotation0.T @ task.rotation, attitude, tolerance)
    components = zip(root * value, root * by_turn, strict=True)
    return [Residual(one, points, by_turn=slope) for one, slope in components], angle


def _lack(task: Task, at: Course, count: int) -> FloatArray:
    """What clearances (m, S, Q) lack of the asked one and its margin; negative where they have it."""
    if task.clearances is None:
        return np.empty((0, *at.joints.shape[1:-1], count))
    least = task.clearance + CLEARANCE_MARGIN * task.length
    return least - task.clearances.values(at.joints, at.arm)[..., :count]


def _add_clearances(
    task: Task,
    spline: RateSpline,
    at: Course,
    w: Weights,
    lack: FloatArray,
    gradient: FloatArray,
    hessian: FloatArray,
) -> None:
    """Squares of what clearances lack: few, and most motions have none."""
    where = np.nonzero(lack)
    if task.clearances is None or not where[0].size:
        return
    _, motion, point = where
    scale = np.sqrt(w.clear * spline.weights[point])
    slopes = -scale * task.clearances.gradients(task.arm, at.joints, at.arm, where)
    rows = (slopes[:, None] * spline.travel[point].T).reshape(-1, len(point))
    values = scale * lack[where]
    for s in np.unique(motion):
        own = rows[:, motion == s]
        gradient[s] += own @ values[motion == s]
        hessian[s] += own @ own.T


def _add_base_limits(
    spline: RateSpline, w: Weights, duration: float, shares: BaseShares, result: Linearisation
) -> None:
    """Squares of the shares of base limits that are used beyond their margin."""
    # What is used too much at 0.9 T or T alone counts as if it were so all the time.
    over_time = np.append(spline.weights, [duration, duration])
    scale = shares.weight * np.sqrt(w.base * over_time[shares.point])
    np.maximum.at(result.base_lack, shares.motion, shares.excess)
    for s in np.unique(shares.motion):
        own = shares.motion == s
        slopes, values = scale[own, None] * shares.slope[own], scale[own] * shares.excess[own]
        result.merit[s] += float(values @ values)
        result.gradient[s] += slopes.T @ values
        result.hessian[s] += slopes.T @ slopes

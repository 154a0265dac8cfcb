"""Residuals of whole motions and their Jacobians, for several motions at once.

The unknowns of a motion are the control points p (M, n) of its joint rates. Its residuals are the paper's
cost, the distance to the target at the deadline, const8 in the last tenth, clearances that are too small,
and the integral of the squared acceleration.

The base's attitude follows from the joints by the momentum equation. Its change under a change of p, as a
rotation of everything about the centre of mass, is the integral of the change of its angular velocity: so
the same quadrature that gives the attitude gives its derivative.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.arm_slopes import arm_slopes
from ffsms_pin.opt.horizon.arm_stack import ArmValues
from ffsms_pin.opt.horizon.cost_residual import cost_residual
from ffsms_pin.opt.horizon.coupling_entropy import entropy_and_gradient
from ffsms_pin.opt.horizon.orientation import orientation_residual
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.horizon.stacks import exp3, skew
from ffsms_pin.opt.horizon.task import Task

__all__ = ["AIM_TAIL", "Linearisation", "Weights", "base_turns", "linearise"]

# [m] What const8 asks, 0.02 m, less what the spline and its penalty may miss.
AIM_TAIL = 0.018
# [m] Nearer than this to the target at the deadline there is nothing to gain; arrival asks for 1e-3.
AIM_END = 4e-4
# [arm lengths] Kept beyond the asked clearance: a penalty gives way, and only the points of the quadrature
# are watched.
CLEARANCE_MARGIN = 0.01


@dataclass(frozen=True)
class Weights:
    """Weights of the squares, and the smoothing of the cost's residual.

    Given for a motion of 8 s of an arm one metre long; `fitted` makes them those of a task, so that every
    term keeps its proportion to the cost integral.

    Attributes
    ----------
    end : float
        Of the distance at T [1/m^2].
    tail : float
        Of what the distance exceeds in the last tenth [1/m^2].
    clear : float
        Of what a clearance lacks, over time [1/(m^2 s)].
    rough : float
        Of the acceleration, over time [s^3]. Small: it decides between motions of equal cost.
    slow, close : float
        See `cost_residual`.
    """

    end: float
    tail: float
    clear: float
    rough: float
    slow: float = 0.0
    close: float = 0.0

    def fitted(self, task: Task) -> Weights:
        """The weights for a task."""
        per_square = 1.0 / task.length**2
        return Weights(
            end=self.end * task.time * per_square,
            tail=self.tail * task.time * per_square,
            clear=self.clear * per_square,
            rough=self.rough * task.time**4,
            slow=self.slow,
            close=self.close * task.length,
        )


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
        Half of the merit's.
    hessian : ndarray, shape (S, Mn, Mn)
        Half of the merit's, Gauss-Newton.
    error, tail, lack : ndarray, shape (S,)
        Distance at T, the largest in the last tenth, and the largest lack of clearance [m]; where an
        attitude is wanted, the angle to it counts if it is larger [rad].
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


def base_turns(spline: RateSpline, omega: FloatArray) -> FloatArray:
    """Base rotations (S, Q + 2, 3, 3) from the start, of angular velocities (S, Q, 3) in base axes."""
    m, g = spline.whole.shape
    omega = omega.reshape(-1, m, g, 3)
    whole = exp3(np.einsum("kg,skgi->ski", spline.whole, omega))
    part = exp3(np.einsum("kij,skjl->skil", spline.part, omega))
    starts = np.empty((len(omega), m + 1, 3, 3))
    starts[:, 0] = np.eye(3)
    for k in range(m):
        np.matmul(starts[:, k], whole[:, k], out=starts[:, k + 1])
    points = (starts[:, :-1, None] @ part).reshape(-1, m * g, 3, 3)
    return np.concatenate([points, starts[:, [spline.late, -1]]], axis=1)


def linearise(task: Task, spline: RateSpline, p: FloatArray, w: Weights) -> Linearisation:
    """Residuals of motions with control points p (S, M, n), squared and linearised."""
    w = w.fitted(task)
    stack, n, size, count, motions = task.arm, task.arm.n, spline.size, spline.points, len(p)
    joints = task.joints0 + spline.travel @ p
    u = (spline.rates @ p)[:, :count]
    # First the quadrature points of all motions, then their two ends, which need no derivatives.
    inner = motions * count
    places = np.concatenate([joints[:, :count].reshape(-1, n), joints[:, count:].reshape(-1, n)])
    arm = stack.evaluate(places)
    slopes = arm_slopes(stack, arm, inner)

    def spread(values: FloatArray) -> FloatArray:
        rest = values.shape[1:]
        first, last = values[:inner].reshape(motions, count, *rest), values[inner:].reshape(motions, 2, *rest)
        return np.concatenate([first, last], axis=1)

    spin, jstar = np.swapaxes(spread(arm.spin), -1, -2), np.swapaxes(spread(arm.jstar), -1, -2)
    rho, rates = spread(arm.rho), u[..., None]
    R = base_turns(spline, (spin[:, :count] @ rates)[..., 0])
    R_inner = R[:, :count]
    tip = (R @ rho[..., None])[..., 0]
    velocity = (R_inner @ (jstar[:, :count] @ rates))[..., 0]
    way = task.goal - tip
    H, H_slope = entropy_and_gradient(arm.coupling[:inner])
    c = cost_residual(
        way[:, :count], velocity, H.reshape(motions, count), task.kappa, task.pace, w.slow, w.close
    )

    # Changes by p, flattened to columns (M n): of the base's rotation, the end effector, its velocity.
    travel, at = spline.travel[:, :, None], spline.rates[:count, :, None]
    held = u[:, :, None, None, :]
    spin_q = (held @ slopes.spin.reshape(motions, count, n, n, 3))[..., 0, :]
    jstar_q = (held @ slopes.jstar.reshape(motions, count, n, n, 3))[..., 0, :]
    spin_q, jstar_q = np.swapaxes(spin_q, -1, -2), np.swapaxes(jstar_q, -1, -2)
    flat = (motions, -1, 3, size * n)
    turn = (R_inner @ spin[:, :count])[..., None, :] * at[:, None]
    turn += (R_inner @ spin_q)[..., None, :] * travel[:count, None]
    turn = (spline.sweep @ turn.reshape(motions, count, -1)).reshape(flat)
    tip_p = ((R @ (jstar + skew(rho) @ spin))[..., None, :] * travel[:, None]).reshape(flat) - skew(
        tip
    ) @ turn
    velocity_p = (R_inner @ jstar[:, :count])[..., None, :] * at[:, None]
    velocity_p += (R_inner @ jstar_q)[..., None, :] * travel[:count, None]
    velocity_p = velocity_p.reshape(flat) - skew(velocity) @ turn[:, :count]
    H_q = (slopes.coupling.reshape(inner, n, -1) @ H_slope.reshape(inner, -1, 1)).reshape(motions, count, n)

    root = np.sqrt(spline.weights)
    cost_p = (c.by_velocity[..., None, :] @ velocity_p + c.by_tip[..., None, :] @ tip_p[:, :count])[..., 0, :]
    by_entropy = (c.by_entropy[..., None] * H_q)[:, :, None, :]
    cost_p += (by_entropy * travel[:count]).reshape(motions, count, -1)

    tail_rows = np.append(np.flatnonzero(spline.times[:count] > spline.times[count]), count)
    tail_way = way[:, tail_rows]
    far = np.sqrt(np.einsum("...i,...i->...", tail_way, tail_way))
    excess = np.maximum(far - AIM_TAIL, 0.0)
    towards = np.where(excess > 0.0, 1.0, 0.0)[..., None] * tail_way / np.maximum(far, 1e-9)[..., None]
    tail_p = -(towards[..., None, :] @ tip_p[:, tail_rows])[..., 0, :]

    # The end: the way beyond AIM_END, as a vector.
    last = way[:, -1]
    error = np.linalg.norm(last, axis=1)
    unit = last / np.maximum(error, 1e-9)[:, None]
    short = np.maximum(error - AIM_END, 0.0)
    share = (short / np.maximum(error, 1e-9))[:, None, None]
    radial = unit[:, :, None] * unit[:, None, :]
    end_map = share * np.eye(3) + (np.where(short > 0.0, 1.0, 0.0)[:, None, None] - share) * radial
    end_p = -end_map @ tip_p[:, -1]

    value = np.concatenate(
        [root * c.value, np.sqrt(w.end) * short[:, None] * unit, np.sqrt(w.tail) * excess], axis=1
    )
    jacobian = np.concatenate(
        [root[:, None] * cost_p, np.sqrt(w.end) * end_p, np.sqrt(w.tail) * tail_p], axis=1
    )
    transposed = np.swapaxes(jacobian, 1, 2)
    rough = spline.roughness @ p
    result = Linearisation(
        merit=np.einsum("si,si->s", value, value) + w.rough * np.einsum("smj,smj->s", p, rough),
        cost=c.exact**2 @ spline.weights,
        gradient=(transposed @ value[..., None])[..., 0] + w.rough * rough.reshape(motions, -1),
        hessian=transposed @ jacobian,
        error=error,
        tail=far.max(axis=1),
        lack=np.zeros(motions),
        way=last,
    )
    blocks = result.hessian.reshape(motions, size, n, size, n)
    for j in range(n):
        blocks[:, :, j, :, j] += w.rough * spline.roughness
    _add_clearances(task, spline, w, places[:inner], arm, result)
    if task.rotation is not None:
        rows = np.append(tail_rows, count + 1)
        columns = np.swapaxes(spread(arm.axes * stack.moves_tip[:, None]), -1, -2)[:, rows]
        turns = turn[:, rows] + ((R[:, rows] @ columns)[..., None, :] * travel[rows][:, None]).reshape(flat)
        attitude = R[:, rows] @ spread(arm.tip_rotation)[:, rows]
        _add_orientation(task.rotation0.T @ task.rotation, w, attitude, turns, result)
    return result


def _add_orientation(
    wanted: FloatArray, w: Weights, attitude: FloatArray, turns: FloatArray, result: Linearisation
) -> None:
    """Squares of the angles to the wanted attitude; the last row is the end, a radian weighs like a metre."""
    for rows, weight, tolerance in ((slice(-1), w.tail, AIM_TAIL), (slice(-1, None), w.end, AIM_END)):
        value, slope, angle = orientation_residual(wanted, attitude[:, rows], turns[:, rows], tolerance)
        result.merit += weight * np.einsum("si,si->s", value, value)
        result.gradient += weight * np.einsum("sip,si->sp", slope, value)
        result.hessian += weight * (np.swapaxes(slope, 1, 2) @ slope)
        furthest = result.tail if rows.stop == -1 else result.error
        np.maximum(furthest, angle.max(axis=1), out=furthest)


def _add_clearances(
    task: Task, spline: RateSpline, w: Weights, places: FloatArray, arm: ArmValues, result: Linearisation
) -> None:
    """Squares of what clearances lack of the asked one and its margin."""
    if task.clearances is None:
        return
    lack = (
        task.clearance + CLEARANCE_MARGIN * task.length - task.clearances.values(places, arm)[: len(places)]
    )
    rows, columns = np.nonzero(lack > 0.0)
    if not rows.size:
        return
    missing = lack[rows, columns]
    gradients = task.clearances.gradients(task.arm, places, arm, rows, columns)
    motion, point = np.divmod(rows, spline.points)
    scale = np.sqrt(w.clear * spline.weights[point])
    slopes = -(spline.travel[point][:, :, None] * gradients[:, None, :]).reshape(len(rows), -1)
    slopes *= scale[:, None]
    values = scale * missing
    np.maximum.at(result.lack, motion, missing)
    for s in np.unique(motion):
        own = slopes[motion == s]
        result.merit[s] += float(values[motion == s] @ values[motion == s])
        result.gradient[s] += own.T @ values[motion == s]
        result.hessian[s] += own.T @ own

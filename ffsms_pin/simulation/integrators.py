"""Integrators of the forward dynamics on the configuration manifold, by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from itertools import count
from typing import Any, TypeAlias, cast

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsError
from ffsms_pin.simulation.events import Force

Step: TypeAlias = tuple[FloatArray, FloatArray, float]

# Limits of the adaptive integrators.
_TOLERANCE = 1e-12  # relative and absolute tolerance of each inner step of DOP853
_MOST_PARTS = 10_000  # largest number of parts of a step; a state that needs more counts as diverged
_MOST_SLOPES = 100_000  # largest number of evaluations in a part; a state that needs more counts as diverged
_REACH = 0.3  # [rad or m] displacement in a part at its initial rates; `_bernoulli` requires a small one

# Yoshida's triple jump: the lengths of three symmetric second-order steps that make a step of order 4.
_OUTER = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
_JUMPS = (_OUTER, 1.0 - 2.0 * _OUTER, _OUTER)
_ITERATIONS = 40  # largest number of quasi-Newton iterations of a second-order step
# [rad/s or m/s] changes below which the iteration may end. The rounding errors of a light wrist on a heavy
# base have this size.
_LARGEST = 1e-10
# Largest relative change that is accepted without convergence. If a force is discontinuous at the edge of a
# contact, the equations may have no solution.
_JUMP = 1e-5


def rk4_step(
    model: Any, data: Any, q: FloatArray, v: FloatArray, tau: Force, dt: float, t: float = 0.0
) -> Step:
    """Make a commutator-free Runge-Kutta step of order 4 of the articulated-body dynamics.

    This is the classical method on the configuration manifold. The stage velocities are in body axes that
    rotate from stage to stage, so a move along their mean has only order 2 in attitude. Two successive moves,
    each along its own combination of the stage velocities, keep order 4 without Lie brackets.

    Parameters
    ----------
    model, data : pinocchio.Model, pinocchio.Data
        The model's joints are free-flyers (the base and possibly a client) or have one degree of freedom.
    q : ndarray, shape (nq,)
        Configuration at the step's start.
    v : ndarray, shape (nv,)
        Velocity at the step's start.
    tau : ndarray, shape (nv,), or callable
        Generalised force, held over the step, or a function of time, configuration and velocity that returns
        the force. The first six entries are zero without an external force on the base.
    dt : float
        Step [s].
    t : float
        Time at the step's start [s], for a force that depends on time.

    Returns
    -------
    q : ndarray, shape (nq,)
        Configuration at the step's end, with a unit quaternion.
    v : ndarray, shape (nv,)
        Velocity at the step's end.
    work : float
        The integral of tau . v over the step [J], by the quadrature of the method.

    References
    ----------
    E. Celledoni, A. Marthinsen, B. Owren, "Commutator-free Lie group methods", Future Generation Computer
    Systems 19 (2003), the method of order 4. Here the later move is the right factor, because velocities are
    in body axes.
    """
    second, third, fourth, end = _weights(dt)
    aba, integrate, rows = pin.aba, pin.integrate, np.empty((5, v.size))
    held: Any = tau  # the generalised force, if it is an array
    force = tau if callable(tau) else None

    rows[0] = v
    # The results of a force function, and the stage velocities v2 to v4 passed to it, are copied, because the
    # function may reuse its result and change its arguments.
    f1 = held if force is None else np.array(force(t, q, v))
    rows[1] = aba(model, data, q, v, f1)

    v2, to_q2, to_q3 = second.dot(rows[:2])
    q2 = integrate(model, q, to_q2)
    f2 = held if force is None else np.array(force(t + 0.5 * dt, q2, v2.copy()))
    rows[2] = aba(model, data, q2, v2, f2)

    v3, from_q2 = third.dot(rows[:3])
    q3 = integrate(model, q, to_q3)
    f3 = held if force is None else np.array(force(t + 0.5 * dt, q3, v3.copy()))
    rows[3] = aba(model, data, q3, v3, f3)

    v4, first_move, second_move, move = fourth.dot(rows[:4])
    q4 = integrate(model, q2, from_q2)
    f4 = held if force is None else np.array(force(t + dt, q4, v4.copy()))
    rows[4] = aba(model, data, q4, v4, f4)

    v_end: FloatArray = end.dot(rows)
    q_end: FloatArray = pin.normalize(model, integrate(model, integrate(model, q, first_move), second_move))
    if force is None:
        work = float(held.dot(move))
    else:
        work = (dt / 6.0) * float(f1 @ v + 2.0 * (f2 @ v2 + f3 @ v3) + f4 @ v4)
    return q_end, v_end, work


@lru_cache(maxsize=64)
def _weights(dt: float) -> tuple[FloatArray, ...]:
    """Return the coefficients of the stages; each row combines v and the accelerations of earlier stages.

    - Second stage: the velocity v2, the move dt / 2 v to q2, and the move dt / 2 v2 to q3.
    - Third stage: the velocity v3, and the move dt v3 - dt / 2 v from q2 to q4.
    - Fourth stage: the velocity v4, the two moves to the end, and their sum.
    - End: the velocity at the end.
    """
    v1, v2, v3, v4 = np.zeros((4, 5))  # coefficients of the stage velocities
    v1[0] = v2[0] = v3[0] = v4[0] = 1.0
    v2[1] = v3[2] = 0.5 * dt
    v4[3] = dt
    half, twelfth = 0.5 * dt, dt / 12.0
    moves = (
        twelfth * (3.0 * v1 + 2.0 * v2 + 2.0 * v3 - v4),
        twelfth * (-v1 + 2.0 * v2 + 2.0 * v3 + 3.0 * v4),
    )
    return (
        np.array([v2, half * v1, half * v2])[:, :2].copy(),
        np.array([v3, dt * v3 - half * v1])[:, :3].copy(),
        np.array([v4, *moves, moves[0] + moves[1]])[:, :4].copy(),
        np.array([1.0, dt / 6.0, dt / 3.0, dt / 3.0, dt / 6.0]),
    )


# A function of model, data, q, v, generalised force, dt and t that returns the next state and the work done.
Integrator: TypeAlias = Callable[..., Step]


class _TooLong(Exception):
    """The solver exceeds the limit of slope evaluations."""


def _by_solver(
    model: Any, data: Any, q: FloatArray, v: FloatArray, tau: Force, dt: float, t: float = 0.0, *, method: str
) -> Step:
    """Make a step by a method of `scipy.integrate.solve_ivp`; arguments as for `rk4_step`.

    The unknowns are the coordinates xi of the chart q(t) = q exp(xi), the velocity and the work. In body axes
    dxi/dt = dexp^-1(-xi) v. The tolerance of each inner step, relative and absolute, is 1e-12, with Radau
    1e-8. If the solver fails, the result is NaN.
    """
    from scipy.integrate import solve_ivp  # slow to load, and this integrator is not the default

    nv = v.size
    parts = max(1, int(np.ceil(float(np.abs(v).max()) * dt / _REACH))) if np.isfinite(v).all() else 1
    if parts > _MOST_PARTS:
        return q * np.nan, v * np.nan, np.nan
    h, work, free = dt / parts, 0.0, _free_flyers(model)
    tolerance = _TOLERANCE if method == "DOP853" else 1e-8

    for k in range(parts):
        start, begin = q, t + k * h
        calls = count()

        def slope(
            s: float, y: FloatArray, start: FloatArray = start, begin: float = begin, calls: Any = calls
        ) -> FloatArray:
            if next(calls) == _MOST_SLOPES:
                raise _TooLong
            xi, velocity = y[:nv], y[nv : 2 * nv]
            place = pin.integrate(model, start, xi)
            force = tau(begin + s, place, velocity) if callable(tau) else tau
            rate = np.empty(2 * nv + 1)
            rate[:nv] = velocity
            for body in free:
                rate[body] = _inverse(xi[body], velocity[body])
            rate[nv : 2 * nv] = pin.aba(model, data, place, velocity, force)
            rate[-1] = force @ velocity
            return rate

        y0 = np.concatenate([np.zeros(nv), v, [0.0]])
        if not np.isfinite(y0).all():
            return q * np.nan, v * np.nan, np.nan
        try:
            done = solve_ivp(slope, (0.0, h), y0, method=method, rtol=tolerance, atol=tolerance, first_step=h)
        except FfsmsError:  # raised by a force
            raise
        # SciPy raises ValueError or LinAlgError if a state is not finite.
        except (_TooLong, ValueError, np.linalg.LinAlgError):
            return q * np.nan, v * np.nan, np.nan
        y = done.y[:, -1] if done.success else np.full(y0.size, np.nan)
        q = pin.normalize(model, pin.integrate(model, start, y[:nv]))
        v = y[nv : 2 * nv]
        work += float(y[-1])
    return q, v, work


def variational_step(
    model: Any, data: Any, q: FloatArray, v: FloatArray, tau: Force, dt: float, t: float = 0.0
) -> Step:
    """Make a step of order 4 of a Lie group variational integrator; arguments as for `rk4_step`.

    The action of a step h is evaluated at the middle of the step, q exp(h v / 2), with a constant velocity v.
    With the kinetic energy T, m = dT/dv at the middle, and the momenta p_0 and p_1 at the ends in body axes,
    the action is stationary if p_0 = dexp^-T(h v) m - h/2 dT/dr and p_1 = dexp^-T(-h v) m + h/2 dT/dr. Here
    dT/dr = C^T v is the derivative with respect to the joints, with the Coriolis matrix C. Without external
    forces, the total momentum about the inertial origin is the same at both ends for every h. The step is
    symmetric, so three steps of Yoshida's lengths make a step of order 4. The step is symplectic, so without
    forces the energy oscillates but does not drift. Forces act at the middle of each step.

    References
    ----------
    N. Bou-Rabee, J. E. Marsden, "Hamilton-Pontryagin integrators on Lie groups", Foundations of Computational
    Mathematics 9 (2009). H. Yoshida, "Construction of higher order symplectic integrators", Physics Letters A
    150 (1990).
    """
    work = 0.0
    for part in _JUMPS:
        h = part * dt
        q, v, done = _second_order(model, data, q, v, tau, h, t)
        t += h
        work += done
    return q, v, work


def _second_order(
    model: Any, data: Any, q: FloatArray, v: FloatArray, tau: Force, h: float, t: float
) -> Step:
    from scipy.linalg.lapack import dposv  # slow to load, and this integrator is not the default

    start = pin.crba(model, data, q) @ v
    u, best, free = v, np.inf, _free_flyers(model)
    for _ in range(_ITERATIONS):
        middle = pin.integrate(model, q, 0.5 * h * u)
        force = tau(t + 0.5 * h, middle, u) if callable(tau) else tau
        M = pin.crba(model, data, middle).copy()
        m = M @ u
        half = 0.5 * h * ((pin.computeCoriolisMatrix(model, data, middle, u).T @ u) + force)
        # The rows of a free-flyer are in body axes at the start; the force acts half a step later.
        residual = start - m + half
        for b in free:
            half[b] = 0.5 * h * force[b]
            there = pin.exp6(pin.Motion(0.5 * h * u[b]))
            residual[b] = start[b] + there.act(pin.Force(half[b])).vector - _dual(h * u[b], m[b])
        _, change, _ = dposv(M, residual)
        u = u + change
        size = float(np.abs(change).max())
        # Iterate down to rounding. The first changes may grow, because base and wrist differ greatly in mass.
        if size < _LARGEST and not size < 0.5 * best:
            break
        best = size
    else:
        if not best < _JUMP * (1.0 + float(np.abs(u).max())):
            u = u * np.nan  # the step is far too large, and the simulation raises an error for NaN
    end = m + half
    for b in free:  # transport the initial momentum, so that the total momentum is constant to rounding
        whole, there = pin.exp6(pin.Motion(h * u[b])), pin.exp6(pin.Motion(0.5 * h * u[b]))
        end[b] = whole.actInv(pin.Force(start[b])).vector
        end[b] += whole.actInv(there.act(pin.Force(2.0 * half[b]))).vector
    q_end: FloatArray = pin.normalize(model, pin.integrate(model, q, h * u))
    _, v_end, _ = dposv(pin.crba(model, data, q_end), end)
    return q_end, v_end, h * float(force @ u)


def extrapolated_step(
    model: Any,
    data: Any,
    q: FloatArray,
    v: FloatArray,
    tau: Force,
    dt: float,
    t: float = 0.0,
    *,
    slopes: Callable[[FloatArray], FloatArray],
    closed: bool = False,
    locked: tuple[int, ...] = (),
) -> Step:
    """Make one step with steep friction by linearly implicit Euler steps, extrapolated to at most order 5.

    The friction of each velocity is linearised with its slope -d. With D = diag(d), the inertia matrix M and
    the nonlinear effects b, a step h solves (M + h D) dv = h (tau - b), which is stable for any friction. A
    step is halved if its two best extrapolations differ by more than 1e-6 rad/s or m/s. After 14 halvings the
    best extrapolation is accepted.

    Parameters
    ----------
    model, data, q, v, tau, dt, t
        Arguments of `rk4_step`.
    slopes : callable
        A function that returns d (nv,) [N m s/rad or N s/m], each at least zero, at velocities v (nv,).
    closed : bool
        True if no external force acts on the robot. The base's velocity is then corrected so that the total
        momentum is constant to rounding.
    locked : tuple of int
        Indices in v of locked joints, whose rates stay zero. `tau` does not include the locks' torques.

    References
    ----------
    P. Deuflhard, "Recent progress in extrapolation methods for ordinary differential equations", SIAM Review
    27 (1985); E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 2nd ed., 1996, IV.9.
    """
    if not np.isfinite(v).all():
        return q * np.nan, v * np.nan, np.nan
    work, left, at = 0.0, [(dt, 0)], t
    while left:
        h, halved = left.pop()
        step = _extrapolated(model, data, q, v, tau, h, at, slopes, locked, halved >= _MOST_HALVED)
        if step is None:
            left += [(0.5 * h, halved + 1)] * 2
            continue
        q_end, v_end, done = step
        if not np.isfinite(v_end).all():
            return q * np.nan, v * np.nan, np.nan
        if closed:
            v_end = _with_momentum(model, data, q, v, q_end, v_end)
        q, v, work, at = pin.normalize(model, q_end), v_end, work + done, at + h
    return q, v, work


_ROWS = (1, 2, 3, 4, 5)  # numbers of linearly implicit steps that are extrapolated
_SMALL, _MOST_HALVED = 1e-6, 14  # [rad/s or m/s] tolerance; largest number of halvings


def _extrapolated(
    model: Any,
    data: Any,
    q: FloatArray,
    v: FloatArray,
    tau: Force,
    h: float,
    t: float,
    slopes: Callable[[FloatArray], FloatArray],
    locked: tuple[int, ...],
    last: bool,
) -> Step | None:
    """Return the extrapolated step; None if its error is too large, unless it is the `last` attempt."""
    nv = v.size
    before: list[FloatArray] = []
    first = _linearised(model, data, q, v, tau, t, slopes)  # the same in all rows
    for j, count_ in enumerate(_ROWS):
        steps = h / count_, count_
        q_end, v_end, work = _linearly_implicit(model, data, q, v, tau, *steps, t, slopes, locked, first)
        if not np.isfinite(v_end).all():
            return q_end, v_end, work
        row = [np.concatenate([pin.difference(model, q, q_end), v_end, [work]])]
        for k in range(1, j + 1):
            row.append(row[-1] + (row[-1] - before[k - 1]) / (count_ / _ROWS[j - k] - 1.0))
        error = np.inf if j < 2 else float(np.abs(row[-1] - row[-2])[nv : 2 * nv].max())
        if error <= _SMALL or (last and count_ == _ROWS[-1]):
            return pin.integrate(model, q, row[-1][:nv]), row[-1][nv : 2 * nv], float(row[-1][-1])
        if j >= 2 and error > 1e3 * _SMALL and not last:
            return None  # the remaining rows would not suffice
        before = row
    return None


def _linearly_implicit(
    model: Any,
    data: Any,
    q: FloatArray,
    v: FloatArray,
    tau: Force,
    h: float,
    count_: int,
    t: float,
    slopes: Callable[[FloatArray], FloatArray],
    locked: tuple[int, ...],
    first: tuple[FloatArray, ...],
) -> Step:
    """Return the state after `count_` linearly implicit Euler steps of h, and the work done."""
    work = 0.0
    for k in range(count_):
        M, b, force, d = _linearised(model, data, q, v, tau, t + k * h, slopes) if k else first
        A, change = M + h * np.diag(d), h * (force - b)
        for i in locked:
            A[i], A[:, i], A[i, i], change[i] = 0.0, 0.0, 1.0, 0.0
        _, dv, failed = _solver()(A, change)
        if failed:
            return q * np.nan, v * np.nan, np.nan
        v = v + dv
        q = pin.integrate(model, q, h * v)
        work += h * float((force - d * dv) @ v)
    return q, v, work


def _linearised(
    model: Any,
    data: Any,
    q: FloatArray,
    v: FloatArray,
    tau: Force,
    t: float,
    slopes: Callable[[FloatArray], FloatArray],
) -> tuple[FloatArray, ...]:
    """Return inertia matrix, nonlinear effects, generalised force and friction slopes."""
    force = tau(t, q, v) if callable(tau) else tau
    return pin.crba(model, data, q).copy(), pin.nonLinearEffects(model, data, q, v).copy(), force, slopes(v)


@lru_cache(maxsize=1)
def _solver() -> Callable[..., Any]:
    from scipy.linalg.lapack import dposv  # slow to load, and few runs need it

    return cast("Callable[..., Any]", dposv)


def _with_momentum(
    model: Any, data: Any, q: FloatArray, v: FloatArray, q_end: FloatArray, v_end: FloatArray
) -> FloatArray:
    """Return v_end with a base velocity for which the total momentum equals that of q and v."""
    before = pin.crba(model, data, q)[:6] @ v
    H = pin.crba(model, data, q_end)[:6]
    start, end = (pin.XYZQUATToSE3(place[:7]) for place in (q, q_end))
    momentum = end.actInv(start.act(pin.Force(before))).vector
    kept: FloatArray = v_end.copy()
    kept[:6] += np.linalg.solve(H[:, :6], momentum - H @ v_end)
    return kept


def _free_flyers(model: Any) -> list[slice]:
    """Return the slices of v of the free-flyers: the base and, in a run with a free client, the client."""
    return [slice(joint.idx_v, joint.idx_v + 6) for joint in model.joints if joint.nv == 6]


def _inverse(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return dexp^-1(-x) y of a velocity y."""
    motion = pin.Motion(x)
    return _bernoulli(lambda z: motion.cross(pin.Motion(z)).vector, y)


def _dual(x: FloatArray, m: FloatArray) -> FloatArray:
    """Return dexp^-T(x) m of a momentum m."""
    motion = pin.Motion(x)
    return _bernoulli(lambda z: motion.cross(pin.Force(z)).vector, m)


def _bernoulli(ad: Callable[[FloatArray], FloatArray], y: FloatArray) -> FloatArray:
    """Apply ad / (1 - exp(-ad)) to y by its series up to ad^8, with an error of about 2e-8 |ad|^10."""
    result, power = y, y
    for factor in (0.5, 1.0 / 12.0, 0.0, -1.0 / 720.0, 0.0, 1.0 / 30240.0, 0.0, -1.0 / 1209600.0):
        power = ad(power)
        result = result + factor * power
    return result


# The method of Dormand and Prince of order 8, and the implicit method Radau IIA of order 5.
adaptive_step: Integrator = partial(_by_solver, method="DOP853")
stiff_step: Integrator = partial(_by_solver, method="Radau")

INTEGRATORS: dict[str, Integrator] = {
    "rk4": rk4_step,
    "variational": variational_step,
    "adaptive": adaptive_step,
    "stiff": stiff_step,
}

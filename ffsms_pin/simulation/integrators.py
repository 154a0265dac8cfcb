"""The integrators of the forward dynamics by name; all work on the configuration manifold."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import count
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsError
from ffsms_pin.simulation.events import Force
from ffsms_pin.simulation.runge_kutta import rk4_step

# Of the adaptive ones.
_TOLERANCE = 1e-12
_MOST_PARTS = 10_000  # of a step; a state that asks for more is on its way to infinity
_MOST_SLOPES = 100_000  # of a part, likewise
_REACH = 0.3  # [rad or m] farther than this the chart is moved, for the series below

# Fourth order from the symmetric second-order step: Yoshida's triple jump.
_OUTER = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
_JUMPS = (_OUTER, 1.0 - 2.0 * _OUTER, _OUTER)
_ITERATIONS = 40
# Relative: a change this small may be rounding, which a light wrist on a heavy base enlarges.
_LARGEST = 1e-10


class _TooLong(Exception):
    """The solver asks for ever more slopes."""


def _by_solver(
    model: Any, data: Any, q: FloatArray, v: FloatArray, tau: Force, dt: float, t: float = 0.0, *, method: str
) -> tuple[FloatArray, FloatArray, float]:
    """One step by a method of `scipy.integrate.solve_ivp`; as for `rk4_step`, at any dt.

    The unknowns are the chart's xi in q(t) = q exp(xi), the velocity and the work. In body axes dxi/dt =
    dexp^-1(-xi) v. The error of each inner step is kept below 1e-12, relative and absolute, with Radau 1e-8.
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
        asked = count()

        def slope(
            s: float, y: FloatArray, start: FloatArray = start, begin: float = begin, asked: Any = asked
        ) -> FloatArray:
            if next(asked) == _MOST_SLOPES:
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
        except FfsmsError:  # of a force
            raise
        except (_TooLong, ValueError, np.linalg.LinAlgError):  # the latter two where a state is not finite
            return q * np.nan, v * np.nan, np.nan
        y = done.y[:, -1] if done.success else np.full(y0.size, np.nan)
        q = pin.normalize(model, pin.integrate(model, start, y[:nv]))
        v = y[nv : 2 * nv]
        work += float(y[-1])
    return q, v, work


def variational_step(
    model: Any, data: Any, q: FloatArray, v: FloatArray, tau: Force, dt: float, t: float = 0.0
) -> tuple[FloatArray, FloatArray, float]:
    """One step of order 4 of a Lie group variational integrator; arguments and results as for `rk4_step`.

    The action of a step h is taken at its middle, q exp(h v / 2), with a constant velocity v. With T the
    kinetic energy, m = dT/dv there, and p the momentum in body axes at the ends, its stationarity says
    p_0 = dexp^-T(h v) m - h/2 dT/dr and p_1 = dexp^-T(-h v) m + h/2 dT/dr, where dT/dr is by the joints:
    C^T v with the Coriolis matrix C. The total momentum in inertial axes, about the inertial origin, is the
    same at both ends, whatever h. The step is symmetric, so three of them make one of order 4; it is
    symplectic, so without forces the energy oscillates but does not drift. Forces act at the middle of each
    step.

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
) -> tuple[FloatArray, FloatArray, float]:
    start = pin.crba(model, data, q) @ v
    u, best, free = v, np.inf, _free_flyers(model)
    for _ in range(_ITERATIONS):
        middle = pin.integrate(model, q, 0.5 * h * u)
        force = tau(t + 0.5 * h, middle, u) if callable(tau) else tau
        M = pin.crba(model, data, middle).copy()
        m = M @ u
        half = 0.5 * h * ((pin.computeCoriolisMatrix(model, data, middle, u).T @ u) + force)
        # Equations at the start, in body axes there; the force is at the middle, half a step away.
        residual = start - m + half
        for b in free:
            half[b] = 0.5 * h * force[b]
            there = pin.exp6(pin.Motion(0.5 * h * u[b]))
            residual[b] = start[b] + there.act(pin.Force(half[b])).vector - _dual(h * u[b], m[b])
        _, change, _ = lapack.dposv(M, residual)
        u = u + change
        size = float(np.abs(change).max())
        # Until rounding is reached: the first changes need not shrink, base and wrist differ so much in size.
        if size < _LARGEST and not size < 0.5 * best:
            break
        best = size
    else:
        if not best < _LARGEST * (1.0 + float(np.abs(u).max())):
            u = u * np.nan  # far too large a step: the simulation will say so
    end = m + half
    for b in free:  # by transport of what was there, so that the total momentum is kept to rounding
        whole, there = pin.exp6(pin.Motion(h * u[b])), pin.exp6(pin.Motion(0.5 * h * u[b]))
        end[b] = whole.actInv(pin.Force(start[b])).vector
        end[b] += whole.actInv(there.act(pin.Force(2.0 * half[b]))).vector
    q_end: FloatArray = pin.normalize(model, pin.integrate(model, q, h * u))
    _, v_end, _ = lapack.dposv(pin.crba(model, data, q_end), end)
    return q_end, v_end, h * float(force @ u)


def _free_flyers(model: Any) -> list[slice]:
    """Places in v of the bodies that move freely: the base, and a client where it is one."""
    return [slice(joint.idx_v, joint.idx_v + 6) for joint in model.joints if joint.nv == 6]


def _inverse(x: FloatArray, y: FloatArray) -> FloatArray:
    """dexp^-1(-x) y of velocities, to 1e-14 for |x| < 0.5."""
    motion = pin.Motion(x)
    return _bernoulli(lambda z: motion.cross(pin.Motion(z)).vector, y)


def _dual(x: FloatArray, m: FloatArray) -> FloatArray:
    """Transpose of dexp^-1 of x applied to a momentum m, likewise."""
    motion = pin.Motion(x)
    return _bernoulli(lambda z: motion.cross(pin.Force(z)).vector, m)


def _bernoulli(ad: Callable[[FloatArray], FloatArray], y: FloatArray) -> FloatArray:
    """What ad / (1 - exp(-ad)) makes of y, by its series."""
    result, power = y, y
    for factor in (0.5, 1.0 / 12.0, 0.0, -1.0 / 720.0, 0.0, 1.0 / 30240.0, 0.0, -1.0 / 1209600.0):
        power = ad(power)
        result = result + factor * power
    return result


class Integrator(Protocol):
    """One step of the forward dynamics: see `rk4_step`."""

    def __call__(
        self, model: Any, data: Any, q: FloatArray, v: FloatArray, tau: Force, dt: float, t: float = 0.0
    ) -> tuple[FloatArray, FloatArray, float]:
        """State after the step, and the work done in it."""


# Dormand and Prince's method of order 8, and for steep friction the implicit Radau IIA of order 5.
adaptive_step: Integrator = partial(_by_solver, method="DOP853")
stiff_step: Integrator = partial(_by_solver, method="Radau")

INTEGRATORS: dict[str, Integrator] = {
    "rk4": rk4_step,
    "variational": variational_step,
    "adaptive": adaptive_step,
    "stiff": stiff_step,
}

"""A variational integrator on the configuration manifold: momentum to rounding, energy without drift."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from ffsms_pin.checks import FloatArray
from ffsms_pin.simulation.disturbances import GeneralisedForce

__all__ = ["variational_step"]

# Fourth order from the symmetric second-order step: Yoshida's triple jump.
_OUTER = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
_JUMPS = (_OUTER, 1.0 - 2.0 * _OUTER, _OUTER)
_ITERATIONS = 40
_LARGEST = (
    1e-10  # relative: a change this small may be rounding, which a light wrist on a heavy base enlarges
)


def variational_step(
    model: Any,
    data: Any,
    q: FloatArray,
    v: FloatArray,
    tau: FloatArray | GeneralisedForce,
    dt: float,
    t: float = 0.0,
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
    model: Any,
    data: Any,
    q: FloatArray,
    v: FloatArray,
    tau: FloatArray | GeneralisedForce,
    h: float,
    t: float,
) -> tuple[FloatArray, FloatArray, float]:
    start = pin.crba(model, data, q) @ v
    u, best = v, np.inf
    for _ in range(_ITERATIONS):
        middle = pin.integrate(model, q, 0.5 * h * u)
        force = tau(t + 0.5 * h, middle, u) if callable(tau) else tau
        M = pin.crba(model, data, middle).copy()
        m = M @ u
        half = 0.5 * h * ((pin.computeCoriolisMatrix(model, data, middle, u).T @ u) + force)
        half[:6] = 0.5 * h * force[:6]
        # Equations at the start, in body axes there; the force is at the middle, half a step away.
        residual = start - m
        residual[6:] += half[6:]
        there = pin.exp6(pin.Motion(0.5 * h * u[:6]))
        residual[:6] = start[:6] + there.act(pin.Force(half[:6])).vector - _dual(h * u[:6], m[:6])
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
    whole = pin.exp6(pin.Motion(h * u[:6]))
    end = m + half
    # By transport of what was there, so that the total momentum is kept to rounding.
    end[:6] = whole.actInv(pin.Force(start[:6])).vector
    end[:6] += whole.actInv(there.act(pin.Force(2.0 * half[:6]))).vector
    q_end: FloatArray = pin.normalize(model, pin.integrate(model, q, h * u))
    _, v_end, _ = lapack.dposv(pin.crba(model, data, q_end), end)
    return q_end, v_end, h * float(force @ u)


def _dual(x: FloatArray, m: FloatArray) -> FloatArray:
    """Transpose of dexp^-1 of x applied to a momentum m: the Bernoulli series, to rounding for |x| < 0.1."""
    motion = pin.Motion(x)

    def ad(y: FloatArray) -> FloatArray:  # transpose of the bracket [x, .]
        bracket: FloatArray = -motion.cross(pin.Force(y)).vector
        return bracket

    one = ad(m)
    two = ad(one)
    four = ad(ad(two))
    result: FloatArray = m - 0.5 * one + two / 12.0 - four / 720.0 + ad(ad(four)) / 30240.0
    return result

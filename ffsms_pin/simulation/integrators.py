"""Integration of the forward dynamics on the configuration manifold."""

from __future__ import annotations

from typing import Any

import pinocchio as pin

from ffsms_pin.checks import FloatArray

__all__ = ["rk4_step"]


def rk4_step(
    model: Any, data: Any, q: FloatArray, v: FloatArray, tau: FloatArray, dt: float
) -> tuple[FloatArray, FloatArray, float]:
    """One Runge-Kutta-Munthe-Kaas step of order 4 of the forward dynamics (articulated-body algorithm).

    The classical method in the chart q(t) = q(0) exp(xi), with the two brackets that keep its order in
    attitude too: stage velocities belong to body axes that have turned, and merely adding them up leaves
    order 2. (Pinocchio's `Jlog6` would do the same, but is off by up to 1e-8 for small xi.)

    Parameters
    ----------
    model, data : pinocchio.Model, pinocchio.Data
        The model's first joint is a free-flyer, every other joint has one degree of freedom.
    q : ndarray, shape (nq,)
    v : ndarray, shape (nv,)
    tau : ndarray, shape (nv,)
        Generalised force, held over the step; for a floating system the first six are zero.
    dt : float
        [s]

    Returns
    -------
    q : ndarray, shape (nq,)
        With its quaternion of unit length.
    v : ndarray, shape (nv,)
    work : float
        Integral of tau . v over the step [J], by the same quadrature.

    References
    ----------
    H. Munthe-Kaas, B. Owren, "Computations in a free Lie algebra", Philosophical Transactions of the Royal
    Society A 357 (1999); the brackets' signs are those of velocities in body axes.
    """
    half, sixth = 0.5 * dt, dt / 6.0
    a1 = pin.aba(model, data, q, v, tau).copy()

    v2 = v + half * a1
    a2 = pin.aba(model, data, pin.integrate(model, q, half * v), v2, tau).copy()

    v3 = v + half * a2
    xi = half * v2
    xi[:6] += (0.125 * dt * dt) * _bracket(v, v2)
    a3 = pin.aba(model, data, pin.integrate(model, q, xi), v3, tau).copy()

    v4 = v + dt * a3
    a4 = pin.aba(model, data, pin.integrate(model, q, dt * v3), v4, tau)

    total = v + 2.0 * (v2 + v3) + v4
    xi = sixth * total
    xi[:6] += (dt * dt / 12.0) * _bracket(v, v4)
    q_end: FloatArray = pin.normalize(model, pin.integrate(model, q, xi))
    v_end: FloatArray = v + sixth * (a1 + 2.0 * (a2 + a3) + a4)
    return q_end, v_end, sixth * float(tau @ total)


def _bracket(a: FloatArray, b: FloatArray) -> FloatArray:
    """Lie bracket of two base velocities; the joints move along fixed axes and have none."""
    bracket: FloatArray = pin.Motion(a[:6]).cross(pin.Motion(b[:6])).vector
    return bracket

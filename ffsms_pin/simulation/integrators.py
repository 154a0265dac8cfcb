"""Integration of the forward dynamics on the configuration manifold."""

from __future__ import annotations

from typing import Any, Protocol

import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.simulation.adaptive import adaptive_step, stiff_step
from ffsms_pin.simulation.disturbances import GeneralisedForce
from ffsms_pin.simulation.variational import variational_step

__all__ = ["INTEGRATORS", "Integrator", "integrator", "rk4_step"]


class Integrator(Protocol):
    """One step of the forward dynamics: see `rk4_step`."""

    def __call__(
        self,
        model: Any,
        data: Any,
        q: FloatArray,
        v: FloatArray,
        tau: FloatArray | GeneralisedForce,
        dt: float,
        t: float = 0.0,
    ) -> tuple[FloatArray, FloatArray, float]:
        """State after the step, and the work done in it."""


def rk4_step(
    model: Any,
    data: Any,
    q: FloatArray,
    v: FloatArray,
    tau: FloatArray | GeneralisedForce,
    dt: float,
    t: float = 0.0,
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
    tau : ndarray, shape (nv,), or callable
        Generalised force, held over the step, or a function of time, configuration and velocity that gives
        it; the first six are zero where nothing acts on the base from outside.
    dt : float
        [s]
    t : float
        Time at the step's start [s], for a force that depends on it.

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
    half = 0.5 * dt
    # Stage velocities are v, v + p1, v + p2 and v + p3; what Pinocchio returns changes with its next call.
    f1 = tau(t, q, v) if callable(tau) else tau
    p1 = half * pin.aba(model, data, q, v, f1)

    v2 = v + p1
    q2 = pin.integrate(model, q, half * v)
    f2 = tau(t + half, q2, v2) if callable(tau) else tau
    p2 = half * pin.aba(model, data, q2, v2, f2)

    v3 = v + p2
    xi = half * v2
    # Brackets of two base velocities, [v, v + p] = [v, p]; the joints move along fixed axes and have none.
    bracket = pin.Motion(v[:6]).action
    xi[:6] += bracket.dot((0.125 * dt * dt) * p1[:6])
    q3 = pin.integrate(model, q, xi)
    f3 = tau(t + half, q3, v3) if callable(tau) else tau
    p3 = dt * pin.aba(model, data, q3, v3, f3)

    v4 = v + p3
    q4 = pin.integrate(model, q, dt * v3)
    f4 = tau(t + dt, q4, v4) if callable(tau) else tau
    a4 = pin.aba(model, data, q4, v4, f4)

    # The weights 1, 2, 2, 1 of the classical method, v taken out.
    p12 = p1 + p2
    mean = v + (p12 + 0.5 * p3) / 3.0
    xi = dt * mean
    xi[:6] += bracket.dot((dt * dt / 12.0) * p3[:6])
    q_end: FloatArray = pin.normalize(model, pin.integrate(model, q, xi))
    v_end: FloatArray = v + (p12 + (p2 + p3) + half * a4) / 3.0
    if callable(tau):
        return q_end, v_end, (dt / 6.0) * float(f1 @ v + 2.0 * (f2 @ v2 + f3 @ v3) + f4 @ v4)
    return q_end, v_end, dt * float(tau.dot(mean))


INTEGRATORS: dict[str, Integrator] = {
    "rk4": rk4_step,
    "variational": variational_step,
    "adaptive": adaptive_step,
    "stiff": stiff_step,
}


def integrator(name: str) -> Integrator:
    """The integrator of that name; `InvalidValue` lists those that there are."""
    try:
        return INTEGRATORS[name]
    except (KeyError, TypeError):
        raise InvalidValue("integrator", name, f"must be one of {', '.join(INTEGRATORS)}") from None

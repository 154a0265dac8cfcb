"""Integration of the forward dynamics on the configuration manifold."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
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
    half_dt, second, third, fourth, end = _weights(dt)
    # v and the four accelerations: every stage is one product with the rows that there are so far.
    rows = np.empty((5, v.size))
    rows[0] = v
    half = 0.5 * dt

    f1 = tau(t, q, v) if callable(tau) else tau
    rows[1] = pin.aba(model, data, q, v, f1)
    # ABA leaves the base's velocity behind. Brackets of two such velocities, [v, v + p] = [v, p]; the joints
    # move along fixed axes and have none.
    bracket = data.v[1].action

    stage = second.dot(rows[:2])
    v2, xi, turning = stage[0], stage[1], stage[2]
    q2 = pin.integrate(model, q, v * half_dt)
    f2 = tau(t + half, q2, v2) if callable(tau) else tau
    rows[2] = pin.aba(model, data, q2, v2, f2)

    base = xi[:6]
    base += bracket.dot(turning[:6])
    stage = third.dot(rows[:3])
    v3 = stage[0]
    q3 = pin.integrate(model, q, xi)
    f3 = tau(t + half, q3, v3) if callable(tau) else tau
    rows[3] = pin.aba(model, data, q3, v3, f3)

    v4 = fourth.dot(rows[:4])
    q4 = pin.integrate(model, q, stage[1])
    f4 = tau(t + dt, q4, v4) if callable(tau) else tau
    rows[4] = pin.aba(model, data, q4, v4, f4)

    stage = end.dot(rows)
    v_end, xi, turning = stage[0], stage[1], stage[2]
    if callable(tau):
        work = (dt / 6.0) * float(f1 @ v + 2.0 * (f2 @ v2 + f3 @ v3) + f4 @ v4)
    else:
        work = float(tau.dot(xi))  # dt times the mean velocity, before the bracket
    base = xi[:6]
    base += bracket.dot(turning[:6])
    q_end: FloatArray = pin.normalize(model, pin.integrate(model, q, xi))
    return q_end, v_end, work


class _Weights(NamedTuple):
    """What the stages are made of: every row gives a combination of v and the accelerations so far."""

    half_dt: FloatArray  # an array of no dimension, which numpy multiplies by faster than by a number
    second: FloatArray  # v2; dt / 2 times it; what the bracket of q3 is of
    third: FloatArray  # v3; dt times it
    fourth: FloatArray  # v4
    end: FloatArray  # velocity at the end; dt times the mean velocity; what the bracket of the end is of


@lru_cache(maxsize=64)
def _weights(dt: float) -> _Weights:
    half = 0.5 * dt
    sixth = dt / 6.0
    return _Weights(
        half_dt=np.array(half),
        second=np.array([[1.0, half], [half, half * half], [0.0, 0.125 * dt * dt * half]]),
        third=np.array([[1.0, 0.0, half], [dt, 0.0, dt * half]]),
        fourth=np.array([1.0, 0.0, 0.0, dt]),
        end=np.array(
            [
                [1.0, sixth, 2.0 * sixth, 2.0 * sixth, sixth],
                [dt, dt * sixth, dt * sixth, dt * sixth, 0.0],
                [0.0, 0.0, 0.0, dt * dt / 12.0 * dt, 0.0],
            ]
        ),
    )


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

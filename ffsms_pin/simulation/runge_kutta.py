"""One Runge-Kutta step of order 4 of the forward dynamics on the configuration manifold."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.simulation.events import Force


def rk4_step(
    model: Any, data: Any, q: FloatArray, v: FloatArray, tau: Force, dt: float, t: float = 0.0
) -> tuple[FloatArray, FloatArray, float]:
    """One commutator-free Runge-Kutta step of order 4 of the forward dynamics (articulated-body algorithm).

    The classical method, carried along the configuration manifold. Stage velocities belong to body axes that
    have turned, and merely adding them up leaves order 2 in attitude; two moves one after the other, each
    along its own mean of the stage velocities, keep order 4 without Lie brackets.

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
    E. Celledoni, A. Marthinsen, B. Owren, "Commutator-free Lie group methods", Future Generation Computer
    Systems 19 (2003), the method of order 4; the later move stands to the right, as velocities in body axes
    do.
    """
    second, third, fourth, end = _weights(dt)
    aba, integrate, rows = pin.aba, pin.integrate, np.empty((5, v.size))
    held: Any = tau  # where it is an array
    force = tau if callable(tau) else None

    rows[0] = v
    # A force gets copies, and what it gives is copied: both sides may keep and change their arrays.
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


class _Weights(NamedTuple):
    """What the stages are made of: every row gives a combination of v and the accelerations so far."""

    second: FloatArray  # v2; the move to q2, dt / 2 v; the move to q3, dt / 2 v2
    third: FloatArray  # v3; the move from q2 to q4, dt v3 - dt / 2 v
    fourth: FloatArray  # v4; the two moves to the end; dt times the mean velocity
    end: FloatArray  # the velocity at the end


@lru_cache(maxsize=64)
def _weights(dt: float) -> _Weights:
    v1, v2, v3, v4 = np.zeros((4, 5))  # the stages' velocities, of v and the accelerations
    v1[0] = v2[0] = v3[0] = v4[0] = 1.0
    v2[1] = v3[2] = 0.5 * dt
    v4[3] = dt
    half, twelfth = 0.5 * dt, dt / 12.0
    moves = (
        twelfth * (3.0 * v1 + 2.0 * v2 + 2.0 * v3 - v4),
        twelfth * (-v1 + 2.0 * v2 + 2.0 * v3 + 3.0 * v4),
    )
    return _Weights(
        second=np.array([v2, half * v1, half * v2])[:, :2].copy(),
        third=np.array([v3, dt * v3 - half * v1])[:, :3].copy(),
        fourth=np.array([v4, *moves, moves[0] + moves[1]])[:, :4].copy(),
        end=np.array([1.0, dt / 6.0, dt / 3.0, dt / 3.0, dt / 6.0]),
    )

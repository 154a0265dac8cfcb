"""Adaptive integration: scipy's solvers in a chart of the configuration manifold."""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsError
from ffsms_pin.simulation.disturbances import GeneralisedForce

__all__ = ["adaptive_step", "stiff_step"]

_TOLERANCE = 1e-12
_MOST_PARTS = 10_000  # of a step; a state that asks for more is on its way to infinity
_MOST_SLOPES = 100_000  # of a part, likewise
_REACH = 0.3  # [rad or m] farther than this the chart is moved, for the series below


def adaptive_step(
    model: Any,
    data: Any,
    q: FloatArray,
    v: FloatArray,
    tau: FloatArray | GeneralisedForce,
    dt: float,
    t: float = 0.0,
) -> tuple[FloatArray, FloatArray, float]:
    """One step by Dormand and Prince's method of order 8 (DOP853); as for `rk4_step`, at any dt.

    The unknowns are the chart's xi in q(t) = q exp(xi), the velocity and the work. In body axes dxi/dt =
    dexp^-1(-xi) v. The error of each inner step is kept below 1e-12, relative and absolute.
    """
    return _step(model, data, q, v, tau, dt, t, "DOP853")


def stiff_step(
    model: Any,
    data: Any,
    q: FloatArray,
    v: FloatArray,
    tau: FloatArray | GeneralisedForce,
    dt: float,
    t: float = 0.0,
) -> tuple[FloatArray, FloatArray, float]:
    """The same by the implicit Radau IIA method of order 5: for steep friction. Errors below 1e-8."""
    return _step(model, data, q, v, tau, dt, t, "Radau")


class _TooLong(Exception):
    """The solver asks for ever more slopes."""


def _step(
    model: Any, data: Any, q: FloatArray, v: FloatArray, tau: Any, dt: float, t: float, method: str
) -> tuple[FloatArray, FloatArray, float]:
    from scipy.integrate import solve_ivp  # slow to load, and this integrator is not the default

    nv = v.size
    parts = max(1, int(np.ceil(float(np.abs(v).max()) * dt / _REACH))) if np.isfinite(v).all() else 1
    if parts > _MOST_PARTS:
        return q * np.nan, v * np.nan, np.nan
    h, work = dt / parts, 0.0
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
            rate[:6] = _inverse(xi[:6], velocity[:6])
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


def _inverse(x: FloatArray, y: FloatArray) -> FloatArray:
    """dexp^-1(-x) y by the Bernoulli series, to 1e-14 for |x| < 0.5."""
    motion = pin.Motion(x)

    def ad(z: FloatArray) -> FloatArray:
        bracket: FloatArray = motion.cross(pin.Motion(z)).vector
        return bracket

    one = ad(y)
    two = ad(one)
    four = ad(ad(two))
    six = ad(ad(four))
    result: FloatArray = y + 0.5 * one + two / 12.0 - four / 720.0 + six / 30240.0 - ad(ad(six)) / 1209600.0
    return result

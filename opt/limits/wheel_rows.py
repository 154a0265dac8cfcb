"""Rows of a step that keep the wheels within their momenta and torques while they hold the attitude.

With D the angular momentum a joint rate (`opt.motion.actuated`), b its part of the rate of D u that
belongs to the joint rates alone, u_0 the joint rates at the step's start and u those at its end,

    h = h_total - A^+ (D + dt D') u,    h' = -A^+ (D (u - u_0) / dt + b),    D' u_0 = b:

both linear in u. What changes of D within the step beyond that is of order dt^2.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows
from ffsms_pin.opt.limits.rate_bounds import rate_bounds
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.opt.motion.actuated import wheel_shares

__all__ = ["held_reaction", "reachable", "wheel_rows"]

_UNMOVED = 1e-12  # [N m s/(rad/s)] joints that move a wheel by less do not move it
_ROOM = 1e-3  # share of what the joints can do that a row leaves them at least
_PARALLEL = 1e-9  # rows whose cosine is so near to one are the same


def held_reaction(step: StepState) -> tuple[FloatArray, FloatArray]:
    """D (3, n), and b (3,), of a step in a mode that holds the attitude; root axes [N m s, N m]."""
    sms = step.sms
    model, data = sms.model, sms.model.createData()
    velocity = np.concatenate([step.reaction @ step.rates + step.drift, step.rates])
    # About the system's centre of mass, so it does not matter how the base's place is accelerated.
    rate = pin.computeCentroidalMomentumTimeVariation(model, data, step.q, velocity, np.zeros(model.nv))
    momentum = step.M[:6, :6] @ step.reaction + step.M[:6, 6:]
    com = np.array([step.M[1, 5], step.M[2, 3], step.M[0, 4]]) / step.M[0, 0]
    about_com = momentum[3:] - np.cross(com, momentum[:3], axisb=0, axisc=0)
    to_root = pin.Quaternion(step.q[3:7]).toRotationMatrix().T
    return about_com, to_root @ rate.angular


def wheel_rows(step: StepState, in_hand: float) -> Rows | None:
    """Rows in rad/s, of unit length, one a wheel; None where no wheels hold the attitude, or none is moved.

    A wheel's momentum and its torque are bounds on the same sum of joint rates. Where both cannot be kept,
    the motor's torque is; where the joints' own limits leave no way to keep that, they come first, and the
    row asks for what comes nearest. Wheels that feel the same sum, as all do that a planar arm moves, share
    a row.

    Parameters
    ----------
    step : StepState
    in_hand : float
        Share of the limits that is kept.
    """
    wheels = step.wheels
    if wheels is None:
        return None
    D, b = held_reaction(step)
    shares, dt = wheel_shares(wheels), step.dt
    total = np.zeros(len(wheels)) if step.wheel_total is None else step.wheel_total
    now = total - shares @ (D @ step.rates)
    after = now - dt * (shares @ (b - D @ step.rates / dt))  # at the step's end, were the joints to stop
    rubbing = -wheels.friction_torque(now / wheels.inertia) if wheels.rubs else np.zeros(len(wheels))
    # after - G u is the momentum at the end; (that - now) / dt + rubbing the torque.
    G, left = shares @ D, 1.0 - in_hand
    torque = np.minimum(left * wheels.torque, UNBOUNDED)
    momentum = np.minimum(left * wheels.momentum, UNBOUNDED)
    centre = after - now + dt * rubbing
    lower, upper = centre - dt * torque, centre + dt * torque
    lower = np.maximum(lower, np.minimum(after - momentum, upper))
    upper = np.minimum(upper, np.maximum(after + momentum, lower))
    size = np.linalg.norm(G, axis=1)
    moved = size > _UNMOVED
    rows = _shared(G[moved] / size[moved, None], lower[moved] / size[moved], upper[moved] / size[moved])
    return None if rows is None else reachable(rows, step)


def reachable(rows: Rows, step: StepState) -> Rows:
    """Rows whose bounds each leave something that the joints can do in the step."""
    least, most = rate_bounds(step.joints, step.rates, step.sms.limits, step.dt)
    ends = rows.G * least, rows.G * most
    lowest, highest = (np.sum(pick(*ends), axis=1) for pick in (np.minimum, np.maximum))
    room = _ROOM * (highest - lowest)
    return rows._replace(
        lower=np.minimum(rows.lower, highest - room), upper=np.maximum(rows.upper, lowest + room)
    )


def _shared(G: FloatArray, lower: FloatArray, upper: FloatArray) -> Rows | None:
    """Rows of unit length; of those that are parallel one, with the bounds of all: a solver asks for that."""
    kept: list[tuple[FloatArray, float, float]] = []
    for row, low, up in zip(G, lower, upper, strict=True):
        for i, (other, least, most) in enumerate(kept):
            along = float(row @ other)
            if abs(along) > 1.0 - _PARALLEL:
                low, up = (low, up) if along > 0.0 else (-up, -low)
                kept[i] = other, max(least, min(low, most)), min(most, max(up, least))
                break
        else:
            kept.append((row, low, up))
    if not kept:
        return None
    directions, lowest, highest = zip(*kept, strict=True)
    return Rows(np.array(directions), np.array(lowest), np.array(highest))

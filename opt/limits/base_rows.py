"""The limits on the base's motion in one step: rows of its programme, and whether the arm could still stop.

With r the base's turn from the start, d|r|/dt = (r / |r|) . omega_b. As for the clearances, |r| may approach
its limit at most at a rate proportional to what is left. That is asked at the place where the base will be
one step later, since the row is about the rates that it will then have; there a turn across r also counts,
since it carries the base outwards on the tangent. The same for the shift of the base's centre of mass.
`final_attitude` is such a limit that closes in as the deadline nears. The angular velocity stays in a box
around its present direction that lies within the ball of its limit.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.system.base_motion import advance, held_velocity

__all__ = ["GIVE", "RETURN_RATE", "BaseBounds", "base_rows", "settled"]

# Coefficient of the step's slack in a row [rad/m]: a turn of the base is dearer than the loss of a clearance,
# because moving the arm by as much turns it by far less.
GIVE = 0.1

# [1/s] What is left of a limit may shrink at most this fast relative to itself, so that the arm can still
# brake the base; as for the clearances.
_CLOSING_RATE = 2.0
# Shares of a limit: kept beyond it against what happens within a step; half sizes of the box in which the
# angular velocity stays, along its present direction and across it. The box lies within the ball of the
# limit (its corner at 0.99), so it gives up a tenth of it, more across, until the next step turns the box.
_MARGIN = 0.03
_BRAKED = 0.015  # half of it, for the motion of an arm that brakes
_ALONG, _ACROSS = 0.9, 0.29
# [rad/s] How fast the arm is trusted to undo a turn of the base before the deadline.
RETURN_RATE = 0.02
_UNDONE = 10  # steps before the deadline at which it should be undone
# Of the way from braking to what the programme wants; and samples of an arm that brakes.
_SHARES = (0.5, 0.25, 0.1)
_STOPS = 5
_FASTEST = 1e6  # [rad/s^2] stands for no limit on an acceleration


class BaseBounds(Protocol):
    """What is limited: infinity is no limit.

    Attributes
    ----------
    attitude, final_attitude : float
        Turn from the start at any time, and at the end [rad].
    attitude_rate : float
        Angular speed [rad/s].
    translation : float
        Distance of the base's centre of mass from where it started [m].
    """

    @property
    def attitude(self) -> float: ...  # noqa: D102 - above
    @property
    def attitude_rate(self) -> float: ...  # noqa: D102
    @property
    def translation(self) -> float: ...  # noqa: D102
    @property
    def final_attitude(self) -> float: ...  # noqa: D102


def base_rows(limits: BaseBounds, step: StepState) -> Rows | None:
    """Rows gradient . u >= least that keep the base within its limits, between nodes too.

    Parameters
    ----------
    limits : BaseBounds
    step : StepState
        Turn and shift count from its `base_start`.
    """
    gradients: list[FloatArray] = []
    least: list[float] = []
    for gradient, value in (*_turn(limits, step), *_shift(limits, step), *_spin(limits, step)):
        gradients.append(gradient)
        least.append(value)
    if not gradients:
        return None
    return Rows(np.array(gradients), np.array(least), np.full(len(least), UNBOUNDED), GIVE)


_Row = tuple[FloatArray, float]


def _turn(limits: BaseBounds, step: StepState) -> list[_Row]:
    """The turn from the start."""
    if min(limits.attitude, limits.final_attitude) == math.inf:
        return []
    start, now = pin.XYZQUATToSE3(step.base_start), pin.XYZQUATToSE3(step.q[:7])
    turning, own = step.reaction[3:], step.drift[3:]
    omega = turning @ step.rates + own
    turned: FloatArray = pin.log3(start.rotation.T @ now.rotation @ pin.exp3(step.dt * omega))
    closing_in = limits.final_attitude + RETURN_RATE * max(step.time_left - _UNDONE * step.dt, 0.0)
    outwards, most = _approach(turned, omega, min(limits.attitude, closing_in), step.dt)
    if limits.final_attitude < closing_in < limits.attitude:
        most -= RETURN_RATE
    return [(-outwards @ turning, float(outwards @ own) - most)]


def _shift(limits: BaseBounds, step: StepState) -> list[_Row]:
    """The way of the base's centre of mass from the start."""
    if limits.translation == math.inf:
        return []
    com = step.sms.base_com
    start, now = pin.XYZQUATToSE3(step.base_start), pin.XYZQUATToSE3(step.q[:7])
    shift = now.rotation.T @ (now.act(com) - start.act(com))  # in root axes
    moving = step.reaction[:3] + np.cross(step.reaction[3:], com, axisa=0, axisc=0)
    own = step.drift[:3] + np.cross(step.drift[3:], com)
    velocity = moving @ step.rates + own
    outwards, most = _approach(shift + step.dt * velocity, velocity, limits.translation, step.dt)
    return [(-outwards @ moving, float(outwards @ own) - most)]


def _spin(limits: BaseBounds, step: StepState) -> list[_Row]:
    """The angular velocity, on both sides of each axis of its box."""
    if limits.attitude_rate == math.inf:
        return []
    turning, own = step.reaction[3:], step.drift[3:]
    rows: list[_Row] = []
    for axis, share in zip(_axes(turning @ step.rates + own), (_ALONG, _ACROSS, _ACROSS), strict=True):
        room = (1.0 - _MARGIN) * limits.attitude_rate * share
        gradient, drifting = axis @ turning, float(axis @ own)
        rows += [(-gradient, drifting - room), (gradient, -drifting - room)]
    return rows


def _approach(place: FloatArray, velocity: FloatArray, limit: float, dt: float) -> tuple[FloatArray, float]:
    """Unit vector away from the start, and the greatest speed along it."""
    distance = math.sqrt(float(place @ place))
    room = (1.0 - _MARGIN) * limit - distance
    if distance < 1e-12:
        return np.array([1.0, 0.0, 0.0]), _CLOSING_RATE * room
    outwards = place / distance
    along = float(outwards @ velocity)
    across = max(float(velocity @ velocity) - along * along, 0.0)
    return outwards, _CLOSING_RATE * room - 0.5 * dt * across / distance


def _axes(omega: FloatArray) -> FloatArray:
    """Three orthonormal rows, the first along the angular velocity."""
    size = math.sqrt(float(omega @ omega))
    first = omega / size if size > 1e-12 else np.array([1.0, 0.0, 0.0])
    second = np.cross(first, np.eye(3)[int(np.argmin(np.abs(first)))])
    second /= np.linalg.norm(second)
    return np.array([first, second, np.cross(first, second)])


def settled(limits: BaseBounds, step: StepState, rates: FloatArray, braking: FloatArray) -> FloatArray:
    """Joint rates (n,) for the step's end after which the arm can still stop with the base within its limits.

    A fast motion in the reaction null space needs the arm's acceleration to stay there, and the rows do not
    see how much. So what would happen if the arm stopped after this step is rolled out. Where that breaks a
    limit the rates go part of the way to braking, or all of it: that was safe one step ago.

    Parameters
    ----------
    limits : BaseBounds
    step : StepState
    rates, braking : ndarray, shape (n,)
        Wanted rates at the step's end, and those of braking [rad/s].
    """
    if min(limits.attitude, limits.translation, limits.attitude_rate) == math.inf:
        return rates
    if _furthest(limits, step, rates) <= 1.0:
        return rates
    # Where the limit is already broken, coming back must be possible.
    most = max(1.0, _furthest(limits, step, braking))
    for share in _SHARES:
        between = braking + share * (rates - braking)
        if _furthest(limits, step, between) <= most:
            return between
    return braking


def _furthest(limits: BaseBounds, step: StepState, end: FloatArray) -> float:
    """Largest share of the limits that is used if the arm goes to rates `end` and then stops."""
    sms, momentum, worst = step.sms, step.momentum, 0.0
    acceleration = np.minimum(sms.limits.acceleration, _FASTEST)
    stop = float(np.max(np.abs(end) / acceleration))
    q, _ = advance(sms, step.q, step.rates, (end - step.rates) / step.dt, step.dt, momentum, step.mode)
    slowing = -end / max(stop, 1e-12)
    for k in range(_STOPS + 1):
        worst = max(worst, _used(limits, step, q, end))
        if k < _STOPS and stop > 0.0:
            q, end = advance(sms, q, end, slowing, stop / _STOPS, momentum, step.mode)
    return worst / (1.0 - _BRAKED)


def _used(limits: BaseBounds, step: StepState, q: FloatArray, rates: FloatArray) -> float:
    """Largest share of the limits that is used at one state."""
    start, now = pin.XYZQUATToSE3(step.base_start), pin.XYZQUATToSE3(q[:7])
    com: Any = step.sms.base_com
    turn = float(np.linalg.norm(pin.log3(start.rotation.T @ now.rotation)))
    shift = float(np.linalg.norm(now.act(com) - start.act(com)))
    used = max(turn / limits.attitude, shift / limits.translation)
    if limits.attitude_rate < math.inf:
        if step.mode == "floating":
            spin = step.sms.velocity(q, rates, step.momentum)[3:6]
        else:
            spin = held_velocity(step.sms, q, rates, step.momentum, step.mode)[3:6]
        used = max(used, float(np.linalg.norm(spin)) / limits.attitude_rate)
    return used

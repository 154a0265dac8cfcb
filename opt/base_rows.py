"""The limits on the base's motion as rows of the step's programme."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.base_limits import BaseLimits
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_motion import advance

__all__ = ["RETURN_RATE", "SLACK", "BaseRows"]

# Coefficient of the step's slack in a row [rad/m]: a turn of the base is dearer than the loss of a clearance,
# because moving the arm by as much turns it by far less.
SLACK = 0.1

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
# Of the way from braking to what the programme wants; and samples of an arm that brakes.
_SHARES = (0.5, 0.25, 0.1)
_STOPS = 5
_SETTLED = 10  # steps before the deadline at which it should be undone


class BaseRows:
    """Rows g . joint rates + SLACK slack >= b that keep the base within its limits, between nodes too.

    With r the base's turn from the start, d|r|/dt = (r / |r|) . omega_b. As for the clearances, |r| may
    approach its limit at most at a rate proportional to what is left. That is asked at the place where the
    base will be one step later, since the row is about the rates that it will then have; there a turn across
    r also counts, since it carries the base outwards on the tangent. The same for the shift of the base's
    centre of mass. `final_attitude` is such a limit that closes in as the deadline nears.

    The angular velocity stays in a box around its present direction that lies within the ball of the limit.

    Parameters
    ----------
    sms : SpaceManipulator
    limits : BaseLimits

    Attributes
    ----------
    start : ndarray, shape (7,), or None
        Root pose that turn and shift count from; None: that of the next step.
    anchored : bool
        Whether `reset` leaves `start` alone: for a planner that goes on where another one was.
    """

    def __init__(self, sms: SpaceManipulator, limits: BaseLimits) -> None:
        self.limits = limits
        self.start: FloatArray | None = None
        self.anchored = False
        self._sms, self._com = sms, np.array(sms.base_com)
        self._acceleration = np.minimum(sms.limits.acceleration, 1e6)
        self._turning = min(limits.attitude, limits.final_attitude) < math.inf
        self._shifting = limits.translation < math.inf
        self._spinning = limits.attitude_rate < math.inf
        self.count = int(self._turning) + int(self._shifting) + 6 * int(self._spinning)

    def reset(self) -> None:
        """Count from the base's place at the next step."""
        if not self.anchored:
            self.start = None

    def rows(
        self,
        q: FloatArray,
        rates: FloatArray,
        coupling: FloatArray,
        drift: FloatArray | None,
        dt: float,
        time_left: float,
    ) -> tuple[FloatArray, FloatArray]:
        """Gradients (count, n) by the joint rates, and least values (count,).

        Parameters
        ----------
        q, rates : ndarray, shape (nq,), (n,)
            At the step's start.
        coupling : ndarray, shape (6, n)
            Root velocity a joint rate, root axes.
        drift : ndarray, shape (6,), or None
            Root velocity of the momentum alone, root axes.
        dt, time_left : float
            [s]
        """
        if self.start is None:
            self.start = q[:7].copy()
        start, now = pin.XYZQUATToSE3(self.start), pin.XYZQUATToSE3(q[:7])
        own = np.zeros(6) if drift is None else drift
        velocity = coupling @ rates + own
        gradients, least = [], []
        if self._turning:
            turned: FloatArray = pin.log3(start.rotation.T @ now.rotation @ pin.exp3(dt * velocity[3:]))
            closing_in = self.limits.final_attitude + RETURN_RATE * max(time_left - _SETTLED * dt, 0.0)
            outwards, most = _approach(turned, velocity[3:], min(self.limits.attitude, closing_in), dt)
            if self.limits.final_attitude < closing_in < self.limits.attitude:
                most -= RETURN_RATE
            gradients.append(-outwards @ coupling[3:])
            least.append(float(outwards @ own[3:]) - most)
        if self._shifting:
            # The base's centre of mass, in root axes.
            shift = now.rotation.T @ (now.act(self._com) - start.act(self._com))
            moving, still = _at(self._com, coupling), _at(self._com, own[:, None])[:, 0]
            speed = moving @ rates + still
            outwards, most = _approach(shift + dt * speed, speed, self.limits.translation, dt)
            gradients.append(-outwards @ moving)
            least.append(float(outwards @ still) - most)
        if self._spinning:
            axes = _axes(velocity[3:])
            limit = (1.0 - _MARGIN) * self.limits.attitude_rate
            room = limit * np.array([_ALONG, _ACROSS, _ACROSS])
            gradients.extend([*(-axes @ coupling[3:]), *(axes @ coupling[3:])])
            least.extend([*(axes @ own[3:] - room), *(-axes @ own[3:] - room)])
        return np.array(gradients), np.array(least)

    def stoppable(
        self,
        q: FloatArray,
        rates: FloatArray,
        chosen: FloatArray,
        brake: FloatArray,
        dt: float,
        momentum: Any,
    ) -> FloatArray:
        """Joint rates for the step's end after which the arm can still stop with the base within its limits.

        A fast motion in the reaction null space needs the arm's acceleration to stay there, and the rows do
        not see how much. So what would happen if the arm stopped after this step is rolled out. Where that
        breaks a limit the rates go part of the way to braking, or all of it: that was safe one step ago.

        Parameters
        ----------
        q, rates : ndarray, shape (nq,), (n,)
            At the step's start.
        chosen, brake : ndarray, shape (n,)
            Wanted rates at the step's end, and those of braking.
        dt : float
            [s]
        momentum : ndarray, shape (6,), or None
        """
        if min(self.limits.attitude, self.limits.translation, self.limits.attitude_rate) == math.inf:
            return chosen
        if self._furthest(q, rates, chosen, dt, momentum) <= 1.0:
            return chosen
        # Where the limit is already broken, coming back must be possible.
        most = max(1.0, self._furthest(q, rates, brake, dt, momentum))
        for share in _SHARES:
            between = brake + share * (chosen - brake)
            if self._furthest(q, rates, between, dt, momentum) <= most:
                return between
        return brake

    def _furthest(self, q: FloatArray, rates: FloatArray, end: FloatArray, dt: float, momentum: Any) -> float:
        """Largest share of the limits that is used if the arm goes to rates `end` and then stops."""
        sms, worst = self._sms, 0.0
        start = pin.XYZQUATToSE3(self.start)
        stop = float(np.max(np.abs(end) / self._acceleration))
        q, _ = advance(sms, q, rates, (end - rates) / dt, dt, momentum)
        braking = -end / max(stop, 1e-12)
        for k in range(_STOPS + 1):
            now = pin.XYZQUATToSE3(q[:7])
            turn = float(np.linalg.norm(pin.log3(start.rotation.T @ now.rotation)))
            shift = float(np.linalg.norm(now.act(self._com) - start.act(self._com)))
            worst = max(worst, turn / self.limits.attitude, shift / self.limits.translation)
            if self._spinning:
                spin = sms.velocity(q, end, momentum)[3:6]
                worst = max(worst, float(np.linalg.norm(spin)) / self.limits.attitude_rate)
            if k < _STOPS and stop > 0.0:
                q, end = advance(sms, q, end, braking, stop / _STOPS, momentum)
        return worst / (1.0 - _BRAKED)


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


def _at(point: FloatArray, root: FloatArray) -> FloatArray:
    """Linear velocities (3, k) of a point fixed in the root's axes, of root velocities (6, k)."""
    velocity: FloatArray = root[:3] + np.cross(root[3:], point, axisa=0, axisc=0)
    return velocity


def _axes(omega: FloatArray) -> FloatArray:
    """Three orthonormal rows, the first along the angular velocity."""
    size = math.sqrt(float(omega @ omega))
    first = omega / size if size > 1e-12 else np.array([1.0, 0.0, 0.0])
    second = np.cross(first, np.eye(3)[int(np.argmin(np.abs(first)))])
    second /= np.linalg.norm(second)
    return np.array([first, second, np.cross(first, second)])

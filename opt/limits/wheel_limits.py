"""The limits of torques and momenta of reaction wheels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.evaluation import UNBOUNDED, Rows, Violation
from ffsms_pin.opt.limits.limit import SHARE, SpeedBound
from ffsms_pin.opt.limits.torque_limits import Loads, MotorLimits, reachable_rows
from ffsms_pin.opt.rollouts import Rollouts, held_momentum, wheel_shares
from ffsms_pin.opt.step.state import StepState


@dataclass(frozen=True)
class WheelLimits(MotorLimits):
    """The limits of torques and momenta of wheels that hold the attitude (mode "rotation-floating").

    A wheel's momentum follows from the conservation of angular momentum. Its motor torque is the rate of this
    momentum plus the compensation of bearing friction. If wheels hold the attitude, this limit is added to
    every problem. Slack and violation are shares of a wheel's capacity; a violation of 0.3 is an overload of
    30 %.
    """

    name = "wheels"
    broken = "the wheels would saturate"
    lacks = "{0} would need {1:.3g} {2} at {3:.3g} s and has {4:.3g} {2}; wheels of {5:.3g} {2} would suffice"

    def loads(self, m: Variables) -> Loads:
        """Return the wheels' momenta and torques; an empty list if no wheels hold the attitude."""
        wheels = m.rollouts.wheels
        if wheels is None:
            return []
        momenta, torques, count = (m.wheels, wheels.momentum), (m.wheel_torques, wheels.torque), len(wheels)
        return [(*momenta, wheels.names, ["N m s"] * count), (*torques, wheels.names, ["N m"] * count)]

    def recorded_loads(self, m: Variables) -> Loads:
        """Return the momenta only, because a simulated motor does not exceed its largest torque."""
        return self.loads(m)[:1]

    def rows(self, step: StepState) -> Rows | None:
        """Return rows of unit norm, in rad/s; None if no wheels hold the attitude or no joint moves a wheel.

        The torques are those at constant joint rates plus A^+ D (u_0 - u) / dt, with the joint rates u_0 at
        the step's start and u at its end; for A^+ D see `opt.rollouts`. Both limits are therefore bounds on
        A^+ D u. If they contradict each other, the torque limit has priority. Wheels with parallel rows, for
        example all wheels of a planar arm, share a row.
        """
        wheels = step.wheels
        if wheels is None:
            return None
        m, dt, share = step.variables, step.dt, 1.0 - SHARE
        G = wheel_shares(wheels) @ held_momentum(m.arm)[..., 0, 0]
        now, torque = m.wheels.value[:, 0, 0], m.wheel_torques.value[:, 0, 0]
        rubbing = -wheels.friction_torque(now / wheels.inertia) if wheels.rubs else np.zeros(len(wheels))
        middle, slack = G @ step.rates + dt * torque, dt * np.minimum(share * wheels.torque, UNBOUNDED)
        lower, upper = middle - slack, middle + slack
        middle, slack = middle + now - dt * rubbing, np.minimum(share * wheels.momentum, UNBOUNDED)
        lower = np.maximum(lower, np.minimum(middle - slack, upper))
        upper = np.minimum(upper, np.maximum(middle + slack, lower))
        kept: list[tuple[FloatArray, float, float]] = []
        for row, low, up in zip(G, lower, upper, strict=True):
            _share(kept, row, float(low), float(up))
        return reachable_rows(step, *map(np.array, zip(*kept, strict=True))) if kept else None

    def speed_bound(self, motion: Rollouts) -> SpeedBound | None:
        """Return the bounds on the speed along a path from the wheels' limits, without bearing friction."""
        wheels = motion.wheels
        if wheels is None:
            return None
        slope = Variables(motion).wheels.value[:, 0] - motion.wheel_total[:, None]
        return SpeedBound(motion.wheel_total, slope, wheels.momentum, wheels.torque)

    def violation(self, motion: Rollouts) -> Violation:
        """Return the largest overload; momentum about an axis without a wheel counts as at least 1."""
        violation, wheels = super().violation(motion), motion.wheels
        if wheels is None:
            return violation
        momentum = Variables(motion).arm_momentum.value[:, 0]
        other = np.abs(momentum - wheels.axes.T @ (wheel_shares(wheels) @ momentum)).max()
        if other <= 1e-6 * max(float(np.abs(momentum).max()), 1e-9):  # rounding
            return violation
        note = f"{other:.3g} N m s of the arm's momentum are about an axis without a wheel"
        note = f"{violation.note or self.broken}{'; ' if violation.note else ': '}{note}"
        return violation._replace(amount=max(violation.amount, 1.0), note=note)


def _share(kept: list[tuple[FloatArray, float, float]], row: FloatArray, low: float, up: float) -> None:
    """Add a row to `kept`, or merge it with a parallel row, because rows of a QP must be independent."""
    size = float(np.linalg.norm(row))
    if size <= 1e-12:  # joints that do not move the wheel
        return
    row, low, up = row / size, low / size, up / size
    for i, (other, least, most) in enumerate(kept):
        along = float(row @ other)
        if abs(along) > 1.0 - 1e-9:
            low, up = (low, up) if along > 0.0 else (-up, -low)
            kept[i] = other, max(least, min(low, most)), min(most, max(up, least))
            return
    kept.append((row, low, up))

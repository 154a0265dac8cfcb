"""What the joints' motors can do, as a limit of the plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from ffsms_pin.opt.limits.limit import Rows, Violation
from ffsms_pin.opt.limits.rate_bounds import rate_bounds
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.opt.limits.wheel_rows import reachable
from ffsms_pin.opt.motion import Feature, Features
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.parts.inequality import Inequality
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.dynamics import velocity_effects

__all__ = ["TorqueLimits"]

# Share of a limit kept in hand: for the feedback that follows the plan, and for what a penalty gives way.
_SHARE = 0.08
# What a whole limit weighs: as much as a lack of clearance of this many arm lengths.
_SCALE = 0.03
_BINDING = _SHARE + 0.01  # with less than this share left the limit binds
_MOST_IN_HAND = 0.5  # share of a limit: a tighter one would hold a plan back more than the motors do


@dataclass(frozen=True)
class TorqueLimits(Inequality):
    """The joints' largest torques, or forces, `sms.limits.torque`; an infinite one limits nothing.

    Exact: H_q qdd + C_q with the base reacting as its mode lets it, the total momentum included. A problem
    has this limit by default, and it asks for nothing where the robot has no such limits ("effort" in URDFs).

    Its unit is a share of what the joint has: a violation of 0.3 asks for 30 % more.
    """

    name = "torques"
    margin = _SCALE * _SHARE
    scale = 1.0 / _SCALE
    in_hand = _SHARE
    most_reserve = _MOST_IN_HAND - _SHARE
    eased_by_time = True

    def room(self, m: Features) -> Feature | list[Feature]:
        """Shares of the torques that are left."""
        most = _robot(m.motions).limits.torque
        return [1.0 - abs(m.torques) / most] if np.isfinite(most).any() else []

    def rows(self, step: StepState) -> Rows | None:
        """Rows of unit length, in rad/s: H_q (u - u_0) / dt + C_q, linear in the rates u at the step's end.

        Of the joints that could ask for too much in this step. Where the joints' own limits leave no way to
        keep one, they come first, and the row asks for what comes nearest.
        """
        sms, dt, most = step.sms, step.dt, step.sms.limits.torque
        if not np.isfinite(most).any():
            return None
        N = np.vstack([step.reaction, np.eye(sms.n)])
        velocity = np.concatenate([step.reaction @ step.rates + step.drift, step.rates])
        H, C = step.M[6:] @ N, velocity_effects(sms, step.q, velocity) @ N
        low, high = rate_bounds(step.joints, step.rates, sms.limits, dt)
        allowed = (1.0 - _SHARE - self.kept) * most
        largest = np.abs(C) + np.abs(H) @ np.maximum(high - step.rates, step.rates - low) / dt
        near = np.flatnonzero(largest > allowed)
        if not near.size:
            return None
        H, C, allowed = H[near], C[near], allowed[near]
        size = np.linalg.norm(H, axis=1)
        middle, room = (H @ step.rates - dt * C) / size, dt * allowed / size
        return reachable(Rows(H / size[:, None], middle - room, middle + room), step)

    def violation(self, motion: Motions) -> Violation:
        """The largest share by which a joint lacks torque, on both sides of every node."""
        robot = _robot(motion)
        most = robot.limits.torque
        if not np.isfinite(most).any():
            return Violation()
        sizes = motion.torque_sizes[:, 0]
        used = sizes / most[:, None]
        instants = motion.times[(used > 1.0 - _BINDING).any(axis=0)]
        i, k = np.unravel_index(int(np.argmax(used)), used.shape)
        if used[i, k] <= 1.0:
            return Violation(0.0, instants)
        note = (
            f"the torque limit is broken: '{robot.joint_names[i]}' would need {sizes[i, k]:.4g} N m at "
            f"{motion.times[k]:.3g} s and has {most[i]:.4g} N m"
        )
        return Violation(float(used[i, k]) - 1.0, instants, note)


def _robot(motions: Motions) -> SpaceManipulator:
    return cast(SpaceManipulator, motions.stack.robot)

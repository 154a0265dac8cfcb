"""What the joints' motors can do, as a limit of the plan."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.instants import Instants
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Residuals
from ffsms_pin.opt.batch.torques import torque_slopes
from ffsms_pin.opt.limits.limit import Limit, Rows, Violation
from ffsms_pin.opt.limits.rate_bounds import rate_bounds
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.opt.limits.wheel_rows import reachable
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.dynamics import reduced_effects, reduced_inertia, velocity_effects

__all__ = ["TorqueLimits"]

# Share of a limit kept in hand: for the feedback that follows the plan, and for what a penalty gives way.
_SHARE = 0.08
# What a whole limit weighs: as much as a lack of clearance of this many arm lengths.
_SCALE = 0.03
_BINDING = _SHARE + 0.01  # with less than this share left the limit binds
_MOST_IN_HAND = 0.5


@dataclass(frozen=True)
class TorqueLimits(Limit):
    """The joints' largest torques, or forces, `sms.limits.torque`; an infinite one limits nothing.

    Exact: H_q qdd + C_q with the base reacting as its mode lets it, the total momentum included. A problem
    has this limit by default where the robot has such limits, as URDFs give them ("effort").

    Its unit is a share of what the joint has: a violation of 0.3 asks for 30 % more.
    """

    name = "torques"
    eased_by_time = True
    margin = _SCALE * _SHARE
    _most: FloatArray = field(default_factory=lambda: np.empty(0), repr=False, compare=False)
    _joint_names: tuple[str, ...] = field(default=(), repr=False)
    _in_hand: float = _SHARE

    def for_robot(self, sms: SpaceManipulator) -> TorqueLimits:
        """With the robot's limits."""
        return replace(self, _most=sms.limits.torque, _joint_names=tuple(sms.joint_names))

    def tightened(self, by: float) -> TorqueLimits:
        """With so much more in hand, at most half of the limit."""
        return replace(self, _in_hand=min(self._in_hand + max(by, 0.0), _MOST_IN_HAND))

    def rows(self, step: StepState) -> Rows | None:
        """Rows of unit length, in rad/s: H_q (u - u_0) / dt + C_q, linear in the rates u at the step's end.

        Of the joints that could ask for too much in this step. Where the joints' own limits leave no way to
        keep one, they come first, and the row asks for what comes nearest.
        """
        sms, dt = step.sms, step.dt
        N = np.vstack([step.reaction, np.eye(sms.n)])
        velocity = np.concatenate([step.reaction @ step.rates + step.drift, step.rates])
        H, C = reduced_inertia(step.M, N), reduced_effects(velocity_effects(sms, step.q, velocity), N)
        least, most = rate_bounds(step.joints, step.rates, sms.limits, dt)
        allowed = (1.0 - self._in_hand) * self._most
        largest = np.abs(C) + np.abs(H) @ np.maximum(most - step.rates, step.rates - least) / dt
        near = np.flatnonzero(largest > allowed)
        if not near.size:
            return None
        H, C, allowed = H[near], C[near], allowed[near]
        size = np.linalg.norm(H, axis=1)
        middle = (H @ step.rates - dt * C) / size
        room = dt * allowed / size
        return reachable(Rows(H / size[:, None], middle - room, middle + room), step)

    def residual(self, motions: Motions) -> Residuals:
        """Shares of the limits that are used beyond 1 less what is kept in hand, over the whole motion."""
        if not np.isfinite(self._most).any():
            return []
        torques, allowed = motions.torques, (1.0 - self._in_hand) * self._most
        joint, motion, instant = np.nonzero(np.abs(torques) > allowed[:, None, None])
        if not joint.size:
            return []
        # One configuration serves all joints that ask for too much at it.
        where, back = np.unique(np.stack([motion, instant]), axis=1, return_inverse=True)
        at, back = Instants(*where), back.reshape(-1)
        own = motions.own_spin[:, at.motion, at.instant]
        slopes = torque_slopes(motions.stack, *at.columns(motions), own)
        value, most = torques[joint, motion, instant], self._most[joint]
        factor = _SCALE * np.sign(value) / most
        used = _SCALE * (np.abs(value) / most - (1.0 - self._in_hand))
        by = [factor * slope[joint, :, back].T for slope in slopes]
        return [Instants(motion, instant).residual(used, by)]

    def violation(self, motion: Motions) -> Violation:
        """The largest share by which a joint lacks torque, on both sides of every node."""
        if not np.isfinite(self._most).any():
            return Violation()
        sizes = motion.torque_sizes[:, 0]
        used = sizes / self._most[:, None]
        instants = motion.times[(used > 1.0 - _BINDING).any(axis=0)]
        i, k = np.unravel_index(int(np.argmax(used)), used.shape)
        if used[i, k] <= 1.0:
            return Violation(0.0, instants)
        note = (
            f"'{self._joint_names[i]}' would need {sizes[i, k]:.4g} N m at {motion.times[k]:.3g} s and has "
            f"{self._most[i]:.4g} N m"
        )
        return Violation(float(used[i, k]) - 1.0, instants, f"the torque limit is broken: {note}")

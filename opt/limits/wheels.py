"""What the wheels that hold the attitude can do, as a limit of the plan."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ffsms_pin.opt.limits.limit import Rows, Violation
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.opt.limits.wheel_rows import wheel_rows
from ffsms_pin.opt.motion import Feature, Features
from ffsms_pin.opt.motion.actuated import arm_momentum, wheel_momentum, wheel_shares, wheel_torque
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.parts.inequality import Inequality

__all__ = ["WheelLimits"]

# Share of a limit kept in hand: for the feedback that follows the plan, and for what a penalty gives way.
_SHARE = 0.08
# What a whole limit weighs: as much as a lack of clearance of this many arm lengths.
_SCALE = 0.03
_BINDING = _SHARE + 0.01  # with less than this share left the limit binds
_MOST_IN_HAND = 0.5  # share of a limit: a tighter one would hold a plan back more than the wheels do
_UNCOVERED = 1e-6  # share of the arm's momentum along an axis that no wheel has


@dataclass(frozen=True)
class WheelLimits(Inequality):
    """The wheels' largest torques and momenta, where wheels hold the attitude (mode "rotation-floating").

    Momentum follows from the conservation of angular momentum, torque is its rate, with the friction of the
    bearings made good (`opt.motion.actuated`). In other modes the wheels stand still, and the limit asks for
    nothing. A problem in that mode, of a robot with wheels, has this limit of itself.

    Its unit is a share of what the wheel has: a violation of 0.3 asks for 30 % more.
    """

    name = "wheels"
    margin = _SCALE * _SHARE
    scale = 1.0 / _SCALE
    in_hand = _SHARE
    most_reserve = _MOST_IN_HAND - _SHARE
    eased_by_time = True

    def room(self, m: Features) -> list[Feature]:
        """Shares of momentum and torque that are left."""
        wheels = m.motions.wheels
        if wheels is None:
            return []
        return [1.0 - abs(m.wheels) / wheels.momentum, 1.0 - abs(m.wheel_torques) / wheels.torque]

    def rows(self, step: StepState) -> Rows | None:
        """Rows of the wheels' momenta at the step's end and of their torques in it."""
        return wheel_rows(step, _SHARE + self.kept)

    def violation(self, motion: Motions) -> Violation:
        """The largest share by which a wheel lacks momentum or torque, and what would do."""
        wheels = motion.wheels
        if wheels is None:
            return Violation()
        momentum = np.abs(wheel_momentum(motion)[:, 0])
        torque = np.abs(wheel_torque(motion)[:, 0])
        # Accelerations jump at the nodes: at each instant those of the step before as well.
        before = np.concatenate([motion.accelerations[..., :1], motion.accelerations[..., :-1]], axis=-1)
        torque = np.maximum(torque, np.abs(wheel_torque(replace(motion, accelerations=before))[:, 0]))
        worst, notes = 0.0, []
        binds = np.zeros(len(motion.times), dtype=bool)
        for values, most, unit in ((momentum, wheels.momentum, "N m s"), (torque, wheels.torque, "N m")):
            used = values / most[:, None]
            binds |= (used > 1.0 - _BINDING).any(axis=0)
            # Wheels that do the same by symmetry differ by rounding: the first of them is named.
            i, k = np.unravel_index(int(np.argmax(used.round(9))), used.shape)
            if used[i, k] > 1.0:
                worst = max(worst, float(used[i, k]) - 1.0)
                notes.append(
                    f"{wheels.names[i]} would need {values[i, k]:.3g} {unit} at {motion.times[k]:.3g} s and "
                    f"has {most[i]:.3g} {unit}; wheels of {values.max():.3g} {unit} would do"
                )
        taken = arm_momentum(motion)[:, 0]
        rest = np.abs(taken - wheels.axes.T @ (wheel_shares(wheels) @ taken)).max()
        if rest > _UNCOVERED * max(float(np.abs(taken).max()), 1e-9):
            worst = max(worst, 1.0)
            notes.append(f"{rest:.3g} N m s of the arm's momentum are about an axis that no wheel has")
        note = f"the wheels would saturate: {'; '.join(notes)}" if notes else ""
        return Violation(worst, motion.times[binds], note)

"""Limits on the joints' torques, and the base class of limits on motors."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.derivatives import Variable, Variables
from ffsms_pin.opt.evaluation import Rows, Violation
from ffsms_pin.opt.limits.limit import SCALE, SHARE, Inequality, SpeedBound
from ffsms_pin.opt.rollouts import RecordedRollouts, Rollouts, forces
from ffsms_pin.opt.step.state import StepState

# For each kind of load: the loads (c, S, K), the capacities (c,), the names of the motors, and the units.
Loads: TypeAlias = list[tuple[Variable, FloatArray, Sequence[str], Sequence[str]]]

_ROUNDING = 1e-3  # share of a capacity by which a saturated load may exceed it in a control step


class MotorLimits(Inequality):
    """A limit on the loads of motors, relative to their capacities."""

    margin = SCALE * SHARE
    scale = 1.0 / SCALE
    absolute_margin = SHARE
    largest_extra_margin = 0.5 - SHARE  # with a margin above half of the capacity, motions would be too slow
    eased_by_time = True
    broken: str  # the message for a violation
    lacks: str  # the message for a motor, with name, load, unit, time, capacity, and sufficient capacity

    @abstractmethod
    def loads(self, m: Variables) -> Loads:
        """Return the loads of the motors, an entry for each kind of load."""

    def slack(self, m: Variables) -> list[Variable]:
        """Return the unused share of each motor's capacity."""
        return [1.0 - abs(load) / most for load, most, *_ in self.loads(m)]

    def violation(self, motion: Rollouts) -> Violation:
        """Return the largest overload as a share of a motor's capacity, on both sides of every node."""
        sides = (self.loads(Variables(side)) for side in (motion, motion.before))
        worst, notes, binds = 0.0, [], np.zeros(len(motion.times), dtype=bool)
        for (load, most, names, units), (before, *_) in zip(*sides, strict=True):
            values = np.abs(load.value[:, 0])
            values[:, ::2] = np.maximum(values[:, ::2], np.abs(before.value[:, 0]))
            used = values / most[:, None]
            # The margin begins at 0.92 of the capacity; the limit is active slightly below.
            binds |= (used > 0.91).any(axis=0)
            # Loads that are equal by symmetry differ by rounding errors; the first such motor is reported.
            i, k = np.unravel_index(int(np.argmax(used.round(9))), used.shape)
            if used[i, k] > 1.0:
                worst = max(worst, float(used[i, k]) - 1.0)
                has = (names[i], values[i, k], units[i], motion.times[k], most[i], values.max())
                notes.append(self.lacks.format(*has))
        return Violation(worst, motion.times[binds], f"{self.broken}: {'; '.join(notes)}" if notes else "")

    def violation_in_flight(self, motion: RecordedRollouts) -> Violation:
        """Return the largest overload at the recorded rows as a share of a capacity, zero up to 0.1 %."""
        worst, notes = 0.0, []
        for load, most, names, units in self.recorded_loads(Variables(motion)):
            values = np.abs(load.value[:, 0])
            used = values / most[:, None]
            i, k = map(int, np.unravel_index(int(np.argmax(used)), used.shape))
            if used[i, k] > 1.0 + _ROUNDING:
                worst, at = max(worst, float(used[i, k]) - 1.0), f"at {motion.times[k]:.3g} s"
                load_text = f"'{names[i]}' has {values[i, k]:.3g} {units[i]} {at}"
                notes.append(f"{load_text}, its limit is {most[i]:.3g} {units[i]}")
        return Violation(worst, note="; ".join(notes))

    def recorded_loads(self, m: Variables) -> Loads:
        """Return the loads that are checked in a recording. Default: all loads."""
        return self.loads(m)


@dataclass(frozen=True)
class TorqueLimits(MotorLimits):
    """The limits of the joints' torques or forces, `sms.limits.torque`; an infinite limit has no effect.

    The torques H_q qdd + C_q include the effects of the base's reaction in its mode, and of the total
    momentum. A problem has this limit by default. Slack and violation are shares of a joint's limit; a
    violation of 0.3 is an overload of 30 %.
    """

    name = "torques"
    broken = "the joint torques would be too large"
    lacks = "'{0}' would need {1:.4g} {2} at {3:.3g} s and has {4:.4g} {2}"

    def loads(self, m: Variables) -> Loads:
        """Return the joint torques."""
        robot: Any = m.rollouts.stack.robot
        most = robot.limits.torque
        units = ["N m" if turns else "N" for turns in robot.layout.turns]
        return [(m.torques, most, robot.joint_names, units)] if np.isfinite(most).any() else []

    def rows(self, step: StepState) -> Rows | None:
        """Return a row of unit norm [rad/s] for each joint that could exceed 92 % of its limit in the step.

        The torques H_q (u - u_0) / dt + C_q are linear in the joint rates u at the step's end; u_0 are the
        rates at the step's start.
        """
        if not np.isfinite(step.sms.limits.torque).any():
            return None
        stack, (low, high), dt, u = step.sms.arm_stack(step.mode), step.bounds, step.dt, step.rates
        C = forces(stack, step.joints, u, np.zeros(len(u)), step.drift[3:])[: len(u)]
        H = stack.reduced_inertia(step.joints)
        allowed = (1.0 - SHARE) * step.sms.limits.torque
        near = np.abs(C) + np.abs(H) @ np.maximum(high - u, u - low) / dt > allowed
        if not near.any():
            return None
        H = H[near]
        middle, slack = H @ u - dt * C[near], dt * allowed[near]
        return reachable_rows(step, H, middle - slack, middle + slack)

    def speed_bound(self, motion: Rollouts) -> SpeedBound:
        """Return the bounds on the speed along a path from the torque limits.

        Without momentum the torques are linear in s'' and s'^2.
        """
        robot: Any = motion.stack.robot
        q, slope, most = motion.joints[:, 0], motion.rates[:, 0], robot.limits.torque
        bends = np.gradient(slope, motion.times, axis=1, edge_order=2)
        by_change = forces(motion.stack, q, np.zeros_like(q), slope)[: len(q)]
        by_speed = forces(motion.stack, q, slope, bends)[: len(q)]
        return SpeedBound(np.zeros(len(q)), by_change, np.full(len(q), np.inf), most, by_speed)


def reachable_rows(step: StepState, G: FloatArray, lower: FloatArray, upper: FloatArray) -> Rows:
    """Return rows lower <= G u <= upper with unit norm, and bounds relaxed to reachable values."""
    size = np.linalg.norm(G, axis=1)
    G, lower, upper = G / size[:, None], lower / size, upper / size
    least, most = step.bounds
    ends = G * least, G * most
    lowest, highest = (np.sum(pick(*ends), axis=1) for pick in (np.minimum, np.maximum))
    slack = 1e-3 * (highest - lowest)
    return Rows(G, np.minimum(lower, highest - slack), np.maximum(upper, lowest + slack))

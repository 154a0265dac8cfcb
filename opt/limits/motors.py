"""What motors can do, as limits of the plan: torques of the joints, torques and momenta of the wheels."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows, Violation
from ffsms_pin.opt.limits.motion import SCALE, SHARE
from ffsms_pin.opt.motion import Feature, Features
from ffsms_pin.opt.motion.mechanics import forces, held_momentum, wheel_shares
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.parts.inequality import Inequality
from ffsms_pin.opt.step.state import StepState

# What motors must give (c, S, K), the most that they have (c,), their names, and their units.
Loads: TypeAlias = list[tuple[Feature, FloatArray, Sequence[str], Sequence[str]]]


class _Motors(Inequality):
    """In shares of what a motor has."""

    margin = SCALE * SHARE
    scale = 1.0 / SCALE
    in_hand = SHARE
    most_reserve = 0.5 - SHARE  # with less than half left it would hold plans back more than motors do
    eased_by_time = True
    broken: str  # what is broken, in words
    lacks: str  # and of a motor: its name, what it needs, the unit, when, what it has, and what would do

    @abstractmethod
    def loads(self, m: Features) -> Loads:
        """Each kind of load."""

    def room(self, m: Features) -> list[Feature]:
        """Shares that are left."""
        return [1.0 - abs(load) / most for load, most, *_ in self.loads(m)]

    def violation(self, motion: Motions) -> Violation:
        """The largest share by which a motor lacks something, on both sides of every node."""
        sides = (self.loads(Features(one)) for one in (motion, motion.before))
        worst, notes, binds = 0.0, [], np.zeros(len(motion.times), dtype=bool)
        for (load, most, names, units), (before, *_) in zip(*sides, strict=True):
            values = np.abs(load.value[:, 0])
            values[:, ::2] = np.maximum(values[:, ::2], np.abs(before.value[:, 0]))
            used = values / most[:, None]
            # A little less than what is kept in hand leaves binds.
            binds |= (used > 0.91).any(axis=0)
            # Motors that do the same by symmetry differ by rounding: the first of them is named.
            i, k = np.unravel_index(int(np.argmax(used.round(9))), used.shape)
            if used[i, k] > 1.0:
                worst = max(worst, float(used[i, k]) - 1.0)
                has = (names[i], values[i, k], units[i], motion.times[k], most[i], values.max())
                notes.append(self.lacks.format(*has))
        return Violation(worst, motion.times[binds], f"{self.broken}: {'; '.join(notes)}" if notes else "")


@dataclass(frozen=True)
class TorqueLimits(_Motors):
    """The joints' largest torques, or forces, `sms.limits.torque`; an infinite one limits nothing.

    Exact: H_q qdd + C_q with the base reacting as its mode lets it, the total momentum included. A problem
    has this limit by default. Its unit is a share: a violation of 0.3 asks for 30 % more than the joint has.
    """

    name = "torques"
    broken = "the joint torques would be too large"
    lacks = "'{0}' would need {1:.4g} {2} at {3:.3g} s and has {4:.4g} {2}"

    def loads(self, m: Features) -> Loads:
        """The torques."""
        robot: Any = m.motions.stack.robot
        most = robot.limits.torque
        units = ["N m" if turns else "N" for turns in robot.layout.turns]
        return [(m.torques, most, robot.joint_names, units)] if np.isfinite(most).any() else []

    def rows(self, step: StepState) -> Rows | None:
        """Rows of unit length, in rad/s: H_q (u - u_0) / dt + C_q, linear in the rates u at the step's end.

        Of the joints that could ask for too much in this step.
        """
        if not np.isfinite(step.sms.limits.torque).any():
            return None
        stack, (low, high), dt, u = step.sms.arm_stack(step.mode), step.bounds, step.dt, step.rates
        C = forces(stack, step.joints, u, np.zeros(len(u)), step.drift[3:])[: len(u)]
        H = stack.reduced_inertia(step.joints)
        allowed = (1.0 - SHARE - self.kept) * step.sms.limits.torque
        near = np.abs(C) + np.abs(H) @ np.maximum(high - u, u - low) / dt > allowed
        if not near.any():
            return None
        H = H[near]
        middle, room = H @ u - dt * C[near], dt * allowed[near]
        return _reachable(step, H, middle - room, middle + room)


@dataclass(frozen=True)
class WheelLimits(_Motors):
    """The wheels' largest torques and momenta, where wheels hold the attitude (mode "rotation-floating").

    Momentum follows from the conservation of angular momentum, torque is its rate, with the friction of the
    bearings made good. A problem in that mode, of a robot with wheels, has this limit of itself. Its unit is
    a share of what the wheel has: a violation of 0.3 asks for 30 % more.
    """

    name = "wheels"
    broken = "the wheels would saturate"
    lacks = "{0} would need {1:.3g} {2} at {3:.3g} s and has {4:.3g} {2}; wheels of {5:.3g} {2} would do"

    def loads(self, m: Features) -> Loads:
        """Momenta and torques; none without wheels."""
        wheels = m.motions.wheels
        if wheels is None:
            return []
        momenta, torques, count = (m.wheels, wheels.momentum), (m.wheel_torques, wheels.torque), len(wheels)
        return [(*momenta, wheels.names, ["N m s"] * count), (*torques, wheels.names, ["N m"] * count)]

    def rows(self, step: StepState) -> Rows | None:
        """Rows in rad/s, of unit length, one a wheel; None where no wheels hold the attitude, or none moves.

        With D the angular momentum a joint rate (`opt.motion.mechanics`), u_0 the joint rates at the step's
        start and u those at its end, a wheel's torque is A^+ D (u_0 - u) / dt beside the one of now, and its
        momentum follows: both are bounds on the same sum of joint rates. Where both cannot be kept, the
        motor's torque is. Wheels that feel the same sum, as all do that a planar arm moves, share a row.
        """
        wheels = step.wheels
        if wheels is None:
            return None
        m, dt, left = step.features, step.dt, 1.0 - (SHARE + self.kept)
        G = wheel_shares(wheels) @ held_momentum(m.arm)[..., 0, 0]
        now, torque = m.wheels.value[:, 0, 0], m.wheel_torques.value[:, 0, 0]
        rubbing = -wheels.friction_torque(now / wheels.inertia) if wheels.rubs else np.zeros(len(wheels))
        middle, room = G @ step.rates + dt * torque, dt * np.minimum(left * wheels.torque, UNBOUNDED)
        lower, upper = middle - room, middle + room
        middle, room = middle + now - dt * rubbing, np.minimum(left * wheels.momentum, UNBOUNDED)
        lower = np.maximum(lower, np.minimum(middle - room, upper))
        upper = np.minimum(upper, np.maximum(middle + room, lower))
        kept: list[tuple[FloatArray, float, float]] = []
        for row, low, up in zip(G, lower, upper, strict=True):
            _share(kept, row, float(low), float(up))
        return _reachable(step, *map(np.array, zip(*kept, strict=True))) if kept else None

    def violation(self, motion: Motions) -> Violation:
        """Likewise; and what of the arm's momentum no wheel can take."""
        found, wheels = super().violation(motion), motion.wheels
        if wheels is None:
            return found
        taken = Features(motion).arm_momentum.value[:, 0]
        rest = np.abs(taken - wheels.axes.T @ (wheel_shares(wheels) @ taken)).max()
        if rest <= 1e-6 * max(float(np.abs(taken).max()), 1e-9):  # rounding
            return found
        note = f"{rest:.3g} N m s of the arm's momentum are about an axis that no wheel has"
        note = f"{found.note or self.broken}{'; ' if found.note else ': '}{note}"
        return found._replace(amount=max(found.amount, 1.0), note=note)


def _share(kept: list[tuple[FloatArray, float, float]], row: FloatArray, low: float, up: float) -> None:
    """Add a row; of those that are parallel one is kept, with the bounds of all: a solver asks for that."""
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


def _reachable(step: StepState, G: FloatArray, lower: FloatArray, upper: FloatArray) -> Rows:
    """Rows of unit length, each asking for what comes nearest of what the joints can do in the step."""
    size = np.linalg.norm(G, axis=1)
    G, lower, upper = G / size[:, None], lower / size, upper / size
    least, most = step.bounds
    ends = G * least, G * most
    lowest, highest = (np.sum(pick(*ends), axis=1) for pick in (np.minimum, np.maximum))
    room = 1e-3 * (highest - lowest)
    return Rows(G, np.minimum(lower, highest - room), np.maximum(upper, lowest + room))

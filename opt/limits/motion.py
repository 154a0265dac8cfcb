"""Limits on how joints and base move, and the paper's box on its scaling factors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, limit
from ffsms_pin.opt.limits.limit import Limit, Rows, Violation
from ffsms_pin.opt.motion import Feature, Features
from ffsms_pin.opt.motion.mechanics import singular
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.parts.inequality import AllOf, Inequality
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import JointLimits as Limits

_UNITS = {"attitude": "rad", "attitude_rate": "rad/s", "translation": "m", "final_attitude": "rad"}
# Share of a limit kept in hand, as `Limit.margin`. With half of it re-planned motions ended up to 5 mm off
# their targets under a base limit of 1 degree, with this a hundredth of that.
SHARE = 0.08
# What a whole limit weighs: as much as a lack of clearance of this many arm lengths.
SCALE = 0.03
# [rad] A turn beyond a limit narrower than this weighs as if the limit were so wide: one of a tenth of a
# degree would be too stiff for a motion that is still finding its way.
_NARROW = 0.02
_STEP_SHARE = 0.03  # of a limit, kept in single steps against what happens within them


@dataclass(frozen=True)
class JointLimits(Limit):
    """The robot's own limits (`sms.limits`), at every instant and not only at nodes.

    In a step they are bounds on the joint rates; in a whole motion they are rows on the control points, which
    no solution breaks, so there is no residual.
    """

    name = "joints"
    joint_bounds: Limits | None = field(default=None, repr=False)

    def for_robot(self, sms: SpaceManipulator) -> JointLimits:
        """With the robot's limits."""
        return replace(self, joint_bounds=sms.limits)

    def rows(self, step: StepState) -> Rows:
        """Bounds on the joint rates that leave room to brake."""
        return Rows(np.eye(step.sms.n), *step.bounds)

    def residual(self, motions: Motions) -> list[Feature]:
        """None: the control points keep the limits."""
        return []

    def violation(self, motion: Motions) -> Violation:
        """The largest excess of a joint's rate, acceleration or position, between instants too."""
        robot: Any = motion.stack.robot
        limits = robot.limits if self.joint_bounds is None else self.joint_bounds
        joints, rates, steps = motion.joints[:, 0], motion.rates[:, 0], np.diff(motion.times)
        accelerations = np.diff(rates, axis=1) / steps
        # Where a joint turns before the next instant, it goes further than at both.
        both, turns = np.stack([joints, joints]), rates[:, :-1] * rates[:, 1:] < 0.0
        both[1, :, :-1][turns] -= rates[:, :-1][turns] ** 2 / (2.0 * accelerations[turns])
        left = np.minimum(both - limits.lower[:, None], limits.upper[:, None] - both).min(axis=0)
        faster = limits.velocity[:, None] - np.abs(rates)
        harder = limits.acceleration[:, None] - np.abs(accelerations)
        rounding = 1e-12  # of sums over a thousand nodes
        kinds = (
            ("position", left, limits.upper - limits.lower, "rad", rounding),
            ("rate", faster, limits.velocity, "rad/s", rounding),
            ("acceleration", harder, limits.acceleration, "rad/s^2", rounding / float(steps.min())),
        )
        amount, notes, binds = 0.0, [], np.zeros(len(motion.times), dtype=bool)
        for kind, room, whole, unit, least in kinds:
            near = room < 1e-3 * np.where(np.isfinite(whole), whole, 1.0)[:, None]
            binds[: room.shape[1]] |= near.any(axis=0)
            joint, k = np.unravel_index(int(np.argmin(room)), room.shape)
            worst = -float(room[joint, k])
            if worst > least:
                amount, by = max(amount, worst), f"{worst:.3g} {unit} at {motion.times[k]:.3g} s"
                notes.append(f"the {kind} limit of '{robot.joint_names[joint]}' is broken by {by}")
        return Violation(amount, motion.times[binds], "; ".join(notes))


@dataclass(frozen=True)
class AlphaBox(Inequality):
    """The paper's |alpha_i| <= 1, with joint rates = V alpha.

    The paper's step has it always, as printed; whole motions on request. V only turns, so the box says that
    no principal direction of the coupling moves faster than 1 rad/s.
    """

    name = "alpha box"
    unit = "rad/s"
    scale = 1.0
    margin = 0.02

    def room(self, m: Features) -> Any:
        """What is left of each |alpha_i| <= 1.

        Slopes by the joint rates are the columns of V. Those by the coupling follow from the eigenvectors of
        C^T C: dv_i = sum over j of v_j (v_j^T d(C^T C) v_i) / (lambda_i - lambda_j).
        """
        rates, C = m.motions.rates, m.motions.arm.coupling
        n, shape = len(rates), rates.shape[1:]
        C = C.reshape(6, n, -1)
        sigma, V = singular(C)
        alpha = np.einsum("bmi,mb->ib", V, rates.reshape(n, -1))

        def slopes() -> dict[str, FloatArray]:
            CV = np.einsum("kmb,bmi->kib", C, V)
            s = np.pad(sigma, ((0, n - len(sigma)), (0, 0)))
            apart = s[:, None] - s
            # v_i itself, and directions that are alike, have none of their own.
            gap = np.where(np.abs(apart) <= 1e-8 * s[0], np.inf, apart * (s[:, None] + s))
            along = np.einsum("bmj,ijb->imb", V, alpha / gap)
            slope = np.einsum("kib,imb->ikmb", CV, along)
            slope += np.einsum("kmb,imb,bni->iknb", C, along, V)
            return {
                "by_rates": V.transpose(2, 1, 0).reshape(n, n, *shape),
                "by_coupling": slope.reshape(n, 6, n, *shape),
            }

        return 1.0 - abs(m.feature(alpha.reshape(n, *shape), slopes))

    def rows(self, step: StepState) -> Rows:
        """Rows -1 <= V^T u <= 1, exactly as printed.

        V turns from step to step, so fast joint rates that were within the box may now be outside. The box is
        kept without giving way where an arm that brakes as fast as its joints may is within it at the step's
        end; elsewhere it gives way by the slack that the step returns (`Step.slack`), as little as possible.
        """
        one = np.ones(step.sms.n)
        # V turns without stretching: within the ball of radius 1 all rates are in the box.
        slow = step.rates.dot(step.rates) <= 1.0
        kept = slow or np.abs(step.V.T.dot(np.clip(0.0, *step.bounds))).max() <= 1.0
        # It gives way so fast that the clearances, which share the slack, give way by centimetres a second at
        # most; still some times dearer than any speed or direction gained by it [rad/m].
        return Rows(step.V.T, -one, one, 0.0 if kept else 10.0)

    def violation(self, motion: Motions) -> Violation:
        """The largest |alpha_i| beyond 1: each step's rates in the basis of its start, as printed."""
        most = np.abs(motion.paired.alpha).max(axis=1)
        binds = motion.times[2::2][most > 1.0 - self.margin]
        largest = float(most.max(initial=0.0))
        if largest <= 1.0 + 1e-6:  # what a solver may leave
            return Violation(0.0, binds)
        note = f"|alpha_i| reaches {largest:.4g}, the paper's box asks for at most 1"
        return Violation(largest - 1.0, binds, note)


class _Most(Inequality):
    """One of the limits: something of the base is at most so large."""

    margin = SCALE * SHARE
    give = 0.1  # [rad/m] dearer than a clearance: moving the arm by as much turns the base by far less
    trusted = 0.02  # [rad/s] to undo a turn of the base before the deadline

    def __init__(self, name: str, most: float) -> None:
        self.name, self.most, self.unit = name, most, _UNITS[name]
        narrow = _NARROW if self.unit == "rad" else 0.0
        self.scale, self.in_hand = max(most, narrow) / SCALE, SHARE * most
        self.step_margin = _STEP_SHARE * most

    def room(self, m: Features) -> Any:
        """What is left of it."""
        if self.name == "translation":
            return self.most - (m.base - m.motions.base_start).norm()
        if self.name == "attitude_rate":
            return self.most - m.base_spin.norm()
        allowed: Any = self.most
        if self.name == "final_attitude":  # counts at the end, and closes in as steps near the deadline
            if m.step is None:
                allowed = np.where(m.motions.times >= m.duration, self.most, math.inf)[None]
            else:  # ten steps before it
                allowed = self.most + self.trusted * np.maximum(m.duration - 10.0 * m.step.dt - m.time, 0.0)
        return allowed - m.base.angle_from(m.motions.rotation_start)

    def note(self, room: float, time: float) -> str:
        """What is broken, in words."""
        most, largest = (f"{x:.4g} {self.unit}" for x in (self.most, self.most - room))
        return f"{self.name} {most}, the largest found is {largest}"


@dataclass(frozen=True)
class BaseLimits(AllOf):
    """Limits on the base's motion. The default of each, infinity, is no limit.

    Attributes
    ----------
    attitude : float
        Largest turn of the base from its attitude at the start, at any time [rad].
    attitude_rate : float
        Largest angular speed [rad/s].
    translation : float
        Largest distance of the base's centre of mass from where it started [m].
    final_attitude : float
        Largest turn that is left at the end [rad].

    Raises
    ------
    InvalidValue
        A limit that is not a number above zero.
    """

    attitude: float = math.inf
    attitude_rate: float = math.inf
    translation: float = math.inf
    final_attitude: float = math.inf
    name = "base"
    of_paper = False
    margin = SCALE * SHARE

    def __post_init__(self) -> None:
        for name, unit in _UNITS.items():
            limit(f"base_limits.{name}", getattr(self, name), unit)

    @property
    def none(self) -> bool:
        """Whether nothing is limited."""
        return not self.parts

    @property
    def holds_attitude(self) -> bool:  # type: ignore[override]  # plain elsewhere
        """Whether the attitude is limited, on the way or at the end."""
        return min(self.attitude, self.final_attitude) < math.inf

    @property
    def in_braking(self) -> BaseLimits | None:  # type: ignore[override]  # plain elsewhere
        """In the reaction null space rows do not see what acceleration a fast motion takes to stay there.

        An arm that stops may use half of what rows keep. Nothing looks ahead to the end.
        """
        left = 1.0 - 0.5 * _STEP_SHARE
        most = [left * one for one in (self.attitude, self.attitude_rate, self.translation)]
        return BaseLimits(*most) if min(most) < math.inf else None

    @cached_property
    def parts(self) -> list[Inequality]:
        """One for each that is limited."""
        given = ((name, getattr(self, name)) for name in _UNITS)
        return [_Most(name, most) for name, most in given if most < math.inf]

    def told(self, notes: list[str]) -> str:
        """What is broken, in words."""
        return f"the base limit is broken: {'; '.join(notes)}"

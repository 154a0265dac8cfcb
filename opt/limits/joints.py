"""Limits on the joint rates: what the joints can do, and the paper's box on its scaling factors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import Limit, Rows, Violation
from ffsms_pin.opt.motion import Feature, Features
from ffsms_pin.opt.motion.mechanics import singular
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.parts.inequality import Inequality
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.system import JointLimits as Limits, SpaceManipulator


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
        return Rows(step.sms.limits.each, *step.bounds)

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
                amount = max(amount, worst)
                notes.append(
                    f"the {kind} limit of '{robot.joint_names[joint]}' is broken by {worst:.3g} {unit} "
                    f"at {motion.times[k]:.3g} s"
                )
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
        _, V = singular(C)
        alpha = np.einsum("bmi,mb->ib", V, rates.reshape(n, -1))

        def slopes() -> dict[str, FloatArray]:
            CV = np.einsum("kmb,bmi->kib", C, V)
            lambdas = np.sum(CV**2, axis=0)
            gap = lambdas[:, None] - lambdas
            # v_i itself, and directions that are alike, have none of their own.
            gap = np.where(np.abs(gap) < 1e-9, np.inf, gap)
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
        return Violation(
            largest - 1.0, binds, f"|alpha_i| reaches {largest:.4g}, the paper's box asks for at most 1"
        )

"""What keeps the arm clear of itself, of the base and of obstacles, as a limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ffsms_pin.checks import number, one_of, pose
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.limits.clearance.between import least_of
from ffsms_pin.opt.limits.clearance.bodies import chosen_mode, payload_part
from ffsms_pin.opt.limits.clearance.body_stack import BodyStack
from ffsms_pin.opt.limits.clearance.obstacle import Obstacle, checked_obstacles, convex_shape
from ffsms_pin.opt.limits.clearance.points import PointStack
from ffsms_pin.opt.limits.clearance.rows import clearance_rows
from ffsms_pin.opt.limits.clearance.stack import ClearanceStack
from ffsms_pin.opt.limits.limit import Limit, Rows, Violation, stacked
from ffsms_pin.opt.motion import Features
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Residual, Residuals
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.stacks import apply, cross
from ffsms_pin.system.convex_parts import Part

__all__ = ["Clearance", "CollisionMode", "clearance_stack"]

CollisionMode = str
MODES = ("auto", "points", "hulls", "shapes", "off")

_BODY_MARGIN = 3e-3  # [arm lengths] `Clearance.margin` between bodies
_LEAST_LACK = 1e-5  # [m] a clearance that counts as broken lacks at least so much
_BINDING = 1e-3  # [m] with less than this left beside the margin the limit binds


@dataclass(frozen=True)
class Clearance(Limit):
    """Distances within the arm, from the arm to the base, and from both to obstacles.

    Attributes
    ----------
    clearance : float
        The paper's d_safe, and the margin to the base and to obstacles [m].
    collision : {"auto", "points", "hulls", "shapes", "off"}
        What is kept apart: the paper's points and the base's box (const4 to const7); the URDF's collision
        shapes in convex parts ("hulls"), or as they are ("shapes"), which takes much longer; or nothing.
        "auto": hulls where bodies with shapes can meet, points where none can and for planar arms. Obstacles
        are kept from the hulls in all modes but "points", also in "off", and from points with the straight
        lines between them in "points" and where the robot has no shapes.
    margin : float
        What whole motions keep beside the clearance while they are searched for [arm lengths].
    obstacles : sequence of Obstacle
    payload : (coal shape, pinocchio.SE3), optional
        What the end effector holds, convex, and where it is in the end-effector frame. It is kept from
        obstacles, and from the robot's own bodies as a part of the one that holds it.
    reserve, began : float
        See `Limit` [m], [s]: obstacles that move are seen from when the motion began.
    """

    clearance: float = 0.01
    collision: CollisionMode = "auto"
    # A penalty gives way, and only some instants of a whole motion are watched.
    margin: float = 0.01
    obstacles: Sequence[Obstacle] = ()
    payload: tuple[Any, Any] | None = None
    reserve: float = 0.0
    began: float = 0.0
    name = "clearance"
    blocks = True
    refusal = "the start breaks the clearance: {note}; move the start, or ask for less"
    _stack: ClearanceStack | None = field(default=None, repr=False)
    _around: BodyStack | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        number("clearance", self.clearance)
        one_of("collision", self.collision, MODES)
        object.__setattr__(self, "obstacles", checked_obstacles(self.obstacles))
        if self.payload is not None:
            if not isinstance(self.payload, tuple) or len(self.payload) != 2:
                raise InvalidValue("payload", self.payload, "must be a coal shape and its pinocchio.SE3")
            pose("payload[1]", self.payload[1])
            held = convex_shape("payload[0]", self.payload[0]), self.payload[1]
            object.__setattr__(self, "payload", held)

    def for_robot(self, sms: SpaceManipulator) -> Clearance:
        """With the robot's points or shapes."""
        held = None if self.payload is None else payload_part(sms, *self.payload)
        around = None
        if self.obstacles:
            seen = [one.later(self.began) for one in self.obstacles]
            around = BodyStack(sms, self.collision, self.clearance, held, seen)
            around = around if around.names else None
        last = self._stack
        if (
            isinstance(last, BodyStack)
            and self.collision in ("auto", last.mode)
            and last.serves(sms, self.clearance, held)
        ):
            # Planned again: the masses are others, the shapes are not.
            return replace(self, _around=around)
        mode = chosen_mode(sms) if self.collision == "auto" else self.collision
        stack = clearance_stack(sms, mode, self.clearance, held)
        # Neighbours but one are hardly further apart than this in any posture, so bodies are given less than
        # points.
        margin = _BODY_MARGIN if isinstance(stack, BodyStack) else self.margin
        return replace(self, _stack=stack, margin=margin, _around=around)

    @property
    def _stacks(self) -> list[ClearanceStack]:
        return [stack for stack in (self._stack, self._around) if stack is not None]

    @property
    def left_out(self) -> list[str]:
        """Pairs of bodies that are nearer than the clearance by construction, and so are not kept apart."""
        return list(self._stack.left_out) if isinstance(self._stack, BodyStack) else []

    def least(self, motions: Motions) -> tuple[float, str]:
        """The least clearance [m] of motions, and between what; infinite where nothing is kept apart."""
        found = [(np.inf, "")]
        for stack in self._stacks:
            values = stack.values(stack.seen(motions)).min(axis=1)
            found.append((float(values.min()), stack.names[int(np.argmin(values))]))
        return min(found)

    def rows(self, step: StepState) -> Rows | None:
        """A clearance may shrink at most at a rate proportional to what is left of it."""
        asked = self.clearance + self.reserve
        return stacked([clearance_rows(stack, asked, step) for stack in self._stacks])

    def residual(self, m: Features) -> Residuals:
        """What clearances lack of the asked one and the margin, in arm lengths."""
        return [one for stack in self._stacks for one in self._lack(stack, m.motions)]

    def _lack(self, stack: ClearanceStack, motions: Motions) -> Residuals:
        length = motions.stack.length
        # Bodies that are near each other in every posture cannot be asked for the whole margin.
        asked = self.clearance + self.reserve
        kept = np.minimum(asked + self.margin * length, 0.5 * (asked + stack.largest))
        poses = stack.seen(motions)
        (columns, at), found = stack.below(poses, kept)
        if not columns.size:
            return []
        gradients, (here, _, normal) = stack.slopes(poses, (columns, at), found)
        slopes: dict[str, Any] = {"by_joints": gradients}
        motion, instants = np.unravel_index(at, motions.joints.shape[1:])
        if stack.obstacles:
            # When the base moves, the nearest point of the body moves with it and that of the obstacle stays.
            R = motions.base_attitude[:, :, motion, instants]
            normal = stack.passes[columns] * apply(R, normal)
            lever = apply(R, here - motions.stack.base_com[:, None])
            slopes |= {"by_base": -normal, "by_base_turn": -cross(lever, normal)}
        slopes = {name: -slope / length for name, slope in slopes.items()}
        value = (kept[columns] - found.distance) / length
        return [Residual(value, motion=motion, instants=instants, **slopes)]

    def violation(self, motion: Motions) -> Violation:
        """The largest lack of clearance at the nodes, in the middles, and between shapes everywhere."""
        near = self.margin * motion.stack.length + _BINDING
        found = [(least_of(stack, motion, self.clearance, near), stack) for stack in self._stacks]
        if not found:
            return Violation()
        instants = np.unique(np.concatenate([least.near for least, _ in found]))
        broken = [one for one in found if self.clearance - one[0].value > one[1].tolerance]
        worst, stack = min(broken or found, key=lambda one: one[0].value)
        pair, distance = stack.names[worst.pair], 1e3 * worst.value
        kept = Violation(0.0, instants, nearest=f"{pair}, which come within {distance:.1f} mm")
        if not broken:
            return kept
        note = (
            f"a clearance is broken: {pair} is {distance:.1f} mm at "
            f"{worst.time:.3g} s, {1e3 * self.clearance:.1f} mm are asked for"
        )
        deep = 1e3 * self._around.overlap(worst.pair, worst.value) if stack is self._around else 0.0
        overlap = f"{pair} overlap by {deep:.1f} mm" if deep > 0.0 else ""
        amount = max(self.clearance - worst.value, _LEAST_LACK)
        return kept._replace(amount=amount, note=note, overlap=overlap)


def clearance_stack(
    sms: SpaceManipulator, collision: str, clearance: float = 0.0, payload: Part | None = None
) -> ClearanceStack | None:
    """What a mode keeps apart of a robot itself; None for "off", and where nothing can come near anything.

    Parameters
    ----------
    sms : SpaceManipulator
    collision : {"points", "hulls", "shapes", "off"}
        See `Clearance`; "auto" is chosen by `chosen_mode`.
    clearance : float
        What is asked for: pairs of bodies that are always nearer are left out [m].
    payload : Part, optional
        What the end effector holds; for "hulls" and "shapes".

    Raises
    ------
    InvalidValue
        The mode is not known, or the robot has no base box ("points") or no shapes that can meet.
    """
    if collision == "off":
        return None
    if collision not in MODES or collision == "auto":
        raise InvalidValue("collision", collision, 'must be "points", "hulls", "shapes" or "off"')
    stack = PointStack(sms) if collision == "points" else BodyStack(sms, collision, clearance, payload)
    return stack if stack.names else None

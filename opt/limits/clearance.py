"""What keeps the arm clear of itself, of the base and of obstacles, as a limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ffsms_pin.checks import FloatArray, number, one_of, pose
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Indices, Residual, Residuals
from ffsms_pin.opt.limits.between import TOLERANCE, Least, least_of_bodies
from ffsms_pin.opt.limits.body_model import BodyModel
from ffsms_pin.opt.limits.body_stack import BodyStack
from ffsms_pin.opt.limits.clearance_rows import clearance_rows
from ffsms_pin.opt.limits.clearance_stack import ClearanceStack, chosen_mode, clearance_stack
from ffsms_pin.opt.limits.limit import Failed, Limit, Rows, Violation, stacked
from ffsms_pin.opt.limits.obstacles.at_start import check_obstacles
from ffsms_pin.opt.limits.obstacles.bodies import payload_part
from ffsms_pin.opt.limits.obstacles.judged import least_of_obstacles
from ffsms_pin.opt.limits.obstacles.obstacle import Obstacle, checked_obstacles, convex_shape
from ffsms_pin.opt.limits.obstacles.rows import obstacle_rows
from ffsms_pin.opt.limits.obstacles.stack import ObstacleStack
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.system import SpaceManipulator

if TYPE_CHECKING:
    from ffsms_pin.opt.problem import Problem

__all__ = ["Clearance", "CollisionMode"]

CollisionMode = str
MODES = ("auto", "points", "hulls", "shapes", "off")

# [m] Clearances of finished motions are looked at twice a step; what they can lose in between is a few
# micrometres.
_BETWEEN = 1e-5
_BODY_MARGIN = 3e-3  # [arm lengths] `Clearance.margin` between bodies
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
    """

    clearance: float = 0.01
    collision: CollisionMode = "auto"
    # A penalty gives way, and only some instants of a whole motion are watched.
    margin: float = 0.01
    obstacles: Sequence[Obstacle] = ()
    payload: tuple[Any, Any] | None = None
    name = "clearance"
    blocks = True
    _stack: ClearanceStack | None = field(default=None, repr=False)
    _model: Any = field(default=None, repr=False)
    _around: ObstacleStack | None = field(default=None, repr=False)

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
        around = ObstacleStack(sms, self.obstacles, self.collision, held) if self.obstacles else None
        last = self._stack
        if (
            isinstance(last, BodyStack)
            and self.collision in ("auto", last.mode)
            and last.serves(sms, self.clearance, held)
        ):
            # Planned again: the masses are others, the shapes are not. A model is for one thread.
            return replace(self, _model=BodyModel(last), _around=around)
        mode = chosen_mode(sms) if self.collision == "auto" else self.collision
        stack = clearance_stack(sms, mode, self.clearance, held)
        if stack is None:
            return replace(self, _stack=None, _model=None, _around=around)
        model = BodyModel(stack) if isinstance(stack, BodyStack) else stack.points
        # Neighbours but one are hardly further apart than this in any posture, so bodies are given less than
        # points.
        margin = _BODY_MARGIN if isinstance(stack, BodyStack) else self.margin
        return replace(self, _stack=stack, _model=model, margin=margin, _around=around)

    @property
    def left_out(self) -> list[str]:
        """Pairs of bodies that are nearer than the clearance by construction, and so are not kept apart."""
        return list(self._stack.left_out) if isinstance(self._stack, BodyStack) else []

    def tightened(self, by: float) -> Clearance:
        """With a greater clearance."""
        return replace(self, clearance=self.clearance + by)

    def later(self, by: float) -> Clearance:
        """With obstacles that move seen from a later time."""
        return replace(self, obstacles=[one.later(by) for one in self.obstacles], _around=None)

    def least(self, motions: Motions) -> tuple[float, str]:
        """The least clearance [m] of motions, and between what; infinite where nothing is kept apart."""
        found = [(np.inf, "")]
        if self._stack is not None:
            values = self._stack.values(motions.joints, motions.arm).min(axis=(1, 2))
            found.append((float(values.min()), self._stack.names()[int(np.argmin(values))]))
        if self._around is not None:
            values = self._around.values(motions).min(axis=(1, 2))
            found.append((float(values.min()), self._around.names()[int(np.argmin(values))]))
        return min(found)

    def contact(self, q: FloatArray) -> tuple[float, str] | None:
        """The deepest overlap [m] of the robot at q (nq,) with an obstacle at time zero, and with which."""
        if self._around is None:
            return None
        distances = self._around.distances(q, 0.0)
        which = int(np.argmin(distances))
        return (-float(distances[which]), self._around.names()[which]) if distances[which] < 0.0 else None

    def check_start(self, problem: Problem, begin: Motions) -> str:
        """Whether bodies are too near to each other at the start, or a goal is inside an obstacle."""
        check_obstacles(problem, self.contact(problem.q0), self.obstacles)
        note = self.violation(begin).note
        if not note:
            return ""
        return f"the start breaks the clearance: {note}; move the start, or ask for less"

    def explain(self, failed: Failed) -> str:
        """What comes nearest to what."""
        distance, pair = self.least(failed.motion)
        return f"blocked by {pair}, which come within {1e3 * distance:.1f} mm" if pair else ""

    def rows(self, step: StepState) -> Rows | None:
        """A clearance may shrink at most at a rate proportional to what is left of it."""
        found = []
        if self._model is not None:
            found.append(clearance_rows(self._model, self.clearance, step))
        if self._around is not None:
            found.append(obstacle_rows(self._around, self.clearance, step))
        return stacked(found)

    def residual(self, motions: Motions) -> Residuals:
        """What clearances lack of the asked one and the margin, in arm lengths."""
        return [*self._own_residual(motions), *self.around_residual(motions)]

    def _own_residual(self, motions: Motions) -> Residuals:
        if self._stack is None:
            return []
        length = motions.stack.length
        kept: FloatArray = np.full(len(self._stack.names()), self.clearance + self.margin * length)
        if isinstance(self._stack, BodyStack):
            # Bodies that are near each other in every posture cannot be asked for the whole margin.
            kept = np.minimum(kept, 0.5 * (self.clearance + self._stack.largest))
            close, value, slope = self._stack.below(motions.joints, motions.arm, kept)
            return _lacking((kept[close[0]] - value) / length, close, by_joints=-slope / length)
        lack = kept[:, None, None] - self._stack.values(motions.joints, motions.arm, kept)
        where = np.nonzero(lack > 0.0)
        if not where[0].size:
            return []
        slope = self._stack.gradients(motions.stack, motions.joints, motions.arm, where)
        return _lacking(lack[where] / length, where, by_joints=-slope / length)

    def around_residual(self, motions: Motions) -> Residuals:
        """The part of the residual that is due to obstacles."""
        if self._around is None:
            return []
        length = motions.stack.length
        kept = self.clearance + self.margin * length
        where, value, slopes = self._around.below(motions, kept)
        by = {name: -slope / length for name, slope in slopes.items()}
        return _lacking((kept - value) / length, where, **by)

    def violation(self, motion: Motions) -> Violation:
        """The largest lack of clearance at the nodes, in the middles, and between shapes everywhere."""
        near = self.margin * motion.stack.length + _BINDING
        found: list[tuple[Least, str, float]] = []
        if isinstance(self._stack, BodyStack):
            least = least_of_bodies(self._stack, motion, self.clearance, near)
            found.append((least, self._stack.names()[least.pair], TOLERANCE))
        elif self._stack is not None:
            values = self._stack.values(motion.joints, motion.arm)[:, 0]
            which, k = np.unravel_index(int(np.argmin(values)), values.shape)
            instants = motion.times[values.min(axis=0) < self.clearance + near]
            least = Least(float(values[which, k]), int(which), float(motion.times[k]), instants)
            found.append((least, self._stack.names()[least.pair], -_BETWEEN))
        if self._around is not None:
            least = least_of_obstacles(self._around, motion, self.clearance, near)
            found.append((least, self._around.names()[least.pair], TOLERANCE))
        if not found:
            return Violation()
        instants = np.unique(np.concatenate([least.near for least, _, _ in found]))
        broken = [(least, pair) for least, pair, most in found if self.clearance - least.value > most]
        if not broken:
            return Violation(0.0, instants)
        worst, pair = min(broken, key=lambda one: one[0].value)
        note = (
            f"a clearance is broken: {pair} is {1e3 * worst.value:.1f} mm at "
            f"{worst.time:.3g} s, {1e3 * self.clearance:.1f} mm are asked for"
        )
        return Violation(max(self.clearance - worst.value, _BETWEEN), instants, note)


def _lacking(value: FloatArray, where: tuple[Indices, ...], **slopes: Any) -> Residuals:
    """The residual of entries (clearance, motion, instant), or none."""
    return [Residual(value, motion=where[1], instants=where[2], **slopes)] if value.size else []

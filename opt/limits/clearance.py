"""What keeps the arm clear of itself and of the base, as a limit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, number
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Residual, Residuals
from ffsms_pin.opt.limits.between import TOLERANCE, Least, least_of_bodies
from ffsms_pin.opt.limits.body_stack import BodyStack
from ffsms_pin.opt.limits.clearance_rows import BodyModel, clearance_model, clearance_rows
from ffsms_pin.opt.limits.clearance_stack import ClearanceStack, chosen_mode, clearance_stack
from ffsms_pin.opt.limits.limit import Limit, Rows, Violation
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.system import SpaceManipulator

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
    """Distances within the arm and from the arm to the base.

    Attributes
    ----------
    clearance : float
        The paper's d_safe, and the margin to the base [m].
    collision : {"auto", "points", "hulls", "shapes", "off"}
        What is kept apart: the paper's points and the base's box (const4 to const7); the URDF's collision
        shapes in convex parts ("hulls"), or as they are ("shapes"), which takes much longer; or nothing.
        "auto": hulls where bodies with shapes can meet, points where none can and for planar arms.
    """

    clearance: float = 0.01
    collision: CollisionMode = "auto"
    # [arm lengths] A penalty gives way, and only some instants of a whole motion are watched.
    margin: float = 0.01
    name = "clearance"
    _stack: ClearanceStack | None = field(default=None, repr=False)
    _model: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        number("clearance", self.clearance)
        if self.collision not in MODES:
            raise InvalidValue("collision", self.collision, f"must be one of {', '.join(MODES)}")

    def for_robot(self, sms: SpaceManipulator) -> Clearance:
        """With the robot's points or shapes."""
        mode = chosen_mode(sms) if self.collision == "auto" else self.collision
        stack = clearance_stack(sms, mode, self.clearance)
        if stack is None:
            return replace(self, _stack=None, _model=None)
        model = BodyModel(stack) if isinstance(stack, BodyStack) else clearance_model(sms, mode)
        # Neighbours but one are hardly further apart than this in any posture, so bodies are given less than
        # points.
        margin = _BODY_MARGIN if isinstance(stack, BodyStack) else self.margin
        return replace(self, _stack=stack, _model=model, margin=margin)

    @property
    def left_out(self) -> list[str]:
        """Pairs of bodies that are nearer than the clearance by construction, and so are not kept apart."""
        return list(self._stack.left_out) if isinstance(self._stack, BodyStack) else []

    def tightened(self, by: float) -> Clearance:
        """With a greater clearance."""
        return replace(self, clearance=self.clearance + by)

    def least(self, motions: Motions) -> tuple[float, str]:
        """The least clearance [m] of motions, and between what; infinite where nothing is kept apart."""
        if self._stack is None:
            return np.inf, ""
        values = self._stack.values(motions.joints, motions.arm).min(axis=(1, 2))
        which = int(np.argmin(values))
        return float(values[which]), self._stack.names()[which]

    def rows(self, step: StepState) -> Rows | None:
        """A clearance may shrink at most at a rate proportional to what is left of it."""
        return None if self._model is None else clearance_rows(self._model, self.clearance, step)

    def residual(self, motions: Motions) -> Residuals:
        """What clearances lack of the asked one and the margin, in arm lengths."""
        if self._stack is None:
            return []
        length = motions.stack.length
        kept: FloatArray = np.full(len(self._stack.names()), self.clearance + self.margin * length)
        if isinstance(self._stack, BodyStack):
            # Bodies that are near each other in every posture cannot be asked for the whole margin.
            kept = np.minimum(kept, 0.5 * (self.clearance + self._stack.largest))
        lack = kept[:, None, None] - self._stack.values(motions.joints, motions.arm, kept)
        where = np.nonzero(lack > 0.0)
        if not where[0].size:
            return []
        slope = self._stack.gradients(motions.stack, motions.joints, motions.arm, where)
        return [Residual(lack[where] / length, motion=where[1], instants=where[2], by_joints=-slope / length)]

    def violation(self, motion: Motions) -> Violation:
        """The largest lack of clearance at the nodes and in the middles between them."""
        if self._stack is None:
            return Violation()
        near = self.margin * motion.stack.length + _BINDING
        if isinstance(self._stack, BodyStack):
            found = least_of_bodies(self._stack, motion, self.clearance, near)
        else:
            values = self._stack.values(motion.joints, motion.arm)[:, 0]
            which, k = np.unravel_index(int(np.argmin(values)), values.shape)
            instants = motion.times[values.min(axis=0) < self.clearance + near]
            found = Least(float(values[which, k]), int(which), float(motion.times[k]), instants)
        lack = self.clearance - found.value
        if lack <= -_BETWEEN or (isinstance(self._stack, BodyStack) and lack <= TOLERANCE):
            return Violation(0.0, found.near)
        note = (
            f"a clearance is broken: {self._stack.names()[found.pair]} is {1e3 * found.value:.1f} mm at "
            f"{found.time:.3g} s, {1e3 * self.clearance:.1f} mm are asked for"
        )
        return Violation(max(lack, _BETWEEN), found.near, note)

"""Where the actuated joints stand in Pinocchio's q and v."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue, UnsupportedJoint

__all__ = ["JointLayout"]


class JointLayout:
    """Maps n joint positions to Pinocchio's q and back.

    A continuous joint takes two entries of q (cosine and sine), every other one entry; each has one in v.

    Attributes
    ----------
    n : int
        Number of actuated joints.
    names : list of str
        In the order of v.
    continuous : ndarray of bool, shape (n,)
        Which joints are continuous: one turn is where they were.
    turns : ndarray of bool, shape (n,)
        Which joints turn; the others slide.
    plain : bool
        Whether q[7:] are the joint positions themselves (no continuous joint).
    """

    def __init__(self, model: Any) -> None:
        if model.njoints < 2 or (model.joints[1].nq, model.joints[1].nv) != (7, 6):
            raise UnsupportedJoint(model.name, "the model's first joint is not a free-flyer")
        if not model.jointPlacements[1].isIdentity():
            raise UnsupportedJoint(model.name, "the free-flyer is not placed at the inertial origin")
        if model.njoints == 2:
            raise UnsupportedJoint(model.name, "the robot has no joint that moves; an arm needs at least one")
        self.names: list[str] = []
        joints = list(model.joints)[2:]
        for j in range(2, model.njoints):
            joint = model.joints[j]
            if joint.nv != 1 or joint.nq not in (1, 2):
                raise UnsupportedJoint(
                    model.name,
                    f"joint '{model.names[j]}' has {joint.nv} degrees of freedom; one is supported",
                )
            if model.parents[j] == 0:
                raise UnsupportedJoint(
                    model.name, f"joint '{model.names[j]}' is not carried by the free-flyer"
                )
            if model.parents[j] not in model.supports[j - 1]:
                # Pinocchio's inertia matrix is silently wrong for any other order.
                raise UnsupportedJoint(
                    model.name,
                    f"joint '{model.names[j]}' belongs to a branch before joint '{model.names[j - 1]}'; "
                    "add the joints of a branch one after the other (depth first)",
                )
            self.names.append(model.names[j])
        self.n = len(self.names)
        self._index = np.array([joint.idx_q for joint in joints])
        self.continuous = np.array([joint.nq == 2 for joint in joints])
        self.turns = np.array([not joint.shortname().startswith("JointModelP") for joint in joints])
        for array in (self.continuous, self.turns):
            array.setflags(write=False)
        self.plain = not self.continuous.any()

    def positions(self, q: FloatArray) -> FloatArray:
        """Joint positions (n,) of a configuration (nq,)."""
        if self.plain:
            return q[7:].copy()
        first, second = q[self._index], q[self._index + self.continuous]
        return np.asarray(np.where(self.continuous, np.arctan2(second, first), first))

    def set_positions(self, q: FloatArray, positions: FloatArray) -> None:
        """Write joint positions (..., n) into configurations (..., nq), in place."""
        if self.plain:
            q[..., 7:] = positions
            return
        circles = self.continuous
        q[..., self._index] = np.where(circles, np.cos(positions), positions)
        q[..., self._index[circles] + 1] = np.sin(positions[..., circles])

    def difference(self, q: FloatArray, positions: FloatArray) -> FloatArray:
        """Joint positions of q (nq,) less `positions` (n,); of a continuous joint the shorter way round.

        Other joints have a position beyond one turn, so their difference is taken as it is.
        """
        if self.plain:
            return q[7:] - positions
        difference = self.positions(q) - positions
        wrapped = (difference + math.pi) % (2.0 * math.pi) - math.pi
        return np.where(self.continuous, wrapped, difference)

    def check_circles(self, name: str, q: FloatArray) -> None:
        """Check that the cosine and sine of every continuous joint in q (nq,) make a unit vector."""
        for k, circle, joint in zip(self._index, self.continuous, self.names, strict=True):
            if circle and abs(np.hypot(q[k], q[k + 1]) - 1.0) > 1e-6:
                raise InvalidValue(
                    f"{name}[{k}:{k + 2}], the cosine and sine of joint '{joint}',",
                    q[k : k + 2],
                    "must have length 1",
                )

    def position_limits(self, model: Any) -> tuple[FloatArray, FloatArray]:
        """Lower and upper position limits (n,) as the model has them; infinite for continuous joints."""
        unlimited = np.where(self.continuous, np.inf, 0.0)
        lower, upper = model.lowerPositionLimit[self._index], model.upperPositionLimit[self._index]
        return lower - unlimited, upper + unlimited

    @staticmethod
    def body_name(model: Any, joint: int) -> str:
        """Name of the first body frame that the joint carries, for messages."""
        for frame in model.frames:
            if frame.parentJoint == joint and frame.name not in model.names:
                return str(frame.name)
        return str(model.names[joint])

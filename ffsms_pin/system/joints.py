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
        self._index: list[int] = []
        self._circle: list[bool] = []
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
            self._index.append(joint.idx_q)
            self._circle.append(joint.nq == 2)
        self.n = len(self.names)
        self.continuous = np.array(self._circle, dtype=bool)
        self.continuous.setflags(write=False)
        kinds = [joint.shortname() for joint in list(model.joints)[2:]]
        self.turns = np.array([not kind.startswith("JointModelP") for kind in kinds])
        self.turns.setflags(write=False)
        self.plain = not any(self._circle)

    def positions(self, q: FloatArray) -> FloatArray:
        """Joint positions (n,) of a configuration (nq,)."""
        if self.plain:
            return q[7:].copy()
        return np.array(
            [
                np.arctan2(q[k + 1], q[k]) if circle else q[k]
                for k, circle in zip(self._index, self._circle, strict=True)
            ]
        )

    def set_positions(self, q: FloatArray, positions: FloatArray) -> None:
        """Write joint positions (n,) into a configuration (nq,), in place."""
        if self.plain:
            q[7:] = positions
            return
        for k, circle, value in zip(self._index, self._circle, positions, strict=True):
            if circle:
                q[k], q[k + 1] = np.cos(value), np.sin(value)
            else:
                q[k] = value

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
        for k, circle, joint in zip(self._index, self._circle, self.names, strict=True):
            if circle and abs(np.hypot(q[k], q[k + 1]) - 1.0) > 1e-6:
                raise InvalidValue(
                    f"{name}[{k}:{k + 2}], the cosine and sine of joint '{joint}',",
                    q[k : k + 2],
                    "must have length 1",
                )

    def position_limits(self, model: Any) -> tuple[FloatArray, FloatArray]:
        """Lower and upper position limits (n,); infinite for continuous joints and where there is none."""
        lower, upper = np.full(self.n, -np.inf), np.full(self.n, np.inf)
        largest = np.finfo(np.float64).max
        for i, (k, circle) in enumerate(zip(self._index, self._circle, strict=True)):
            low, high = model.lowerPositionLimit[k], model.upperPositionLimit[k]
            if not circle and low > -largest:
                lower[i] = low
            if not circle and high < largest:
                upper[i] = high
        return lower, upper

    @staticmethod
    def body_name(model: Any, joint: int) -> str:
        """Name of the first body frame that the joint carries, for messages."""
        for frame in model.frames:
            if frame.parentJoint == joint and frame.name not in model.names:
                return str(frame.name)
        return str(model.names[joint])

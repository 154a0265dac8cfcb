"""What part of an error of the end effector an arm can correct: for a planar one, the part in its plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Changed, Goal, Place
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.stacks import apply, exp3

__all__ = ["Correctable"]

_SAMPLES = 8  # configurations that are looked at
_WEAK = 1e-3  # what moves the end effector by less than this share of the strongest direction is no way
_ROUNDING = 1e-6  # [m, rad] smaller errors that cannot be corrected are left alone


class Correctable:
    """The directions in which a robot can move its end effector at all, whatever its configuration.

    The range of J* over some configurations within the limits, in the root's axes: all of space for most
    arms, the plane of motion for one whose joint axes are parallel, to which the base then keeps as well.

    Parameters
    ----------
    sms : SpaceManipulator
    mode : str
        What of the base is held.
    """

    def __init__(self, sms: SpaceManipulator, mode: str = "floating") -> None:
        self._sms = sms
        lower, upper = np.maximum(sms.limits.lower, -np.pi), np.minimum(sms.limits.upper, np.pi)
        joints = np.random.default_rng(0).uniform(lower, upper, (_SAMPLES, sms.n)).T
        J = sms.arm_stack(mode).coupled(joints)[1].reshape(6, -1)
        self._shifts, self._turns = _range(J[:3]), _range(J[3:])

    @property
    def everything(self) -> bool:
        """Whether every error can be corrected."""
        return self._shifts is None and self._turns is None

    def goal(self, goal: Goal, q: FloatArray, t: float) -> tuple[Goal, float]:
        """The goal as far as the arm can come to it, and what distance is left however it moves [m].

        Parameters
        ----------
        goal : Goal
        q : ndarray, shape (nq,)
            Where the robot is.
        t : float
            The goal's place at this time counts for the distance [s].
        """
        if self.everything:
            return goal, 0.0
        here, place = self._sms.at(q).end_effector_pose, goal.place(t)
        root = np.eye(3) if place.moves_with_base else pin.XYZQUATToSE3(q[:7]).rotation
        shifts, turns = (
            np.eye(3) if part is None else root @ part @ root.T for part in (self._shifts, self._turns)
        )

        def projected(place: Place) -> Place:
            """Moved to where the arm can come: along what it cannot correct, it is where it is."""
            missed, times = place.missed(place.seen(here, q)), place.position.shape[1:]
            shift = np.tensordot(shifts - np.eye(3), missed.way.value, 1).reshape(3, *times)
            vector = missed.vector.reshape(3, *times)
            moved = place.moved(shift, apply(exp3(turns @ vector), exp3(-vector)))
            velocities = zip((shifts, turns), (place.velocity, place.spin), strict=True)
            velocity, spin = (None if one is None else part @ one for part, one in velocities)
            return replace(moved, velocity=velocity, spin=spin)

        vector = place.missed(place.seen(here, q)).vector[:, 0, 0]
        left = float(np.linalg.norm(place.position - projected(place).position))
        tilt = float(np.linalg.norm(vector - turns @ vector))
        if max(left, tilt) < _ROUNDING:
            return goal, 0.0
        return Changed(goal, projected), left


def _range(J: FloatArray) -> FloatArray | None:
    """Projection (3, 3) on the range of J (3, k); None where that is all of space."""
    directions, strengths, _ = np.linalg.svd(J, full_matrices=True)
    rank = int((strengths > _WEAK * strengths[0]).sum())
    return None if rank == 3 else directions[:, :rank] @ directions[:, :rank].T

"""What part of an error of the end effector an arm can correct: for a planar one, the part in its plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Goal, Place
from ffsms_pin.opt.goals.of_another import OfAnother
from ffsms_pin.opt.step.state import step_state
from ffsms_pin.system import SpaceManipulator

__all__ = ["Correctable", "Projected"]

_SAMPLES = 8  # configurations that are looked at
_WEAK = 1e-3  # what moves the end effector by less than this share of the strongest direction is no way
_ROUNDING = 1e-6  # [m, rad] smaller errors that cannot be corrected are left alone


@dataclass(frozen=True, eq=False)
class Projected(OfAnother):
    """A goal moved to where the arm can come: along what it cannot correct, it is where it is.

    Attributes
    ----------
    goal : Goal
    through : pinocchio.SE3
        The end effector's pose now.
    shifts, turns : ndarray, shape (3, 3)
        Projections on the directions in which it can be moved, and about which it can be turned; inertial
        axes.
    """

    through: pin.SE3
    shifts: FloatArray
    turns: FloatArray

    def approach(self, duration: float) -> list[tuple[float, Place]]:
        """The other's, projected."""
        return [(t, self._projected(place)) for t, place in self.goal.approach(duration)]

    def place(self, t: float) -> Place:
        """The other's, projected."""
        return self._projected(self.goal.place(t))

    def _projected(self, place: Place) -> Place:
        here = self.through.translation
        rotation = place.rotation
        if rotation is not None:
            turn = pin.log3(rotation @ self.through.rotation.T)
            rotation = pin.exp3(self.turns @ turn) @ self.through.rotation
        return Place(
            here + self.shifts @ (place.position - here),
            rotation,
            None if place.velocity is None else self.shifts @ place.velocity,
            None if place.spin is None else self.turns @ place.spin,
        )


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
        self._model, self._frame, self._data = sms.model, sms.frame_id, sms.model.createData()
        lower, upper = np.maximum(sms.limits.lower, -np.pi), np.minimum(sms.limits.upper, np.pi)
        rng, rates = np.random.default_rng(0), np.zeros(sms.n)
        q = sms.configuration(np.clip(rates, sms.limits.lower, sms.limits.upper))
        ways = []
        for _ in range(_SAMPLES):
            sms.layout.set_positions(q, rng.uniform(lower, upper))
            ways.append(step_state(sms, q, rates, 1.0, 1.0, mode=mode).J_star)
        J = np.hstack(ways)  # the base is unturned: inertial axes are the root's
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
        pin.framesForwardKinematics(self._model, self._data, q)
        here, root = self._data.oMf[self._frame].copy(), pin.XYZQUATToSE3(q[:7]).rotation
        shifts, turns = (
            np.eye(3) if part is None else root @ part @ root.T for part in (self._shifts, self._turns)
        )
        projected = Projected(goal, here, shifts, turns)
        place, there = goal.place(t), projected.place(t)
        left = float(np.linalg.norm(place.position - there.position))
        tilt = 0.0
        if place.rotation is not None and there.rotation is not None:
            tilt = float(np.linalg.norm(pin.log3(place.rotation @ there.rotation.T)))
        if max(left, tilt) < _ROUNDING:
            return goal, 0.0
        return projected, left


def _range(J: FloatArray) -> FloatArray | None:
    """Projection (3, 3) on the range of J (3, k); None where that is all of space."""
    directions, strengths, _ = np.linalg.svd(J, full_matrices=True)
    rank = int((strengths > _WEAK * strengths[0]).sum())
    return None if rank == 3 else directions[:, :rank] @ directions[:, :rank].T

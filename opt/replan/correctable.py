"""The components of end-effector errors that an arm can correct."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals.goal import Changed, Goal, Place
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.stacks import apply, exp3


class Correctable:
    """The directions in which a robot can displace or rotate its end effector in some configuration.

    They span the range of J* in eight random configurations within the position limits and +-pi, in root
    axes. Most arms can move in all directions. If all joint axes are parallel, arm and base can move only in
    a plane.
    """

    def __init__(self, sms: SpaceManipulator, mode: str = "floating") -> None:
        self._sms = sms
        lower, upper = np.maximum(sms.limits.lower, -np.pi), np.minimum(sms.limits.upper, np.pi)
        joints = np.random.default_rng(0).uniform(lower, upper, (8, sms.n)).T
        J = sms.arm_stack(mode).coupled(joints)[1].reshape(6, -1)
        self._shifts, self._turns = _range(J[:3]), _range(J[3:])

    @property
    def everything(self) -> bool:
        """True if errors in all directions can be corrected."""
        return self._shifts is None and self._turns is None

    def goal(self, goal: Goal, q: FloatArray, t: float) -> tuple[Goal, float]:
        """Return the goal without its uncorrectable error, and the distance [m] of the two goals at t [s].

        The error is the pose error of the end effector in the measured configuration q (nq,).
        """
        if self.everything:
            return goal, 0.0
        here, place = self._sms.at(q).end_effector_pose, goal.place(t)
        root = np.eye(3) if place.moves_with_base else pin.XYZQUATToSE3(q[:7]).rotation
        own = self._shifts, self._turns
        shifts, turns = (np.eye(3) if part is None else root @ part @ root.T for part in own)

        def projected(place: Place) -> Place:
            """Return the place with the measured pose in directions that cannot be corrected."""
            missed, times = place.pose_error(place.in_axes(here, q)), place.position.shape[1:]
            shift = np.tensordot(shifts - np.eye(3), missed.displacement.value, 1).reshape(3, *times)
            vector = missed.vector.reshape(3, *times)
            moved = place.moved(shift, apply(exp3(turns @ vector), exp3(-vector)))
            velocities = zip((shifts, turns), (place.velocity, place.angular_velocity), strict=True)
            velocity, spin = (None if velocity is None else part @ velocity for part, velocity in velocities)
            return replace(moved, velocity=velocity, angular_velocity=spin)

        vector = place.pose_error(place.in_axes(here, q)).vector[:, 0, 0]
        left = float(np.linalg.norm(place.position - projected(place).position))
        tilt = float(np.linalg.norm(vector - turns @ vector))
        if max(left, tilt) < 1e-6:  # [m, rad] smaller errors are rounding errors
            return goal, 0.0
        return Changed(goal, projected), left


def _range(J: FloatArray) -> FloatArray | None:
    """Return the projection (3, 3) onto the range of J (3, k), weak directions excluded; None for rank 3."""
    directions, strengths, _ = np.linalg.svd(J, full_matrices=True)
    rank = int((strengths > 1e-3 * strengths[0]).sum())
    return None if rank == 3 else directions[:, :rank] @ directions[:, :rank].T

"""Mechanical stops, which keep limp joints within their position limits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.robot import SpaceManipulator

_DEPTH = 5e-4  # [rad or m] penetration into a stop at the joint's rate limit
_RATE = 1.0  # [rad/s or m/s] assumed for a joint without a rate limit


class Stops:
    """Springs and dampers at the position limits of limp joints, which push but do not pull.

    At a depth x beyond the limit the torque is I (w^2 x + 2 w dx/dt), critically damped, where I is the
    joint's inertia with base and other joints free. Without other forces, a joint that hits its stop at the
    rate r penetrates the stop by r / (e w), and leaves it at the rate r / e^2. The frequency w makes this
    depth 0.5 mrad or 0.5 mm at the joint's rate limit. The torque acts between two bodies of the robot, so it
    does not change the total momentum.

    Attributes
    ----------
    near : bool
        True if a limp joint may touch its stop in the present step.
    notes : list of str
        A sentence for each limp joint that has run into a stop.
    """

    def __init__(self, plant: SpaceManipulator) -> None:
        limits, self._layout = plant.limits, plant.layout
        self._names, self._lower, self._upper = plant.joint_names, limits.lower, limits.upper
        rates = np.where(np.isfinite(limits.velocity), limits.velocity, _RATE)
        self._w = rates / (math.e * _DEPTH)
        self.near, self._inertia = False, np.zeros(plant.n)
        self._touched, self.notes = np.zeros(plant.n, dtype=bool), list[str]()

    def begin(
        self, model: Any, data: Any, q: FloatArray, v: FloatArray, limp: NDArray[np.bool_], dt: float
    ) -> int:
        """Prepare a control step of dt [s] from the full state; return the required number of substeps."""
        n = len(limp)
        joints, reach = self._layout.positions(q), 2.0 * dt * np.abs(v[6 : 6 + n]) + 2.0 * _DEPTH
        close = limp & ((joints > self._upper - reach) | (joints < self._lower + reach))
        self.near = bool(close.any())
        if not self.near:
            return 1
        compliance = np.diag(pin.computeMinverse(model, data, q))[6 : 6 + n]
        self._inertia = np.where(close, 1.0 / compliance, 0.0)
        return math.ceil(2.0 * dt * float(self._w[close].max()))

    def torque(self, q: FloatArray, rates: FloatArray) -> FloatArray:
        """Return the torques (n,) of the stops [N m or N]."""
        joints, w = self._layout.positions(q), self._w
        above, below = joints - self._upper, self._lower - joints
        down = np.where(above > 0.0, np.maximum(w * w * above + 2.0 * w * rates, 0.0), 0.0)
        up = np.where(below > 0.0, np.maximum(w * w * below - 2.0 * w * rates, 0.0), 0.0)
        pushing: FloatArray = self._inertia * (up - down)
        return pushing

    def reached(self, t: float, q: FloatArray, limp: NDArray[np.bool_]) -> None:
        """Note the limp joints that are beyond a position limit for the first time at t [s]."""
        joints = self._layout.positions(q)
        new = limp & ((joints > self._upper) | (joints < self._lower)) & ~self._touched
        self._touched |= new
        for i in np.flatnonzero(new):
            self.notes.append(f"t = {t:.6g} s: limp joint '{self._names[i]}' runs into its stop")

"""How the end effector should move now: the direction, on the cone or straight, and the speed."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.cone import Triple, cone_direction, lateral_direction
from ffsms_pin.opt.cost import ideal_cosine
from ffsms_pin.opt.schedule import reference_speed
from ffsms_pin.opt.step_kinetics import StepKinetics
from ffsms_pin.system import SpaceManipulator

__all__ = ["Approach", "Way"]

# Below this cosine the path would be a spiral of many turns; its length is then taken as if at this cosine.
LEAST_APPROACH = 0.2
_ARRIVED = 1e-12  # [m, rad] nearer than this the direction to the target is rounding
_MOST = 1e6  # [rad/s^2] stands for no limit on an acceleration
_NOWHERE: Triple = (0.0, 0.0, 0.0)


class Way(NamedTuple):
    """What the end effector should do in a step.

    Attributes
    ----------
    towards : (float, float, float)
        Unit vector to the target; zero where it has arrived.
    direction : (float, float, float)
        Unit vector along which to move, the e of docs/convex-step.md; zero likewise.
    speed : float
        s_ref [m/s].
    """

    towards: Triple
    direction: Triple
    speed: float


class Approach:
    """Remembers the side of the cone that the last step was on.

    Parameters
    ----------
    sms : SpaceManipulator
    kappa : float
        Sharpness of C~.
    on_cone : bool
        Whether to move on the cone where the paper's cost vanishes; otherwise straight to the target.

    Attributes
    ----------
    acceleration : ndarray, shape (n,)
        Limits of the joints [rad/s^2], finite.
    side : (float, float, float)
        Direction whose part across the way to the target is the side; zero: as the end effector moves.
    """

    def __init__(self, sms: SpaceManipulator, kappa: float, on_cone: bool) -> None:
        self._kappa, self._on_cone = kappa, on_cone
        self.acceleration = np.minimum(sms.limits.acceleration, _MOST)
        self.side: Triple = _NOWHERE

    def way(
        self, kinetics: StepKinetics, velocity: Triple, target: FloatArray, time_left: float, dt: float
    ) -> Way:
        """Direction and speed, for an end effector that moves with `velocity` [m/s]."""
        (x, y, z), (px, py, pz) = target.tolist(), kinetics.pose.translation.tolist()
        x, y, z = x - px, y - py, z - pz
        distance = math.sqrt(x * x + y * y + z * z)
        if distance < _ARRIVED:
            return Way(_NOWHERE, _NOWHERE, 0.0)
        towards = (x / distance, y / distance, z / distance)
        cos_ideal = ideal_cosine(kinetics.entropy, self._kappa) if self._on_cone else 1.0
        self.side = lateral_direction(towards, velocity if self.side == _NOWHERE else self.side)
        e = cone_direction(towards, self.side, cos_ideal)
        # A path at a constant angle to the direction of the target is 1 / cos longer than the straight one.
        path = distance / max(cos_ideal, LEAST_APPROACH)
        now = max(0.0, velocity[0] * e[0] + velocity[1] * e[1] + velocity[2] * e[2])
        wanted = reference_speed(path, now, time_left, dt)
        if wanted > now:
            wanted = min(wanted, now + self._gain(np.array(e), kinetics.J_v, dt))
        return Way(towards, e, wanted)

    def turn(
        self, kinetics: StepKinetics, spin: FloatArray, rotation: FloatArray, time_left: float, dt: float
    ) -> FloatArray:
        """Wanted angular velocity of the end effector (3,): to the wanted attitude, on the same schedule."""
        way: FloatArray = pin.log3(rotation @ kinetics.rotation.T)
        angle = math.sqrt(float(way @ way))
        if angle < _ARRIVED:
            return np.zeros(3)
        axis = way / angle
        now = max(0.0, float(axis @ spin))
        wanted = reference_speed(angle, now, time_left, dt)
        return min(wanted, now + self._gain(axis, kinetics.J_w, dt)) * axis

    def _gain(self, along: FloatArray, J: FloatArray, dt: float) -> float:
        """What the joints can add to the speed along a direction in one step.

        Asking for more would buy speed with direction.
        """
        return dt * float(np.abs(along.dot(J)).dot(self.acceleration))

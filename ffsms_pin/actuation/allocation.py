"""How a wanted torque on the base is shared between wheels and thrusters."""

from __future__ import annotations

import numpy as np

from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.checks import FloatArray

__all__ = ["ThrusterAllocation", "WheelAllocation"]


class WheelAllocation:
    """Motor torques of wheels for a wanted torque on the base.

    Parameters
    ----------
    wheels : ReactionWheels
    """

    def __init__(self, wheels: ReactionWheels) -> None:
        self.wheels = wheels
        self._change = np.linalg.pinv(wheels.axes.T)

    def changes(self, torque: FloatArray) -> FloatArray:
        """Least changes of momentum (w,) [N m] whose sum is `torque` (3,), less what no axis can give."""
        change: FloatArray = self._change @ torque
        return change

    def torques(
        self, torque: FloatArray, spin: FloatArray, turn: FloatArray, momentum: FloatArray
    ) -> FloatArray:
        """Motor torques (w,) [N m] that put a torque on the base, gyroscopic torque made good.

        The wheels' momenta h against the base have to change so that -a h' - w x (a h) is the wanted torque.
        A motor also turns its wheel with the base: tau = h' + I a . w'.

        `torque` (3,) is wanted on the base with the wheels standing still; `spin` (3,) [rad/s] and `turn`
        (3,) [rad/s^2] are the base's, root axes; `momentum` (w,) [N m s] is the wheels', against the base.
        """
        wheels = self.wheels
        change = -self.changes(torque + np.cross(spin, wheels.total(momentum)))
        result: FloatArray = change + wheels.inertia * (wheels.axes @ turn)
        return result


class ThrusterAllocation:
    """Forces of thrusters for a wanted force and moment, none of them negative.

    By least squares: C. L. Lawson, R. J. Hanson, "Solving least squares problems", Prentice-Hall 1974,
    chapter 23. Forces count as moments at the thrusters' mean distance. Where a thruster is too weak, all are
    cut down by one factor, which keeps the direction.

    Parameters
    ----------
    thrusters : Thrusters
    centre : ndarray, shape (3,)
        Point that moments are about, in the root frame [m]: the centre of mass.
    """

    def __init__(self, thrusters: Thrusters, centre: FloatArray) -> None:
        arms = thrusters.places - centre
        self._largest = thrusters.force
        self._length = float(np.linalg.norm(arms, axis=1).mean()) or 1.0
        forces = thrusters.directions.T * self._length
        self._effect = np.concatenate([forces, np.cross(arms, thrusters.directions).T])

    @property
    def shares(self) -> FloatArray:
        """Forces (k, 6) for a unit of each [force; moment], some negative, by the pseudo-inverse.

        Where thrusters come in opposed pairs, the two of a pair have half of what one of them has to push.
        """
        scale = np.repeat([self._length, 1.0], 3)
        shares: FloatArray = np.linalg.pinv(self._effect) * scale
        return shares

    def forces(self, force: FloatArray, moment: FloatArray) -> FloatArray:
        """Thruster forces (k,) [N] for a force [N] and a moment [N m] (3,) each, root axes."""
        from scipy.optimize import nnls  # slow to load, and wheels do without

        wanted = np.concatenate([force * self._length, moment])
        if not np.isfinite(wanted).all():
            return np.full(len(self._largest), np.nan)
        shares, _ = nnls(self._effect, wanted)
        result: FloatArray = shares / max(1.0, float((shares / self._largest).max()))
        return result

    def moment(self, forces: FloatArray) -> FloatArray:
        """The moment (3,) [N m] that thruster forces (k,) give."""
        result: FloatArray = (self._effect @ forces)[3:]
        return result

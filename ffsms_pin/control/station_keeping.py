"""Station keeping: thrusters hold the base's place, and what holds its attitude is chosen."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from ffsms_pin.actuation.thrusters import ThrusterAllocation
from ffsms_pin.actuation.wheels import WheelAllocation
from ffsms_pin.checks import FloatArray, instance, one_of, vector
from ffsms_pin.control.base_command import AttitudeHold, BaseCommand, BaseView, partly_held
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator


class StationKeeping:
    """Holds the place of the base's centre of mass by thrusters.

    With p the place and p_0 the one to hold, its acceleration is to be

        p'' = -bandwidth^2 (p - p_0) - 2 damping bandwidth p'.

    Force and moment for it know of the reaction to the joint torques of this control step. The attitude is
    held too ("both"), by wheels, or by the thrusters where there are no wheels; or it is free ("place"), and
    the thrusters give no moment about the base's centre of mass. These are the modes "flying" and
    "translation-flying" of `opt.Problem`.

    Parameters
    ----------
    sms : SpaceManipulator
        The model, with thrusters.
    bandwidth : float
        Of place and attitude [rad/s].
    damping : float
        1 is critical.
    attitude : array_like, shape (3, 3), optional
        Rotation matrix of the root frame to hold, inertial axes. Default: that at the start of the run.
    place : array_like, shape (3,), optional
        Of the base's centre of mass, inertial [m]. Default: that at the start of the run.
    holds : {"both", "place"}

    Raises
    ------
    InvalidValue
        A number out of range, or no thrusters.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        bandwidth: float = 1.0,
        damping: float = 1.0,
        attitude: ArrayLike | None = None,
        place: ArrayLike | None = None,
        holds: Literal["both", "place"] = "both",
    ) -> None:
        instance("sms", sms, SpaceManipulator)
        if sms.thrusters is None:
            raise InvalidValue("sms", sms, "must have thrusters: sms.with_actuators(thrusters=...)")
        self.sms = sms
        self.hold = AttitudeHold(bandwidth, damping, attitude)
        self.holds = one_of("holds", holds, ("both", "place"))
        self.place = None if place is None else vector("place", place, 3, "m")
        self._held = self.place
        self._thrusters = ThrusterAllocation(sms.thrusters, sms.base_com)
        self._wheels = None if sms.wheels is None else WheelAllocation(sms.wheels)

    def reset(self, dt: float) -> None:
        """Forget the last run; called before each."""
        self.hold.reset()
        self._held = self.place

    def command(self, view: BaseView) -> BaseCommand:
        """What thrusters and wheels are to do in this control step."""
        turn = self.hold.acceleration(view.q, view.v) if self.holds == "both" else None
        force, moment = self._wrench(view, turn)
        if turn is None or self._wheels is None:
            return BaseCommand(thruster_force=self._thrusters.forces(force, moment))
        spin: FloatArray = view.v[3:6]
        return BaseCommand(
            self._wheels.torques(moment, spin, turn, view.wheel_momentum),
            self._thrusters.forces(force, np.zeros(3)),
        )

    def _acceleration(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Of Pinocchio's v[:3] (3,), root axes, that a base which does not turn faster would have."""
        R, c, spin = pin.Quaternion(q[3:7]).toRotationMatrix(), self.sms.base_com, v[3:6]
        place, velocity = q[:3] + R @ c, v[:3] + np.cross(spin, c)
        if self._held is None:
            self._held = place
        k, drag = self.hold.bandwidth**2, 2.0 * self.hold.damping * self.hold.bandwidth
        wanted = -k * R.T @ (place - self._held) - drag * velocity
        # Of the centre of mass it is v' + w x v + w' x c + w x (w x c).
        found: FloatArray = wanted - np.cross(spin, velocity)
        return found

    def _wrench(self, view: BaseView, turn: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Force [N], and moment [N m] about the base's centre of mass, root axes (3,) each.

        Where the attitude is free the base turns about its centre of mass as it will: no moment acts.
        """
        n, about = self.sms.n, np.vstack([pin.skew(self.sms.base_com), np.eye(3)])
        moved = np.concatenate([self._acceleration(view.q, view.v), np.zeros(3 + n)])
        if turn is not None:
            moved[:6] += about @ turn
        ways = block_diag(about if turn is None else np.zeros((6, 0)), np.eye(n))
        wrench = partly_held(self.sms, view.q, view.v, moved, ways, view.tau)[:6]
        return wrench[:3], np.asarray(about.T @ wrench)

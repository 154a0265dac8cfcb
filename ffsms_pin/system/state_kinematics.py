"""The kinematics of a state: poses, twists and Jacobians of the base and the end effector."""

from __future__ import annotations

from typing import Any

import pinocchio as pin

from ffsms_pin.checks import FloatArray, writeable
from ffsms_pin.system.once import once
from ffsms_pin.system.state_dynamics import Dynamics

__all__ = ["Kinematics"]

_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class Kinematics(Dynamics):
    """Poses, Jacobians, and the end effector's twist."""

    @property
    def base_pose(self) -> Any:
        """Pose of the base (a new pinocchio.SE3): the root's axes, at the base's centre of mass."""
        own = self.__dict__
        return pin.XYZQUATToSE3(own["q"][:7]).act(own["_sms"]._base_place)

    @property
    def end_effector_pose(self) -> Any:
        """Pose of the end-effector frame (a new pinocchio.SE3)."""
        own = self.__dict__
        sms = own["_sms"]
        model, data = sms.model, sms._workspace.data
        pin.forwardKinematics(model, data, own["q"])
        return pin.updateFramePlacement(model, data, sms.frame_id).copy()

    @once
    def _J_e(self) -> FloatArray:
        """End-effector Jacobian (6, 6 + n), inertial axes, in Pinocchio's velocity coordinates."""
        return self._beside("J_star", "_J_e")

    @once
    def J_b(self) -> FloatArray:
        """Base Jacobian (6, 6): end-effector twist a base twist (paper Eq. d1)."""
        J: FloatArray = self._J_e.dot(self._T)
        writeable(J, False)
        self.__dict__["J_m"] = J[:, 6:]
        return J[:, :6]

    @once
    def J_m(self) -> FloatArray:
        """Manipulator Jacobian (6, n): [J_Te; J_Re] of the paper."""
        return self._beside("J_b", "J_m")

    @once
    def J_star(self) -> FloatArray:
        """Generalised Jacobian (6, n): J_b C_bm + J_m (paper Eq. DC_GJM; Umetani and Yoshida 1989)."""
        own = self.__dict__
        sms, q = own["_sms"], own["q"]
        at_origin = q * sms._all_but_position
        J_e = pin.computeFrameJacobian(sms.model, sms._workspace.data, at_origin, sms.frame_id, _AXES)
        own["_J_e"] = J_e  # Pinocchio gives a copy
        J: FloatArray = J_e.dot(self._N)
        writeable(J, False)
        return J

    @once
    def end_effector_twist(self) -> FloatArray:
        """Twist of the end effector (6,) [m/s; rad/s]: velocity of the frame's origin, angular velocity."""
        twist: FloatArray = self._J_e.dot(self.v)
        writeable(twist, False)
        return twist

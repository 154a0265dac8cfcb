"""The load of a compliant grip: a spring and a damper between end effector and grasp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.simulation.loads import velocity_at


@dataclass(frozen=True, eq=False)
class GripLoad:
    """A spring and a damper in all six directions, a bilateral `Load`.

    The pose of the grasp relative to the end effector has the displacement d and the rotation vector phi. At
    the grasp, the client has the velocity u and the angular velocity w relative to the end effector (all in
    inertial axes). The wrench on the end effector at the grasp is

        f = k d + c u,    torque = k_r phi + c_r w.

    Parameters
    ----------
    grasp : pinocchio.SE3
        The desired pose of the end-effector frame in the client's body frame.
    stiffness : float
        k [N/m]. The default gives a force of 5 N at a position error of 10 mm.
    damping : float
        c [N s/m]. The default gives an overshoot of 16 % with a reduced mass of 5 kg.
    turn_stiffness : float
        k_r [N m/rad]. The default gives a torque of 2 N m at an attitude error of 0.1 rad.
    turn_damping : float
        c_r [N m s/rad].

    Raises
    ------
    InvalidValue
        If `grasp` is not a pose, a stiffness is not above zero, or a damping is below zero.
    """

    grasp: Any
    stiffness: float = 500.0
    damping: float = 50.0
    turn_stiffness: float = 20.0
    turn_damping: float = 2.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "grasp", checks.pose("grasp", self.grasp))
        for name, unit in (("stiffness", "N/m"), ("turn_stiffness", "N m/rad")):
            checks.positive(name, getattr(self, name), unit)
        for name, unit in (("damping", "N s/m"), ("turn_damping", "N m s/rad")):
            checks.at_least_zero(name, getattr(self, name), unit)

    def wrench(
        self, tool: Any, tool_twist: FloatArray, client: Any, client_twist: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the wrench and its point, the grasp; see `Load.wrench`."""
        held = client * self.grasp
        point = np.array(held.translation)
        slip = velocity_at(point, client, client_twist) - velocity_at(point, tool, tool_twist)
        force = self.stiffness * (point - tool.translation) + self.damping * slip
        turn = pin.log3(held.rotation @ tool.rotation.T)
        torque = self.turn_stiffness * turn + self.turn_damping * (client_twist[3:] - tool_twist[3:])
        return np.concatenate([force, torque]), point

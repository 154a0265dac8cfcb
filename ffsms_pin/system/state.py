"""A state: kinematics, dynamics and coupling that certainly belong to one q and v."""

from __future__ import annotations

import numpy as np

from ffsms_pin.system.state_rates import Rates

__all__ = ["State"]


class State(Rates):
    """Everything about the system at one (q, v), in the paper's convention.

    Inertial axes; twists and momenta ordered [linear; angular]; the base's reference point is the centre of
    mass of the base body. Each quantity is computed when it is first asked for, then kept, read-only. Made by
    `SpaceManipulator.at`. A class a subject, each in a file of its own, in this order:

    - `snapshot`: q and v, which do not change, and what the rest is made of;
    - `state_dynamics`: inertia, velocity-dependent forces, momentum, energy;
    - `state_kinematics`: poses, twists, Jacobians;
    - `state_coupling`: C_bm, C_be, the decomposition of C_bm, the reaction null space;
    - `state_rates`: bias accelerations, and how C_bm and J* change.

    Attributes
    ----------
    q : ndarray, shape (nq,)
        Configuration, Pinocchio's.
    v : ndarray, shape (6 + n,)
        Velocity, Pinocchio's.
    """

    def __repr__(self) -> str:
        name = self.__dict__["_sms"].model.name
        return f"State of '{name}': joints {np.array2string(self.q[7:], precision=4)}"

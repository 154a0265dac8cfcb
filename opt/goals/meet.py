"""To meet a client: the end effector at a grasp on a free body, with its velocity."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, ClientEstimate
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.goals.goal import REACH, TOLERANCE, Goal, check_reaches
from ffsms_pin.opt.goals.place import Place
from ffsms_pin.opt.limits.corridor import Corridor
from ffsms_pin.opt.limits.limit import Limit

__all__ = ["HALF_ANGLE", "Meet"]

# [rad] At the standoff the corridor is then 55 mm wide to each side, about as far as a gripper opens.
HALF_ANGLE = math.radians(20.0)
# Share of the time at which motions that a search starts from are at the corridor's mouth.
_MOUTH = 0.75
# Of the time from there on: when these motions are at places of the approach.
_SHARES = (0.0, 0.2, 0.4, 0.6, 0.8)
# And when the last tenth begins, in which they are at the grasp.
_THERE = 0.6


@dataclass(frozen=True, eq=False)
class Meet(Goal):
    """The end-effector frame at a grasp frame on a client at the deadline, without relative velocity.

    What lies within `standoff` of the grasp is approached through a corridor only: a cone on the grasp's
    axis, its tip at the grasp, fixed to the client. The axis is the direction in which the end effector moves
    up to the grasp, so it comes from the side of minus `axis`. A problem with this goal has the corridor
    among its limits (`opt.limits.corridor.Corridor`, named "corridor").

    Attributes
    ----------
    client : Client or ClientEstimate
    grasp : pinocchio.SE3, optional
        Of the grasp frame, in the client's body axes, from its centre of mass. Default: the body frame.
    standoff : float
        Length of the corridor [m]; zero: no corridor. Default: the last hand's breadth, in which a gripper's
        fingers are beside the grasp.
    half_angle : float
        Of the corridor [rad], above zero and below a right angle.
    axis : array_like, shape (3,)
        Direction of approach, in grasp axes; its length does not matter. Default z, which points away from
        the flange in most tool frames.
    tolerance : float
        At the deadline, of the position [m], the attitude [rad] and the relative velocities [m/s, rad/s]: a
        plan that misses by more has not `reached`.
    reach, orientation_reach : float
        In the last tenth of the time, see `Goal`: the attitude is less tied than for other goals, for a grasp
        that turns may be out of reach then.
    rest_after : bool
        Whether the servicer should have the momentum before the capture that leaves both at rest after it
        (`ffsms_pin.client.rest_momentum`). A problem that is given no `momentum` then has this one.

    Raises
    ------
    InvalidValue
    """

    client: Client | ClientEstimate
    grasp: Any = None
    standoff: float = 0.15
    half_angle: float = HALF_ANGLE
    axis: Any = (0.0, 0.0, 1.0)
    tolerance: float = TOLERANCE
    reach: float = REACH
    orientation_reach: float = 0.2
    rest_after: bool = False
    moves: ClassVar[bool] = True  # a client that rests is a path too
    exact: ClassVar[bool] = True  # a contact is no contact a centimetre away, nor one with a knock

    def __post_init__(self) -> None:
        if not isinstance(self.client, (Client, ClientEstimate)):
            raise InvalidValue("client", self.client, "must be a Client, or a ClientEstimate")
        grasp = pin.SE3.Identity() if self.grasp is None else self.grasp
        checks.pose("grasp", grasp)
        half_angle = checks.positive("half_angle", self.half_angle, "rad")
        if half_angle >= 0.5 * math.pi:
            raise InvalidValue("half_angle", self.half_angle, "must be below a right angle [rad]")
        checks.instance("rest_after", self.rest_after, bool)
        check_reaches(self)
        values = {
            "grasp": pin.SE3(grasp),
            "standoff": checks.at_least_zero("standoff", self.standoff, "m"),
            "half_angle": half_angle,
            "axis": checks.direction("axis", self.axis),
            "coupled": not self.standoff,  # a corridor sets the way
            "at_rest_with": self.client if self.rest_after else None,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def place(self, t: float) -> Place:
        """The grasp frame and its velocities."""
        body, twist = self.client.pose(t), self.client.twist(t)
        grasp = body * self.grasp
        velocity = twist[:3] + np.cross(twist[3:], grasp.translation - body.translation)
        return Place(grasp.translation, grasp.rotation, velocity, twist[3:])

    def places(self, times: FloatArray) -> Place:
        """All at once."""
        positions, attitudes = self.client.poses(times)
        grasps = (positions + attitudes @ self.grasp.translation).T
        return Place(grasps, np.moveaxis(attitudes @ self.grasp.rotation, 0, -1))

    def approach(self, duration: float) -> list[tuple[float, Place]]:
        """From the mouth of the corridor along its axis, ever more slowly, where there is one."""
        found = []
        for share in _SHARES if self.standoff > 0.0 else ():
            t = (_MOUTH + (1.0 - _MOUTH) * share) * duration
            back = pin.SE3(np.eye(3), -(max(1.0 - share / _THERE, 0.0) ** 2) * self.standoff * self.axis)
            pose = self.client.pose(t) * self.grasp * back
            found.append((t, Place(pose.translation, pose.rotation)))
        return found

    def limits(self, duration: float) -> tuple[Limit, ...]:
        """The corridor, where there is one."""
        if self.standoff == 0.0:
            return ()
        corridor = Corridor(
            goal=self,
            deadline=duration,
            length=self.standoff,
            half_angle=self.half_angle,
            axis=self.axis,
            slack=self.tolerance,
            inside=(1.0 - _MOUTH) * duration,
        )
        return (corridor,)

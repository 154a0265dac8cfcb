"""The goal to meet a client: the end effector reaches a grasp on a free body with the grasp's velocity."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import FreeBody
from ffsms_pin.client.client import carried
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.goals.goal import REACH, TOLERANCE, Goal, Place, check_reaches
from ffsms_pin.opt.goals.pose_constraints import Alignment, Corridor
from ffsms_pin.opt.limits.limit import Limit
from ffsms_pin.options import Angle, NotNegative, Positive, Unit, Vector3

_MOUTH = 0.75  # share of the time at which initial guesses of a search enter the corridor

_HALF_ANGLE = math.radians(20.0)


@dataclass(frozen=True, eq=False)
class Meet(Goal):
    """A grasp frame on a client that the end effector meets at the deadline, without relative velocity.

    Within `standoff` of the grasp the end effector must stay in a corridor, a cone that is fixed to the
    client, with its tip at the grasp. The goal adds the limits "corridor" (`opt.Corridor`) and, with
    `misalignment`, "alignment" (`opt.Alignment`) to a problem.

    Raises
    ------
    InvalidValue
        If a value is out of range or has a wrong shape.
    """

    client: FreeBody
    """A `Client` or a `capture.ClientEstimate`."""
    grasp: Any = None
    """The pose of the grasp frame (pinocchio.SE3) relative to the client's body frame at its centre of mass.
    Default: the body frame."""
    standoff: Annotated[NotNegative, Unit("m")] = 0.15
    """The length of the corridor; zero: no corridor. The default is the depth over which a gripper's fingers
    are beside the grasp."""
    half_angle: Annotated[Positive, Angle("rad", "0.349")] = _HALF_ANGLE
    """The half angle of the corridor, below a right angle. With the defaults the corridor extends about 5 cm
    to each side at its mouth, about the opening of a gripper."""
    misalignment: Annotated[Positive | None, Angle("rad", "any")] = None
    """The largest angle at the mouth of the corridor between the directions of approach of end effector and
    grasp, and between axes perpendicular to them; at most 90 degrees. The bound decreases linearly to a
    twentieth at the grasp, because a tilted probe may jam. Default: any rotation in the corridor."""
    axis: Annotated[Vector3, Unit()] = (0.0, 0.0, 1.0)
    """The direction of approach, in grasp axes; its length is ignored. Default: z, which points away from the
    flange in most tool frames."""
    tolerance: Annotated[Positive, Unit("m, rad, m/s, rad/s")] = TOLERANCE
    """The tolerance at the contact, see `Goal`. A plan with a larger error has `reached` False."""
    reach: Annotated[Positive, Unit("m")] = REACH
    """The position tolerance in the last tenth of the time."""
    orientation_reach: Annotated[Positive, Angle("rad")] = 0.2
    """The attitude tolerance in the last tenth of the time. It is larger than for other goals, because the
    attitude of a rotating grasp may be out of reach before the deadline."""
    rest_after: Annotated[bool, Unit()] = False
    """True if robot and client should be at rest after the capture. This determines the default `momentum` of
    a problem with this goal (`ffsms_pin.client.rest_momentum`)."""
    coast: float | None = None  # type: ignore[misc]  # a class attribute in the base class
    """The time [s] after the contact for which the joints keep their rates before they brake, for example
    while a grip becomes rigid. The plan leaves enough distance to the position limits for this motion.
    Default: no distance is left."""
    moves: ClassVar[bool] = True  # also for a client at rest
    exact: ClassVar[bool] = True  # a contact requires exact position and velocity

    def __post_init__(self) -> None:
        if not isinstance(self.client, FreeBody):
            raise InvalidValue("client", self.client, "must be a Client, or a ClientEstimate")
        grasp = pin.SE3.Identity() if self.grasp is None else checks.pose("grasp", self.grasp)
        half_angle = checks.positive("half_angle", self.half_angle, "rad")
        if half_angle >= 0.5 * math.pi:
            raise InvalidValue("half_angle", self.half_angle, "must be below a right angle [rad]")
        if self.misalignment is not None:
            if checks.positive("misalignment", self.misalignment, "rad") > 0.5 * math.pi:
                raise InvalidValue("misalignment", self.misalignment, "must be at most a right angle [rad]")
            if not self.standoff:
                text = "requires a corridor: set a standoff above 0 m"
                raise InvalidValue("misalignment", self.misalignment, text)
        checks.instance("rest_after", self.rest_after, bool)
        if self.coast is not None:
            checks.at_least_zero("coast", self.coast, "s")
        check_reaches(self)
        checks.set_frozen(
            self,
            grasp=grasp,
            standoff=checks.at_least_zero("standoff", self.standoff, "m"),
            half_angle=half_angle,
            axis=checks.direction("axis", self.axis),
            coupled=not self.standoff,  # a corridor determines the direction
            at_rest_with=self.client if self.rest_after else None,
        )

    def place(self, t: float) -> Place:
        """Return the grasp frame at a time [s], with its velocities."""
        grasp, twist = carried(self.client.pose(t), self.client.twist(t), self.grasp)
        return Place(grasp.translation, grasp.rotation, twist[:3], twist[3:])

    def places(self, times: FloatArray) -> Place:
        """Return the grasp frames at times (K,) [s]."""
        positions, attitudes = self.client.poses(times)
        grasps = (positions + attitudes @ self.grasp.translation).T
        return Place(grasps, np.moveaxis(attitudes @ self.grasp.rotation, 0, -1))

    def approach(self, duration: float) -> list[tuple[float, Place]]:
        """Return times [s] and places on the corridor's axis, at decreasing speed.

        The list is empty without a corridor.
        """
        # By default the approach ends at 0.9 of the duration, which is 0.6 of the time in the corridor. The
        # end effector then stays at the grasp in the last tenth of the duration. If an approach until the
        # deadline is within half of `reach` in this tenth, it is used instead.
        places, late = [], 0.6
        if 2.0 * (1.0 - late) ** 2 * self.standoff <= self.reach:
            late = 1.0
        for share in (0.0, 0.2, 0.4, 0.6, 0.8) if self.standoff > 0.0 else ():
            t = (_MOUTH + (1.0 - _MOUTH) * share) * duration
            left = max(1.0 - share / late, 0.0) ** 2 * self.standoff
            pose = self.client.pose(t) * self.grasp * pin.SE3(np.eye(3), -left * self.axis)
            places.append((t, Place(pose.translation, pose.rotation)))
        return places

    def limits(self, duration: float) -> tuple[Limit, ...]:
        """Return the corridor, and the bound on the misalignment if there is one; none without a standoff."""
        if not self.standoff:
            return ()
        common = self.axis, self.tolerance, (1.0 - _MOUTH) * duration
        corridor = Corridor(self, duration, self.standoff, self.half_angle, *common)
        if self.misalignment is None:
            return (corridor,)
        return corridor, Alignment(self, duration, self.standoff, self.misalignment, *common)

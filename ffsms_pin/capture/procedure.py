"""The procedure of a capture: attempts, go decision and retreat, with the bodies and loads it is about."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np

from ffsms_pin import checks
from ffsms_pin.capture.braking import Braking, brake
from ffsms_pin.capture.client_distances import ClientDistances
from ffsms_pin.capture.client_identification import teaching_motion
from ffsms_pin.capture.contact_load import apart
from ffsms_pin.capture.go_no_go import GoLimits
from ffsms_pin.capture.mass_uncertainty import MassUncertainty
from ffsms_pin.capture.prediction import Envelope
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import AfterCapture, Client
from ffsms_pin.client.client import carried
from ffsms_pin.geometry.payload import HeldClient
from ffsms_pin.opt import Obstacle, Trajectory
from ffsms_pin.options import NotNegative, Positive, Tries, Unit
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Instant
from ffsms_pin.simulation.loads import Load


@dataclass(frozen=True)
class Procedure:
    """The procedure of a capture: when to go, how often to try, and what follows.

    Raises
    ------
    InvalidValue
        A value out of range or of a wrong shape.
    """

    attempts: Annotated[Tries, Unit()] = 2
    """The number of attempts. After a miss the arm goes back and plans again, with a later measurement of the
    client."""
    retreat: Annotated[Positive, Unit("m")] = 0.3
    """The distance by which the arm goes back from the grasp before the next attempt. Default: twice the
    default standoff of `opt.Meet`."""
    after: Annotated[NotNegative, Unit("s")] = 10.0
    """The time that is simulated after the capture, or after the arm gave up."""
    torque_share: Annotated[Positive, Unit()] = 0.5
    """The share of the torque limits that braking and the motion of `identify` may need."""
    identify: Annotated[NotNegative, Unit("s")] = 0.0
    """The time of a motion of small swings after the braking, by which mass and inertia of the client become
    known. 0: none. Braking and rest alone show few of them."""
    keep_clear: Annotated[Positive, Unit("s")] = 600.0
    """The time for which servicer and client keep clear of each other after the arm gave up, as predicted.
    The default leaves ten minutes to decide what is done next."""
    go: GoLimits = field(default_factory=GoLimits)
    """The limits of the uncertainty about the client, from the go decision to the contact."""
    masses: MassUncertainty = field(default_factory=MassUncertainty)
    """The uncertainty of the servicer's own masses."""

    def __post_init__(self) -> None:
        checks.whole("procedure attempts", self.attempts, 1)
        for name, unit in (("retreat", "m"), ("torque_share", ""), ("keep_clear", "s")):
            checks.positive(f"procedure {name}", getattr(self, name), unit)
        for name in ("after", "identify"):
            checks.at_least_zero(f"procedure {name}", getattr(self, name), "s")
        checks.instance("procedure go", self.go, GoLimits)
        checks.instance("procedure masses", self.masses, MassUncertainty)


@dataclass(frozen=True, eq=False)
class CaptureOptions(Procedure):
    """The procedure of a capture with the envelope, the contact and the bodies that it is about.

    Attributes
    ----------
    envelope : Envelope
        Errors within which the gripper takes hold.
    grip : Load, optional
        The load between end effector and client once the gripper closed. None: the grip is rigid at once.
    guide : Load, optional
        The load of surfaces that may touch at all times.
    time : float
        Time from the closing of the gripper to the rigid grip [s].
    room : callable, optional
        A function of a configuration (nq,) and the pose (pinocchio.SE3) of the client that is held in it.
        Returns the held client, which `brake` keeps clear of the servicer.
    obstacles : sequence of Obstacle
        Bodies that predicted motions of the servicer keep clear of; those on the client at least.
    bodies : sequence of Obstacle
        Bodies of the client. If they touch the servicer's, and no load models that contact, the run ends.
    clearance, collision : float, str
        Distance to keep [m], and what is kept apart, as for `opt.Clearance`.
    """

    envelope: Envelope = field(default_factory=Envelope)
    grip: Load | None = None
    guide: Load | None = None
    time: float = 0.5
    room: Callable[[FloatArray, Any], HeldClient] | None = None
    obstacles: Sequence[Obstacle] = ()
    bodies: Sequence[Obstacle] = ()
    clearance: float = 0.01
    collision: str = "auto"

    @property
    def coast(self) -> float:
        """The time for which joints keep their rates after the gripper closed [s]."""
        return 0.0 if self.grip is None else self.time

    def closeness(self, sms: SpaceManipulator, guides: bool = False) -> ClientDistances | None:
        """Return the distances between a servicer and what it is kept clear of on the client, if anything.

        `guides`: those of the hand to what guides it count, too.
        """
        if not any(obstacle.moves and obstacle.piece_of is None for obstacle in self.obstacles):
            return None
        return ClientDistances(sms, self.obstacles, self.clearance, self.collision, guides)

    def touching(self, plant: SpaceManipulator) -> ClientDistances | None:
        """Return the distances between a servicer and the client's bodies, if it has any."""
        return ClientDistances(plant, self.bodies, self.clearance, self.collision) if self.bodies else None

    def brake(
        self, after: AfterCapture, torque_limit: FloatArray, client: Client | None = None, coast: float = 0.0
    ) -> Braking:
        """Return the braking with a grasped client, whose time zero is now, or without a client."""
        room = None if client is None or self.room is None else self.room(after.q, client.start_pose)
        return brake(after, torque_limit, self.torque_share, coast=coast, room=room)

    def teach(self, joined: AfterCapture, pose: Any) -> tuple[Trajectory | None, str]:
        """Return the motion of `identify` with a grasped client at a pose, or None and the reason."""
        room = None if self.room is None else self.room(joined.q, pose)
        return teaching_motion(joined, self.identify, self.torque_share, room)


class Closing(NamedTuple):
    """The closing of the gripper: distance [m] and angle [rad] (2,) to the grasp, relative twist (6,)."""

    time: float
    miss: FloatArray
    relative: FloatArray


def missed(plant: SpaceManipulator, now: Instant, grasp: Any) -> tuple[FloatArray, FloatArray]:
    """Return distance [m] and angle [rad] (2,) from end effector to grasp, and the relative twist (6,)."""
    offset = apart(plant, now.q, now.v, *carried(now.client_pose, now.client_twist, grasp))
    return np.linalg.norm(offset[:6].reshape(2, 3), axis=1), -offset[6:]

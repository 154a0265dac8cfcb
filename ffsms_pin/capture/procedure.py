"""The procedure of a capture, and its options with the bodies and loads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np

from ffsms_pin import checks
from ffsms_pin.capture.braking import Braking, brake
from ffsms_pin.capture.client_distances import ClientDistances
from ffsms_pin.capture.client_identification import teaching_motion
from ffsms_pin.capture.contact_load import relative_motion
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
    """The procedure of a capture: the go decision, the attempts, and the phases after the contact.

    Raises
    ------
    InvalidValue
        A value is out of range or has a wrong shape.
    """

    attempts: Annotated[Tries, Unit()] = 2
    """The largest number of attempts. After a failed attempt the arm retreats, and the next attempt is
    planned from the present estimate of the client."""
    retreat: Annotated[Positive, Unit("m")] = 0.3
    """The distance from the grasp at which a retreat before another attempt ends. If the standoff is larger,
    a retreat to the standoff is tried first. Default: twice the default standoff of `opt.Meet`."""
    after: Annotated[NotNegative, Unit("s")] = 10.0
    """The least simulated time from the start of the last braking. The run does not end before the deadline
    of the first plan, either. A collision ends the run at once."""
    torque_share: Annotated[Positive, Unit()] = 0.5
    """The share of the torque limits that braking, motions to rest after an abort and the motion of
    `identify` may use. If braking cannot keep the clearance of the grasped client with this share, it may use
    the full limits."""
    identify: Annotated[NotNegative, Unit("s")] = 0.0
    """The duration of a motion of small swings after the braking, from which the client's mass and inertia
    are identified; 0 for no such motion. Without the motion, many parameters may be unobservable."""
    keep_clear: Annotated[Positive, Unit("s")] = 600.0
    """The time after an abort for which servicer and client must keep clear of each other, as predicted. The
    default leaves ten minutes for the next decision."""
    go: GoLimits = field(default_factory=GoLimits)
    """The limits of the client's uncertainty, from the go decision to the contact."""
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
    """The procedure of a capture, with the envelope, the contact loads and the bodies.

    Attributes
    ----------
    envelope : Envelope
        The errors within which the gripper can grasp the client.
    grip : Load, optional
        The load between end effector and client after the gripper has closed. None: the closed grip is rigid.
    guide : Load, optional
        The contact load of surfaces that may touch at any time.
    time : float
        Time from the closing of the gripper to the rigid grip [s], if there is a `grip`.
    room : callable, optional
        A function from a configuration (nq,) and the pose (pinocchio.SE3) of the grasped client to the `room`
        of `brake`.
    obstacles : sequence of Obstacle
        The obstacles for predicted motions of the servicer, at least those on the client.
    bodies : sequence of Obstacle
        The bodies of the client. If such a body touches the servicer and no load models the contact, the run
        ends.
    clearance, collision : float, str
        The required distance [m] and the collision geometry, see `opt.Clearance`.
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
        """The time for which joints keep their rates after the gripper has closed [s]."""
        return 0.0 if self.grip is None else self.time

    def closeness(self, sms: SpaceManipulator, guides: bool = False) -> ClientDistances | None:
        """Return the distances between a servicer and the obstacles on the client; None if there are none.

        If `guides` is true, distances to the pieces of the nozzle or ring at the grasp are included.
        """
        if not any(obstacle.moves and obstacle.piece_of is None for obstacle in self.obstacles):
            return None
        return ClientDistances(sms, self.obstacles, self.clearance, self.collision, guides)

    def touching(self, plant: SpaceManipulator) -> ClientDistances | None:
        """Return the distances between a servicer and the client's `bodies`; None without bodies."""
        return ClientDistances(plant, self.bodies, self.clearance, self.collision) if self.bodies else None

    def brake(
        self, after: AfterCapture, torque_limit: FloatArray, client: Client | None = None, coast: float = 0.0
    ) -> Braking:
        """Return the braking from the state `after`.

        `client` is the grasped client, with the present as its time zero. If it is None, no clearance of a
        grasped client is required. For `torque_limit` and `coast` see `capture.brake`.
        """
        room = None if client is None or self.room is None else self.room(after.q, client.start_pose)
        return brake(after, torque_limit, self.torque_share, coast=coast, room=room)

    def teach(
        self, joined: AfterCapture, pose: Any, locked: Sequence[str] = ()
    ) -> tuple[Trajectory | None, str]:
        """Return the motion of `identify` with an empty text, or None with the reason why there is no motion.

        `pose` (pinocchio.SE3) is the client's pose. `locked` has the names of joints that cannot move.
        """
        room = None if self.room is None else self.room(joined.q, pose)
        return teaching_motion(joined, self.identify, self.torque_share, room, locked)


class Closing(NamedTuple):
    """A closing of the gripper.

    Attributes
    ----------
    time : float
        The time [s].
    miss : ndarray, shape (2,)
        The distance [m] and the angle [rad] from the end effector to the grasp.
    relative : ndarray, shape (6,)
        The end effector's twist relative to the grasp, inertial axes.
    """

    time: float
    miss: FloatArray
    relative: FloatArray


def missed(plant: SpaceManipulator, now: Instant, grasp: Any) -> tuple[FloatArray, FloatArray]:
    """Return pose error (2,) and relative twist (6,) at an instant, as `miss` and `relative` of `Closing`."""
    offset = relative_motion(plant, now.q, now.v, *carried(now.client_pose, now.client_twist, grasp))
    return np.linalg.norm(offset[:6].reshape(2, 3), axis=1), -offset[6:]

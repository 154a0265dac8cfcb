"""The protocols of a controller and of a supervisor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import AfterCapture
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.events import Event, Freeze
from ffsms_pin.simulation.guards import Trip


@runtime_checkable
class Controller(Protocol):
    """A joint torque law.

    A controller that also derives from `Observer` observes the run, as every `control.JointLaw` does. The
    following attributes are used if a controller has them:

    - ``reset(dt)``, called before the run with the control step [s].
    - ``torque_limit`` (n,), the largest torques that the controller commands [N m], at which a joint counts
      as saturated.
    - ``friction_torque`` (n,), the part of the last torque that compensates friction [N m].
    - ``sms`` and ``robot``, the nominal and the estimated `SpaceManipulator`. Braking and re-planning use
      ``robot`` as soon as it differs from ``sms``.
    """

    def torque(
        self, q: FloatArray, v: FloatArray, q_d: FloatArray, qd_d: FloatArray, qdd_d: FloatArray
    ) -> FloatArray:
        """Return joint torques (n,) [N m] for a measured q (nq,), v (6 + n,) and a desired motion (n,)."""
        ...


@runtime_checkable
class CompensatesFriction(Protocol):
    """A controller whose attribute `friction_torque` (n,) is the friction compensation in its last torque."""

    friction_torque: FloatArray


@runtime_checkable
class EstimatesRobot(Protocol):
    """A controller that has a nominal model `sms` and an estimated model `robot`."""

    sms: SpaceManipulator
    robot: SpaceManipulator


class Instant(NamedTuple):
    """The true state of plant and client, passed to a supervisor in each control step.

    Attributes
    ----------
    t : float
        Time [s].
    q, v : ndarray, shape (nq,), (6 + n,)
        Configuration and velocity of the plant.
    client_pose : pinocchio.SE3
        Pose of the client's body frame, inertial axes; None without a client.
    client_twist : ndarray, shape (6,)
        Twist of the client's body frame, inertial axes; zero without a client.
    wrench : ndarray, shape (6,)
        Wrench of the client on the end effector, about the end-effector frame's origin, inertial axes.
    wheel_momentum : ndarray, shape (w,)
        Spin momenta of the base's wheels, relative to the base [N m s].
    joined : AfterCapture, optional
        Plant and client as one robot; None before a `Latch`.
    """

    t: float
    q: FloatArray
    v: FloatArray
    client_pose: Any
    client_twist: FloatArray
    wrench: FloatArray
    wheel_momentum: FloatArray
    joined: AfterCapture | None = None


@runtime_checkable
class Supervisor(Protocol):
    """An object that chooses the events of each control step, such as the closing of a gripper.

    Derive from this class, or implement all three members.

    Attributes
    ----------
    model : SpaceManipulator
        The robot model for braking, unless the controller estimates the robot (`EstimatesRobot`), and, from
        a latch on, for the state estimation. `simulate` reads this attribute when it needs the model.
    """

    model: SpaceManipulator

    def decide(self, now: Instant) -> Sequence[Event]:
        """Return the events of the present control step; called after `Observer.observe`."""
        ...

    def guard_tripped(self, now: Instant, trip: Trip) -> Sequence[Event]:
        """Return the events after a guard has tripped. Default: a `Freeze`.

        A `Freeze` stops the flight; without a `Freeze` the flight goes on. If a contact guard has tripped,
        the contact guards are disabled for one second, so that the supervisor can end the contact.
        """
        return [Freeze(now.t, trip.reason)]

"""The options of a capture, as frozen dataclasses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Annotated, Any

import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin import checks, opt
from ffsms_pin.capture.grip import GripLoad
from ffsms_pin.capture.guides import Scene, gripper_on_ring, probe_in_nozzle
from ffsms_pin.control import BaseLaw, ComputedTorque, JointLaw
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import Inertia, NotNegative, Positive, Share, Unit
from ffsms_pin.robot import SpaceManipulator


@dataclass(frozen=True, eq=False)
class Belief:
    """The assumed mass and inertia of the client, and their uncertainty.

    Raises
    ------
    InvalidValue
        A value is out of range or has a wrong shape.
    """

    mass: Annotated[Positive | None, Unit("kg", "the true mass")] = None
    """The assumed mass."""
    inertia: Annotated[Inertia | None, Unit("kg m²", "the true inertia")] = None
    """The assumed inertia about the centre of mass, body axes: three principal inertias, or a matrix."""
    mass_deviation: Annotated[Share, Unit()] = 0.0
    """The relative standard deviation of the mass."""
    inertia_deviation: Annotated[Share, Unit()] = 0.0
    """The relative standard deviation of the principal inertias."""

    def __post_init__(self) -> None:
        if self.mass is not None:
            checks.positive("belief mass", self.mass, "kg")
        if self.inertia is not None:
            checks.inertia("belief inertia", self.inertia)
        for name in ("mass_deviation", "inertia_deviation"):
            checks.share(f"belief {name}", getattr(self, name))


@dataclass(frozen=True)
class Grip:
    """A compliant grip: a spring and a damper between end effector and grasp, rigid after `time`.

    All fields except `time` are parameters of `capture.GripLoad`.

    Raises
    ------
    InvalidValue
        A value is out of range or has a wrong shape.
    """

    stiffness: Annotated[Positive, Unit("N/m")] = GripLoad.stiffness
    """The stiffness of the compliant grip."""
    damping: Annotated[NotNegative, Unit("N s/m")] = GripLoad.damping
    """The damping of the compliant grip."""
    turn_stiffness: Annotated[Positive, Unit("N m/rad")] = GripLoad.turn_stiffness
    """The rotational stiffness of the compliant grip."""
    turn_damping: Annotated[NotNegative, Unit("N m s/rad")] = GripLoad.turn_damping
    """The rotational damping of the compliant grip."""
    time: Annotated[Positive, Unit("s")] = 0.5
    """The time from the closing of the gripper to the rigid grip."""

    def __post_init__(self) -> None:
        self.load(pin.SE3.Identity())
        checks.positive("time", self.time, "s")

    def load(self, grasp: Any) -> GripLoad:
        """Return the load of the grip at a grasp (pinocchio.SE3) in the client's axes."""
        springs = {key: value for key, value in asdict(self).items() if key != "time"}
        return GripLoad(grasp, **springs)


@dataclass(frozen=True)
class Nozzle:
    """A nozzle around the grasp that guides a probe; the end-effector frame is at the probe's tip.

    The fields are parameters of `capture.probe_in_nozzle`, with its defaults and bounds.

    Raises
    ------
    InvalidValue
        A value is out of range or has a wrong shape.
    """

    probe_length: Annotated[Positive, Unit("m")] = 0.72
    """The length of the probe."""
    probe_radius: Annotated[Positive, Unit("m")] = 0.008
    """The radius of the probe and of its round tip."""
    entry_radius: Annotated[Positive, Unit("m")] = 0.142
    """The radius of the cone at its entry."""
    throat_radius: Annotated[Positive, Unit("m")] = 0.0094
    """The radius of the tube at the end of the cone, wider than the probe and narrower than the entry."""
    cone_length: Annotated[Positive, Unit("m")] = 0.4285
    """The length of the cone."""
    throat_length: Annotated[Positive, Unit("m")] = 0.0445
    """The length of the throat."""
    depth: Annotated[NotNegative, Unit("m")] = 0.037
    """The depth of the tip in the throat at the grasp, at most the throat's length."""
    stiffness: Annotated[Positive, Unit("N/m")] = 5e3
    """The contact stiffness of probe and walls, see `capture.SurfaceContact`."""
    damping: Annotated[NotNegative, Unit("s/m")] = 20.0
    """The damping. After a slow impact at the speed v, the coefficient of restitution is 1 - `damping` v."""
    friction: Annotated[NotNegative, Unit()] = 0.2
    """The coefficient of friction."""

    def __post_init__(self) -> None:
        probe_in_nozzle(pin.SE3.Identity(), **asdict(self))

    @property
    def name(self) -> str:
        """The name of the guide in messages."""
        return "nozzle"

    def scene(self, grasp: Any) -> Scene:
        """Return nozzle and probe for a grasp (pinocchio.SE3) in the client's axes."""
        return _scene(probe_in_nozzle, grasp, asdict(self))


@dataclass(frozen=True)
class Ring:
    """A launch adapter ring at the grasp, gripped by two fingers with the end-effector frame between them.

    The fields are parameters of `capture.gripper_on_ring`, with its defaults and bounds.

    Raises
    ------
    InvalidValue
        A value is out of range or has a wrong shape.
    """

    opening: Annotated[Positive, Unit("m")] = 0.04
    """The distance between the fingers' pads."""
    ring_radius: Annotated[Positive, Unit("m")] = 0.597
    """The radius of the ring, to the middle of its wall."""
    thickness: Annotated[Positive, Unit("m")] = 0.005
    """The thickness of the wall."""
    height: Annotated[Positive, Unit("m")] = 0.06
    """The height of the wall."""
    reach: Annotated[Positive, Unit("m")] = 0.025
    """The distance from the palm to the middle of the pads."""
    pad: Annotated[Positive, Unit("m")] = 0.04
    """The side of a square pad, between the centres of the balls at its corners."""
    pad_radius: Annotated[Positive, Unit("m")] = 0.01
    """The radius of the balls at a pad's corners."""
    stiffness: Annotated[Positive, Unit("N/m^(3/2)")] = 8.7e5
    """The contact stiffness of pads and rim, see `capture.SurfaceContact`."""
    damping: Annotated[NotNegative, Unit("s/m")] = 20.0
    """The damping. After a slow impact at the speed v, the coefficient of restitution is 1 - `damping` v."""
    friction: Annotated[NotNegative, Unit()] = 0.2
    """The coefficient of friction."""

    def __post_init__(self) -> None:
        gripper_on_ring(pin.SE3.Identity(), **asdict(self))

    @property
    def name(self) -> str:
        """The name of the guide in messages."""
        return "ring"

    def scene(self, grasp: Any) -> Scene:
        """Return ring and gripper for a grasp (pinocchio.SE3) in the client's axes."""
        return _scene(gripper_on_ring, grasp, asdict(self))


def _scene(make: Callable[..., Scene], grasp: Any, sizes: dict[str, float]) -> Scene:
    """Return the scene that `make` creates, with its grasp at a pose (pinocchio.SE3) in the client's axes."""
    return make(grasp * make(pin.SE3.Identity(), **sizes).grasp.inverse(), **sizes)


@dataclass(frozen=True, eq=False)
class Replan(opt.ReplanOptions):
    """The options of re-planning: those of `opt.ReplanOptions`, and the time step of the motions.

    Raises
    ------
    InvalidValue
        A value is out of range or has a wrong shape.
    """

    dt: Annotated[Positive | None, Unit("s", "[plan] dt")] = None
    """The time step of re-planned motions. Default: that of the plan."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dt is not None:
            checks.positive("replan dt", self.dt, "s")


@dataclass(frozen=True, eq=False)
class Planning:
    """The options of the plan, see `opt.Problem`.

    Attributes
    ----------
    dt : float
        Time step of the plan [s], above zero.
    terms : sequence of opt.Term, optional
        The cost terms. Default: those of `opt.Problem`.
    limits : sequence of opt.Limit, optional
        The limits. Default: those of `opt.Problem`. An `opt.Clearance` among them also applies to predictions
        and braking.
    obstacles : sequence of opt.Obstacle
        Obstacles in addition to those of an `opt.Clearance`. Obstacles on the goal's client are parts of that
        client. The flight ends if the servicer touches such an obstacle and the contact is not modelled.
    joint_rates : array_like, shape (n,), optional
        Joint rates at the start [rad/s or m/s]. Default: zero.
    momentum : array_like, shape (6,), optional
        Total momentum of the servicer [linear; angular] [kg m/s; kg m^2/s]. Default: see `opt.Problem`.
    locked : sequence of str
        Names of joints that cannot move.
    mode : str
        The part of the base's motion that a base law holds, see `opt.Problem`. Default: none.
    wheel_momentum : array_like, shape (w,), optional
        Initial momenta of the wheels that hold the attitude [N m s]. Default: zero.
    search : opt.SearchOptions, optional
        Options of the search for the first plan only.
    """

    dt: float = 0.01
    terms: Sequence[opt.Term] | None = None
    limits: Sequence[opt.Limit] | None = None
    obstacles: Sequence[opt.Obstacle] = ()
    joint_rates: ArrayLike | None = None
    momentum: ArrayLike | None = None
    locked: Sequence[str] = ()
    mode: str = "floating"
    wheel_momentum: ArrayLike | None = None
    search: opt.SearchOptions | None = None

    def __post_init__(self) -> None:
        checks.positive("planning dt", self.dt, "s")
        for name, kind in (("terms", opt.Term), ("limits", opt.Limit), ("obstacles", opt.Obstacle)):
            if (parts := getattr(self, name)) is None:
                continue
            checks.instance(f"planning {name}", parts, (list, tuple))
            for i, part in enumerate(parts):
                checks.instance(f"planning {name}[{i}]", part, kind)
        checks.instance("planning search", self.search, opt.SearchOptions, optional=True)


# A function from a robot to the law of its joints, or of its base.
JointLaws = Callable[[SpaceManipulator], JointLaw]
BaseLaws = Callable[[SpaceManipulator], BaseLaw | None]
_LAW = partial(ComputedTorque, K_p=100.0, K_d=20.0, adaptive=False)


@dataclass(frozen=True, eq=False)
class Control:
    """The control laws of a capture.

    The laws are created for the servicer, and at the latch again for servicer and client as one robot.

    Attributes
    ----------
    law : callable
        A function from a robot to the law of its joints, such as a class of `ffsms_pin.control`. The default
        is computed torque with K_p = 100 1/s^2 and K_d = 20 1/s, without estimation of friction and payload,
        because contact loads would bias the estimates.
    base : callable, optional
        A function from a robot to the law of its base, such as `ffsms_pin.control.QuaternionFeedback`.
        Default: the base floats.
    dt : float
        Control step [s], above zero. It is rounded so that the duration has a whole number of steps.
    """

    law: JointLaws = _LAW
    base: BaseLaws | None = None
    dt: float = 2e-3

    def __post_init__(self) -> None:
        for name, example in (("law", "ComputedTorque"), ("base", "QuaternionFeedback")):
            value = getattr(self, name)
            if not (callable(value) or (name == "base" and value is None)):
                message = f"must be a function from a robot to a law, such as lambda robot: {example}(robot)"
                raise InvalidValue(f"control {name}", value, message)
        checks.positive("control dt", self.dt, "s")

    def laws(self, robot: SpaceManipulator) -> tuple[JointLaw, BaseLaw | None]:
        """Return the laws of a robot's joints and of its base."""
        law, base = self.law(robot), None if self.base is None else self.base(robot)
        checks.instance("the return value of control law", law, JointLaw)
        return law, base

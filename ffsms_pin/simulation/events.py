"""External wrenches on the plant, and events such as a capture or a joint fault."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, number, one_of, rigid_body, vector
from ffsms_pin.client import Client, after_capture
from ffsms_pin.client.client import carried
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import (
    AnyTime,
    Inertia,
    NameOrIndex,
    NotNegative,
    Number,
    Positive,
    Unit,
    Vector3,
    Vector6,
)
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.loads import Load

# A function of t [s], q (nq,), v (nv,) that returns a generalised force (nv,).
GeneralisedForce: TypeAlias = Callable[[float, FloatArray, FloatArray], FloatArray]
# A generalised force held over a step, or a function that returns it.
Force: TypeAlias = FloatArray | GeneralisedForce


@dataclass(frozen=True, eq=False)
class Wrench:
    """An external force and moment on the base or the end effector.

    Raises
    ------
    InvalidValue
        A value is out of range or has a wrong shape; raised at the start of a run. The values of a function
        are checked during the run.
    """

    wrench: Annotated[Vector6, Unit("N, N m")]
    """The force and moment (6 numbers), inertial axes; in Python also a function of time [s] that returns
    them."""
    on: Annotated[Literal["base", "end-effector"], Unit()] = "base"
    """The body on which the wrench acts, "base" (at its centre of mass) or "end-effector" (at the origin of
    its frame)."""
    start: Annotated[Number, Unit("s")] = 0.0
    """The time at which the wrench begins."""
    end: Annotated[AnyTime, Unit("s")] = math.inf
    """The time at which the wrench ends, infinite for a wrench until the end of the run."""

    def force(self, plant: SpaceManipulator) -> GeneralisedForce:
        """Return a function of t, q and v that returns the generalised force conjugate to Pinocchio's v."""
        one_of("wrench.on", self.on, ("base", "end-effector"))
        start = number("wrench.start", self.start)
        endless = isinstance(self.end, float) and self.end == math.inf
        if not endless and number("wrench.end", self.end) <= start:
            raise InvalidValue("wrench.end", self.end, f"must be after its start at {start:g} s")
        if not callable(self.wrench):
            vector("wrench", self.wrench, 6, "N, N m")
        model, data = plant.model, plant.model.createData()
        local, frame = plant.base_com, plant.frame_id

        def on_base(t: float, q: FloatArray, v: FloatArray) -> FloatArray:
            F, rotation = self.value(t), pin.Quaternion(q[3:7]).toRotationMatrix()
            force = np.zeros(v.size)
            force[:3] = rotation.T @ F[:3]
            force[3:6] = rotation.T @ F[3:] + np.cross(local, force[:3])
            return force

        def on_end_effector(t: float, q: FloatArray, v: FloatArray) -> FloatArray:
            J = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            force: FloatArray = J.T @ self.value(t)
            return force

        return on_base if self.on == "base" else on_end_effector

    def value(self, t: float) -> FloatArray:
        """Return the wrench (6,) at t [s]; zero before `start` and from `end` on."""
        if not self.start <= t < self.end:
            return np.zeros(6)
        wrench = self.wrench(t) if callable(self.wrench) else self.wrench
        return vector(f"wrench at t = {t:g} s", wrench, 6, "N, N m")


@dataclass(frozen=True, eq=False)
class Capture:
    """An event in which the end effector grasps a rigid body, such as a payload or a client.

    If the body moves relative to the end effector, the capture is a plastic impact, after which both have the
    same velocity. The joint rates jump, because drives cannot transmit an impulse (locked joints can). The
    total momentum of robot and body is conserved; energy is lost. Reference and controller do not observe the
    event.

    Raises
    ------
    InvalidValue
        No rigid body has these values; raised at the start of a run.
    """

    time: Annotated[NotNegative, Unit("s")]
    """The time of the capture, which happens at the first control step from this time on."""
    mass: Annotated[Positive, Unit("kg")]
    """The mass of the body."""
    inertia: Annotated[Inertia, Unit("kg m²")]
    """The inertia about the body's centre of mass in the axes of the end-effector frame, as 3 principal
    moments or a 3 by 3 matrix."""
    com: Annotated[Vector3, Unit("m")] = (0.0, 0.0, 0.0)
    """The body's centre of mass in the end-effector frame."""
    twist: Annotated[Vector6 | None, Unit("m/s, rad/s", "the end effector's")] = None
    """The body's twist before the capture (6 numbers): velocity of its centre of mass and angular velocity,
    inertial axes. With the default there is no impact."""

    def client(self, tool: Any, tool_twist: FloatArray) -> Client:
        """Return the captured body, from the pose (pinocchio.SE3) and twist (6,) of the end effector."""
        mass, tensor, com = rigid_body("capture", self.mass, self.inertia, self.com)
        pose, twist = carried(tool, tool_twist, pin.SE3(np.eye(3), com))
        if self.twist is not None:
            twist = vector("capture.twist", self.twist, 6, "m/s, rad/s")
        return Client(mass, tensor, pose, twist)

    def apply(
        self, plant: SpaceManipulator, q: FloatArray, v: FloatArray, locked: list[int]
    ) -> tuple[SpaceManipulator, FloatArray]:
        """Return the plant with the body, and v after the impact; `locked` are indices in v."""
        now = plant.at(q, v)
        client = self.client(now.end_effector_pose, now.end_effector_twist)
        joined = after_capture(plant, q, v, client, locked=locked)
        return joined.robot, joined.v.copy()

    def __str__(self) -> str:
        return f"captured {self.mass:g} kg"


@dataclass(frozen=True)
class JointFault:
    """An event after which a joint is locked at its position, or limp (without motor torque).

    A locking joint stops at once; the total momentum is conserved, and energy is lost. Friction acts on a
    limp joint, and mechanical stops keep the joint within its position limits.

    Raises
    ------
    InvalidValue
        The plant has no such joint, or the kind is unknown; raised at the start of a run.
    """

    time: Annotated[NotNegative, Unit("s")]
    """The time of the fault, which happens at the first control step from this time on."""
    joint: Annotated[NameOrIndex, Unit()]
    """The joint's name, or its index from 0."""
    kind: Annotated[Literal["locked", "limp"], Unit()] = "locked"
    """The kind of failure. A "locked" joint keeps its position; a "limp" joint has no motor torque."""
    reported: Annotated[bool, Unit()] = True
    """True to report the fault to reference and controller (`Observer.joint_failed`), so that re-planning
    uses the other joints."""

    def index(self, plant: SpaceManipulator) -> int:
        """Return the index of the joint, from 0."""
        names = plant.joint_names
        if isinstance(self.joint, str) and self.joint in names:
            return names.index(self.joint)
        if isinstance(self.joint, int) and not isinstance(self.joint, bool) and 0 <= self.joint < len(names):
            return self.joint
        raise InvalidValue("fault.joint", self.joint, f"is no joint of the plant ({', '.join(names)})")

    def __str__(self) -> str:
        return f"joint {self.joint} {self.kind}"


@dataclass(frozen=True)
class _TimedEvent:
    """An event at a `time` [s], with a text for the recording's note."""

    time: float
    text: ClassVar[str]

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class Close(_TimedEvent):
    """An event at `time` [s], after which a load, such as a grip, acts between end effector and client."""

    load: Load
    text = "the gripper closes"


@dataclass(frozen=True)
class Open(_TimedEvent):
    """An event at `time` [s] that removes the loads of all `Close` events."""

    text = "the gripper opens"


@dataclass(frozen=True)
class Latch(_TimedEvent):
    """An event at `time` [s] that rigidly attaches the client to the end effector at its pose at that time.

    A plastic impact ends the remaining relative velocity, see `ffsms_pin.client.after_capture`. All loads
    between end effector and client are removed.
    """

    text = "latched"


@dataclass(frozen=True)
class Phase:
    """An event that marks the beginning of a phase at `time` [s], without an effect on the plant."""

    time: float
    name: str
    reason: str = ""

    def __str__(self) -> str:
        return self.name + (f" ({self.reason})" if self.reason else "")


@dataclass(frozen=True)
class Freeze:
    """An event at `time` [s], after which `control.StoppingLaw` brakes the joints until the end of the run.

    The controller is no longer called, but the law of the base is.
    """

    time: float
    reason: str = "as an event"

    def __str__(self) -> str:
        return f"stopped: {self.reason}"


@dataclass(frozen=True)
class End(_TimedEvent):
    """An event that ends the run at `time` [s], before the end of the reference."""

    text = "ended"


Event: TypeAlias = Capture | JointFault | Close | Open | Latch | Phase | Freeze | End
EVENTS = (Capture, JointFault, Close, Open, Latch, Phase, Freeze, End)

"""What acts on the plant from outside, and what happens to it: a client is captured, a joint fails."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import (
    FloatArray,
    com_problem,
    inertia,
    inertia_problem,
    number,
    one_of,
    positive,
    vector,
)
from ffsms_pin.client import Client, after_capture
from ffsms_pin.client.client import carried
from ffsms_pin.errors import InvalidValue
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.loads import Load, checked_load

# From t [s], q (nq,), v (6 + n,) to a generalised force (6 + n,).
GeneralisedForce: TypeAlias = Callable[[float, FloatArray, FloatArray], FloatArray]
# Held over a step, or that.
Force: TypeAlias = FloatArray | GeneralisedForce


@dataclass(frozen=True, eq=False)
class Wrench:
    """An external force and moment on the base or the end effector.

    Parameters
    ----------
    wrench : array_like, shape (6,), or callable
        [force; moment] in inertial axes [N; N m], or a function of time [s] that gives it.
    on : {"base", "end-effector"}
        Where it acts: at the base's centre of mass, or at the end-effector frame's origin.
    start, end : float
        When it acts [s].
    """

    wrench: Any
    on: Literal["base", "end-effector"] = "base"
    start: float = 0.0
    end: float = math.inf

    def force(self, plant: SpaceManipulator) -> GeneralisedForce:
        """The generalised force, conjugate to Pinocchio's v."""
        one_of("wrench.on", self.on, ("base", "end-effector"))
        start, end = number("wrench.start", self.start), self.end
        if not (isinstance(end, (int, float)) and end > start):
            raise InvalidValue("wrench.end", end, f"must be after its start at {start:g} s")
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
        """The wrench (6,) at t [s]."""
        if not self.start <= t < self.end:
            return np.zeros(6)
        given = self.wrench(t) if callable(self.wrench) else self.wrench
        return vector(f"wrench at t = {t:g} s", given, 6, "N, N m")


@dataclass(frozen=True, eq=False)
class Capture:
    """From `time` on a rigid body belongs to the end effector: a payload, or a client that was flying free.

    The capture is plastic: within no time the client takes the end effector's motion, the joints giving way
    as they are (drives bear no impulse; locked joints do). The momentum of arm and client together is kept,
    energy is lost. The reference and the controller are not told.

    Parameters
    ----------
    time : float
        [s]; the capture is made at the first control step from then on.
    mass : float
        [kg]
    inertia : array_like, shape (3, 3) or (3,)
        About its centre of mass, axes of the end-effector frame at the capture [kg m^2].
    com : array_like, shape (3,)
        Its centre of mass in the end-effector frame [m].
    twist : array_like, shape (6,), optional
        Its motion before: velocity of its centre of mass and angular velocity, inertial axes [m/s; rad/s].
        Default: that of the end effector, so that nothing is felt at the instant itself.
    """

    time: float
    mass: float
    inertia: ArrayLike
    com: ArrayLike = (0.0, 0.0, 0.0)
    twist: ArrayLike | None = None

    def client(self, tool: Any, tool_twist: FloatArray) -> Client:
        """The body, in the hand of an end effector that is at a pose (pinocchio.SE3) with a twist (6,)."""
        mass, com = positive("capture.mass", self.mass, "kg"), vector("capture.com", self.com, 3, "m")
        tensor = inertia("capture.inertia", self.inertia)
        if problem := inertia_problem(mass, tensor):
            raise InvalidValue("capture.inertia", self.inertia, problem)
        if problem := com_problem(mass, tensor, com):
            raise InvalidValue("capture.com", self.com, problem)
        pose, twist = carried(tool, tool_twist, pin.SE3(np.eye(3), com))
        if self.twist is not None:
            twist = vector("capture.twist", self.twist, 6, "m/s, rad/s")
        return Client(mass, tensor, pose, twist)

    def apply(
        self, plant: SpaceManipulator, q: FloatArray, v: FloatArray, locked: list[int]
    ) -> tuple[SpaceManipulator, FloatArray]:
        """The plant with the client on it, and the velocity (6 + n,) right after; `locked` indexes v."""
        now = plant.at(q, v)
        client = self.client(now.end_effector_pose, now.end_effector_twist)
        joined = after_capture(plant, q, v, client, locked=locked)
        return joined.robot, joined.v.copy()

    def __str__(self) -> str:
        return f"captured {self.mass:g} kg"


@dataclass(frozen=True)
class JointFault:
    """From `time` on a joint is locked where it is, or limp: without torque.

    A locking joint stops within no time; the momentum is kept, energy is lost. Friction stays on a limp one,
    and stops hold it at its position limits.

    Parameters
    ----------
    time : float
        [s]; at the first control step from then on.
    joint : str or int
        Name, or index from 0.
    kind : {"locked", "limp"}
    told : bool
        Whether the reference is told, so that it can plan with what is left, and the controller: where they
        have a method `joint_failed(index, locked)`.
    """

    time: float
    joint: str | int
    kind: Literal["locked", "limp"] = "locked"
    told: bool = True

    def index(self, plant: SpaceManipulator) -> int:
        """Index of the joint, from 0."""
        names = plant.joint_names
        if isinstance(self.joint, str) and self.joint in names:
            return names.index(self.joint)
        if isinstance(self.joint, int) and not isinstance(self.joint, bool) and 0 <= self.joint < len(names):
            return self.joint
        raise InvalidValue("fault.joint", self.joint, f"is no joint of the plant ({', '.join(names)})")

    def __str__(self) -> str:
        return f"joint {self.joint} {self.kind}"


@dataclass(frozen=True)
class _Told:
    """Something that happens at a `time` [s], and the words for it."""

    time: float
    words: ClassVar[str]

    def __str__(self) -> str:
        return self.words


@dataclass(frozen=True)
class Close(_Told):
    """From `time` [s] on a load acts between end effector and client, as of a gripper that closes."""

    load: Load
    words = "the gripper closes"


@dataclass(frozen=True)
class Open(_Told):
    """From `time` [s] on no load of a `Close` acts any more."""

    words = "the gripper opens"


@dataclass(frozen=True)
class Latch(_Told):
    """From `time` [s] on the client of the run is one body with the end effector, wherever it is then.

    What is left of a relative velocity ends in a plastic impact, see `ffsms_pin.client.after_capture`.
    """

    words = "latched"


@dataclass(frozen=True)
class Phase:
    """From `time` [s] on a run is in another phase, for a reason; nothing else happens."""

    time: float
    name: str
    reason: str = ""

    def __str__(self) -> str:
        return self.name + (f" ({self.reason})" if self.reason else "")


@dataclass(frozen=True)
class Freeze:
    """From `time` [s] on the joints are braked within their torques to the end of the run, for a reason.

    The controller is not asked any more (`control.StoppingLaw`); a controller of the base goes on.
    """

    time: float
    reason: str = "as an event"

    def __str__(self) -> str:
        return f"stopped: {self.reason}"


@dataclass(frozen=True)
class End(_Told):
    """The run ends at `time` [s], before its reference does."""

    words = "ended"


Event: TypeAlias = Capture | JointFault | Close | Open | Latch | Phase | Freeze | End
_KINDS = (Capture, JointFault, Close, Open, Latch, Phase, Freeze, End)
_WORDS = "must hold Capture, JointFault, Close, Open, Latch, Phase, Freeze or End objects"


def checked_events(events: Any, plant: SpaceManipulator, duration: float) -> list[Event]:
    """The argument `events` of `simulate`, in order of time."""
    try:
        several = [events] if isinstance(events, _KINDS) else list(events)
    except TypeError:
        raise InvalidValue("events", events, _WORDS) from None
    for event in several:
        if not isinstance(event, _KINDS):
            raise InvalidValue("events", event, _WORDS)
        if not 0.0 <= number("event.time", event.time) <= duration:
            raise InvalidValue("event.time", event.time, f"must be within the run's {duration:g} s")
        if isinstance(event, Capture):
            event.client(pin.SE3.Identity(), np.zeros(6))
        elif isinstance(event, JointFault):
            event.index(plant)
            one_of("fault.kind", event.kind, ("locked", "limp"))
        elif isinstance(event, Close):
            checked_load("close.load", event.load)
    return sorted(several, key=lambda event: event.time)

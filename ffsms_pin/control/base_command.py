"""Control laws of the base: their interface, attitude hold, station keeping, and pulse-width modulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.actuation.thrusters import ThrusterAllocation, Thrusters
from ffsms_pin.actuation.wheels import WheelAllocation
from ffsms_pin.checks import FloatArray, frozen, one_of, positive, rotation, vector
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import Positive, Unit, Vector3
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import dynamics


class BaseView(NamedTuple):
    """The measured state and desired motion at the start of a control step.

    Attributes
    ----------
    t : float
        Time [s].
    q, v : ndarray, shape (nq,), (6 + n,)
        Measured configuration and velocity in Pinocchio's layout.
    wheel_momentum : ndarray, shape (w,)
        Measured spin momenta relative to the base [N m s]; empty without wheels.
    desired : tuple of ndarray, shape (n,) each
        Joint positions [rad], rates [rad/s] and accelerations [rad/s^2] of the reference.
    tau : ndarray, shape (n,)
        Joint torques [N m] of this control step, without the part that compensates friction. That part
        cancels with friction in the joint, so it does not act on the base.
    """

    t: float
    q: FloatArray
    v: FloatArray
    wheel_momentum: FloatArray
    desired: tuple[FloatArray, FloatArray, FloatArray]
    tau: FloatArray


class BaseCommand(NamedTuple):
    """A command to the base's actuators for a control step, before their limits.

    Attributes
    ----------
    wheel_torque : ndarray, shape (w,), optional
        Motor torques on the wheels [N m]; the opposite torques act on the base. Default: zero.
    thruster_force : ndarray, shape (k,), optional
        Thruster forces [N]; negative values are replaced by zero. Default: zero.
    """

    wheel_torque: FloatArray | None = None
    thruster_force: FloatArray | None = None


@runtime_checkable
class BaseLaw(Protocol):
    """A control law of the base.

    A law with internal state also has a method ``reset(dt)``, which `simulate` calls before a run.
    """

    def command(self, view: BaseView) -> BaseCommand:
        """Return the command for wheels and thrusters in this control step."""
        ...


@runtime_checkable
class HoldsBase(Protocol):
    """A base law that holds the parts `held_parts` of the base's pose: "attitude", "position" or both."""

    held_parts: frozenset[str]


@dataclass(eq=False)
class AttitudeHold:
    """A desired attitude of the base, and the angular acceleration towards it.

    Let eps be the vector part and eta the scalar part of the quaternion from the desired to the measured
    attitude, and w the base's angular velocity. The desired acceleration is

        w' = -2 bandwidth^2 sign(eta) eps - 2 damping bandwidth w.

    Proof: V = w.w / 2 + 4 bandwidth^2 (1 - |eta|) has V' = -2 damping bandwidth w.w, since eta' = -eps.w / 2.
    Small errors decay as those of a mass on a spring, with the frequency `bandwidth` [rad/s] and the damping
    ratio `damping`. `attitude` (3, 3) is the desired rotation matrix of the root frame, inertial axes, by
    default that of the first control step.

    Source: B. Wie, H. Weiss, A. Arapostathis, "Quaternion feedback regulator for spacecraft eigenaxis
    rotations", Journal of Guidance, Control, and Dynamics 12 (1989).
    """

    bandwidth: float
    damping: float
    attitude: Any = None

    def __post_init__(self) -> None:
        self.bandwidth = positive("bandwidth", self.bandwidth, "rad/s")
        self.damping = positive("damping", self.damping)
        if self.attitude is not None:
            self.attitude = rotation("attitude", self.attitude)
        self._held: FloatArray | None = self.attitude

    def reset(self) -> None:
        """Clear the default attitude of the last run."""
        self._held = self.attitude

    def acceleration(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the desired angular acceleration of the base (3,) [rad/s^2], root axes."""
        turn = pin.Quaternion(q[3:7]).toRotationMatrix()
        if self._held is None:
            self._held = turn
        error = pin.Quaternion(self._held.T @ turn)
        side = 1.0 if error.w >= 0.0 else -1.0
        stiffness, drag = 2.0 * self.bandwidth**2, 2.0 * self.damping * self.bandwidth
        result: FloatArray = -stiffness * side * error.vec() - drag * v[3:6]
        return result


def partly_held(
    sms: SpaceManipulator,
    q: FloatArray,
    v: FloatArray,
    prescribed: FloatArray,
    free: FloatArray,
    tau: Any = 0.0,
) -> FloatArray:
    """Return the force (6 + n,) on base and joints for partly prescribed accelerations.

    The force is M v' + c with the inertia matrix M and the velocity effects c. The acceleration is v' =
    prescribed + free x, as in Pinocchio in root axes [m/s^2; rad/s^2]. Along the directions `free` (6 + n, k)
    no force acts except the joint torques `tau` (n,) [N m], which determines the unknowns x (k,).
    """
    M, effects = dynamics.inertia_matrix(sms, q), dynamics.velocity_effects(sms, q, v)
    acting = -M @ prescribed - effects
    acting[6:] += tau
    x = np.linalg.solve(free.T @ M @ free, free.T @ acting)
    force: FloatArray = M @ (prescribed + free @ x) + effects
    return force


def held_dynamics(
    sms: SpaceManipulator, q: FloatArray, v: FloatArray, turn: FloatArray, qdd: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return torques for desired accelerations of base attitude and joints; the base position is free.

    `turn` (3,) is the desired angular acceleration of the base [rad/s^2], root axes. The torques are T (3,)
    on the base and tau (n,) of the joints [N m].
    """
    prescribed = np.concatenate([np.zeros(3), turn, qdd])
    force = partly_held(sms, q, v, prescribed, np.eye(sms.nv)[:, :3])
    return force[3:6], force[6:]


class StationKeeping:
    """A law that holds the position of the base's centre of mass by thrusters.

    With the position p and the desired position p_0, the desired acceleration is

        p'' = -bandwidth^2 (p - p_0) - 2 damping bandwidth p'.

    Force and moment include the reaction to the joint torques of this control step. If `holds` is "both", the
    attitude is controlled as well, by the wheels or, without wheels, by the thrusters. If `holds` is "place",
    the attitude is free, and the thrusters exert no moment about the base's centre of mass. The two values
    correspond to the modes "flying" and "translation-flying" of `opt.Problem`.

    Parameters
    ----------
    sms : SpaceManipulator
        The model, with thrusters.
    bandwidth : float
        Bandwidth of the loop [rad/s].
    damping : float
        Damping ratio of the loop; 1 is critical.
    attitude
        See `QuaternionFeedback`.
    place : array_like, shape (3,), optional
        The desired position of the base's centre of mass, inertial axes [m]. Default: that at the start of
        the run.
    holds : {"both", "place"}
        The controlled part of the base's pose: position and attitude ("both"), or the position ("place").

    Raises
    ------
    InvalidValue
        An argument is out of range, or the robot has no thrusters.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        bandwidth: Annotated[Positive, Unit("rad/s")] = 1.0,
        damping: Annotated[Positive, Unit()] = 1.0,
        attitude: ArrayLike | None = None,
        place: Annotated[Vector3 | None, Unit("m", "that at the start")] = None,
        holds: Annotated[Literal["both", "place"], Unit()] = "both",
    ) -> None:
        if sms.thrusters is None:
            raise InvalidValue("sms", sms, "must have thrusters: sms.with_actuators(thrusters=...)")
        self.sms = sms
        self.hold = AttitudeHold(bandwidth, damping, attitude)
        self.holds = one_of("holds", holds, ("both", "place"))
        self.held_parts = frozenset(("position", "attitude") if self.holds == "both" else ("position",))
        self.place = None if place is None else vector("place", place, 3, "m")
        self._held = self.place
        self._thrusters = ThrusterAllocation(sms.thrusters, sms.base_com)
        self._wheels = None if sms.wheels is None else WheelAllocation(sms.wheels)

    def reset(self, dt: float) -> None:
        """Clear the state of the last run; `simulate` calls this method before each run."""
        self.hold.reset()
        self._held = self.place

    def command(self, view: BaseView) -> BaseCommand:
        """Return the command for thrusters and wheels in this control step."""
        turn = self.hold.acceleration(view.q, view.v) if self.holds == "both" else None
        force, moment = self._wrench(view, turn)
        if turn is None or self._wheels is None:
            return BaseCommand(thruster_force=self._thrusters.forces(force, moment))
        spin: FloatArray = view.v[3:6]
        return BaseCommand(
            self._wheels.torques(moment, spin, turn, view.wheel_momentum),
            self._thrusters.forces(force, np.zeros(3)),
        )

    def _acceleration(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the desired rate (3,) of Pinocchio's v[:3] without angular acceleration, root axes."""
        R, c, spin = pin.Quaternion(q[3:7]).toRotationMatrix(), self.sms.base_com, v[3:6]
        place, velocity = q[:3] + R @ c, v[:3] + np.cross(spin, c)
        if self._held is None:
            self._held = place
        k, drag = self.hold.bandwidth**2, 2.0 * self.hold.damping * self.hold.bandwidth
        desired = -k * R.T @ (place - self._held) - drag * velocity
        # The acceleration of the centre of mass is v' + w x v + w' x c + w x (w x c).
        acceleration: FloatArray = desired - np.cross(spin, velocity)
        return acceleration

    def _wrench(self, view: BaseView, turn: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Return the force [N], and the moment [N m] about the base's centre of mass, root axes (3,) each.

        If the attitude is free, no moment acts about the base's centre of mass.
        """
        from scipy.linalg import block_diag  # slow to load

        n, about = self.sms.n, np.vstack([pin.skew(self.sms.base_com), np.eye(3)])
        prescribed = np.concatenate([self._acceleration(view.q, view.v), np.zeros(3 + n)])
        if turn is not None:
            prescribed[:6] += about @ turn
        free = block_diag(about if turn is None else np.zeros((6, 0)), np.eye(n))
        wrench = partly_held(self.sms, view.q, view.v, prescribed, free, view.tau)[:6]
        return wrench[:3], np.asarray(about.T @ wrench)


class PulseWidth:
    """A modulator that turns desired thruster forces into pulses.

    The period is rounded to a whole number of control steps. It has at most one pulse, which begins with the
    period. A pulse lasts a whole number of control steps, at least the least on-time. An impulse that is too
    small for a pulse is carried over to the next periods, so that the mean force equals the desired force. If
    the missing impulse exceeds that of a pulse over a whole period, the excess is dropped, because the
    thruster is too weak.

    Source: the pulse-width modulation of W. E. Vander Velde and J. He, "Design of space structure control
    systems using on-off thrusters", Journal of Guidance, Control, and Dynamics 6 (1983). The remainder is
    carried over as in sigma-delta modulation.

    Parameters
    ----------
    thrusters : Thrusters
        Thrusters that are on or off.
    dt : float
        Control step [s].

    Raises
    ------
    InvalidValue
        The thrusters have no period, a period shorter than the control step, or a least on-time that exceeds
        the rounded period.
    """

    def __init__(self, thrusters: Thrusters, dt: float) -> None:
        if thrusters.period is None or thrusters.period < dt * (1.0 - 1e-9):
            raise InvalidValue(
                "thrusters.period", thrusters.period, f"must be at least the control step, {dt:g} s"
            )
        self._force = thrusters.force
        self._steps = max(1, round(thrusters.period / dt))
        self._least = max(1, int(np.ceil(thrusters.least_on_time / dt - 1e-9)))
        if self._least > self._steps:
            text = f"must be at most {self._steps * dt:g} s, the period rounded to control steps of {dt:g} s"
            raise InvalidValue("thrusters.least_on_time", thrusters.least_on_time, text)
        self._desired = np.zeros(len(thrusters))  # missing impulse, in control steps at the largest force
        self._on = np.zeros(len(thrusters))  # number of control steps of the present pulse
        self._step = 0

    def apply(self, force: FloatArray) -> FloatArray:
        """Return the forces (k,) [N] of this control step, zero or the largest, for desired forces (k,)."""
        if self._step == 0:
            # The desired forces of the last period determine the pulse, so the first period has none.
            steps = np.round(self._desired + 1e-9)
            self._on = np.where(steps >= self._least, np.minimum(steps, self._steps), 0.0)
            self._desired = np.minimum(self._desired - self._on, float(self._steps))
        self._desired = self._desired + np.clip(force / self._force, 0.0, 1.0)
        burning = self._step < self._on
        self._step = (self._step + 1) % self._steps
        return frozen(np.where(burning, self._force, 0.0))

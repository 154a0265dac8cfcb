"""Guards of a closed loop, which stop a flight that exceeds a limit."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray, at_least_zero, whole
from ffsms_pin.control.stopping import STEPS
from ffsms_pin.errors import ResultError
from ffsms_pin.files import path_like
from ffsms_pin.opt.limits.limit import POSITION_MARGIN, RATE_MARGIN
from ffsms_pin.options import Angle, AtLeastOne, Margin, Text, Unit
from ffsms_pin.references import Observer
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.devices import Actuator, WristSensor
from ffsms_pin.simulation.tracking import Tracking
from ffsms_pin.system.dynamics import floating_motion, inertia_matrix

_ENERGY_PERIOD = 0.02  # [s] between two checks of the energy, because each needs an inertia matrix
_ENERGY_FLOOR = 0.5  # share of the rate limits, for the energy that the energy guard always allows
_RATE = 1.0  # [rad/s or m/s] rate limit that the energy guard assumes for a joint without a rate limit
_RELEASE = 1.0  # [s] time without contact guards, in which a supervisor can end a contact
_CUT = 1.0 - 1e-9  # share of a torque limit from which a torque counts as saturated


@dataclass(frozen=True)
class Guards:
    """The limits of a flight; a flight that exceeds a limit is stopped.

    When a guard trips, `control.StoppingLaw` brakes the joints until the end of the run, while the base's
    law continues. A `Supervisor` may react otherwise. The recording's `stopped` has the time and the reason,
    and the flight has not arrived. None or an infinite number switches a guard off. A state that is not
    finite always raises `SimulationDiverged`.

    Raises
    ------
    InvalidValue
        A number is out of range, or the file name is unusable.
    """

    position_margin: Annotated[Margin | None, Angle("rad or m")] = POSITION_MARGIN
    """The largest distance beyond its position limit at which a joint would come to rest when braked, with
    half of its torque limit or at twice its acceleration limit, whichever brakes harder. Limp joints are
    ignored, because mechanical stops hold them."""
    rate_margin: Annotated[Margin | None, Unit()] = RATE_MARGIN
    """The share by which a joint may exceed its rate limit. The default allows for control errors, for
    example due to wrong masses."""
    saturation: Annotated[Margin | None, Unit("s")] = 0.3
    """The time at its torque limit after which a joint trips the guard. Later time below the limit is
    subtracted. The torque limit is the law's `torque_limit`, or the robot's limit if the law has none, and at
    most the limit of the `Actuator`."""
    joint_error: Annotated[Margin | None, Angle("rad or m")] = 1.0
    """The largest deviation of a joint from its reference."""
    contact_force: Annotated[Margin | None, Unit("N")] = math.inf
    """The largest force of a client on the end effector that the grip bears."""
    contact_torque: Annotated[Margin | None, Unit("N m")] = math.inf
    """The largest torque of a client on the end effector that the grip bears."""
    contact_share: Annotated[Margin | None, Unit()] = 1.0
    """The largest load of a client on the wrist and on the joints, as a share of their limits. The
    limits of the wrist are `force_limit` and `moment_limit` of the `WristSensor`. Until a latch, the joint
    torques that balance the load are compared with the torque limits."""
    base_rate: Annotated[Margin | None, Angle("rad/s")] = 1.0
    """The largest angular velocity of the base. The default is about the range of a satellite's
    gyroscopes."""
    energy: Annotated[Margin | None, Unit()] = 1.0
    """The largest excess of the joint motion's kinetic energy over the reference's largest kinetic energy so
    far, divided by this largest energy. The default allows rates about 40 % above the desired rates. In
    addition, the sum of each joint's energy at half of its rate limit is always allowed."""
    failed_steps: Annotated[AtLeastOne | None, Unit()] = 10
    """The number of consecutive planning steps without a solution (`Observer.failed_in_a_row`) at which the
    guard trips."""
    path: Annotated[Text | os.PathLike[str] | None, Unit("", "none")] = None
    """A file for the recording (npz, as by `Tracking.save`), written if the flight is stopped or diverges; in
    a scenario the path is relative to the results folder."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name in ("failed_steps", "path") or value is None:
                continue
            if not (isinstance(value, float) and value == math.inf):
                at_least_zero(f"guards.{name}", value)
        if self.failed_steps is not None and self.failed_steps != math.inf:
            whole("guards.failed_steps", self.failed_steps, 1)
        if self.path is not None:
            path_like("guards.path", self.path)

    def limit(self, name: str) -> float:
        """Return the limit of a guard by its name, infinite if the guard is off."""
        value = getattr(self, name)
        return math.inf if value is None else float(value)

    def saved(self, tracking: Tracking) -> str:
        """Save a recording at `path`, and return a text with the path or the error; empty without a path."""
        if self.path is None:
            return ""
        try:
            tracking.save(self.path)
        except ResultError as error:
            return f"the recording could not be saved ({error})"
        return f"recorded until then: {self.path}"


GUARDS = Guards()  # default of a run


class Trip(NamedTuple):
    """A guard that has tripped.

    Attributes
    ----------
    guard : str
        The name of the guard, a field of `Guards`.
    reason : str
        One line about the exceeded limit.
    """

    guard: str
    reason: str


@runtime_checkable
class TorqueLimited(Protocol):
    """A controller with the attribute `torque_limit` (n,), the limits of its torques [N m or N]."""

    torque_limit: FloatArray


class Saturation:
    """The time that each joint spends at its torque limit.

    Attributes
    ----------
    limit : ndarray, shape (n,)
        The effective torque limits [N m].
    total : ndarray, shape (n,)
        The number of control steps at the limit so far.
    """

    def __init__(
        self, plant: SpaceManipulator, controller: Any, actuator: Actuator | None, dt: float
    ) -> None:
        own = controller.torque_limit if isinstance(controller, TorqueLimited) else plant.limits.torque
        limit = np.array(own, dtype=np.float64)
        limit = limit if limit.shape == (plant.n,) else np.array(plant.limits.torque)
        if actuator is not None:
            limit = np.minimum(limit, actuator.torque_limit)
        self.limit, self._names, self._dt = limit, plant.joint_names, dt
        self._units = ["N m" if turns else "N" for turns in plant.layout.turns]
        self._from, self.total = _CUT * limit, np.zeros(plant.n)
        self._level, self._steps = np.zeros(plant.n), 0

    def commanded(self, torque: FloatArray) -> None:
        """Update the times at the limits, from the torques (n,) that the law commands in a control step."""
        self._steps += 1
        reached = np.abs(torque) >= self._from
        if reached.any():
            self.total += reached
            self._level = np.where(reached, self._level + 1.0, np.maximum(self._level - 1.0, 0.0))
        elif self._level.any():
            self._level = np.maximum(self._level - 1.0, 0.0)

    def worst(self) -> tuple[int, float]:
        """Return the index of the joint with the longest net time at its limit, and this time [s]."""
        i = int(self._level.argmax())
        return i, float(self._level[i]) * self._dt

    def notes(self) -> list[str]:
        """Return a sentence for each joint that has been at its torque limit."""
        message = "joint '{}' was at its torque limit of {:.3g} {} for {:.3g} s in all ({:.3g} % of the time)"
        sentences = []
        for i in np.flatnonzero(self.total):
            spent, share = self.total[i] * self._dt, 100.0 * self.total[i] / self._steps
            sentences.append(message.format(self._names[i], self.limit[i], self._units[i], spent, share))
        return sentences


class Watch:
    """The guards of one run."""

    def __init__(
        self,
        guards: Guards,
        plant: SpaceManipulator,
        wrist: WristSensor | None,
        dt: float,
    ) -> None:
        limits, self._names = plant.limits, plant.joint_names
        self._limits, self._layout = limits, plant.layout
        self._units = ["rad" if turns else "m" for turns in plant.layout.turns]
        self._guards = guards
        margin = guards.limit("position_margin")
        self._lower, self._upper = limits.lower - margin, limits.upper + margin
        self._stops = bool(np.isfinite([self._lower, self._upper]).any())
        self._reaction = 2.0 * STEPS * dt  # [s] twice the shortest time constant of `StoppingLaw`
        # [s^2/rad] braking distance at twice the acceleration limit, divided by rate^2
        self._braking = 0.25 / limits.acceleration
        self._most_rate = (1.0 + guards.limit("rate_margin")) * limits.velocity
        share = math.inf if wrist is None else guards.limit("contact_share")
        force, moment = (math.inf, math.inf) if wrist is None else (wrist.force_limit, wrist.moment_limit)
        self._force = min(guards.limit("contact_force"), math.inf if share == math.inf else share * force)
        self._torque = min(guards.limit("contact_torque"), math.inf if share == math.inf else share * moment)
        self._from, self._release = 0, max(1, round(_RELEASE / dt))
        self._every = max(1, round(_ENERGY_PERIOD / dt))
        self._reference_energy = 0.0  # [J] the largest energy of the desired joint rates so far
        self._rates = np.where(np.isfinite(limits.velocity), limits.velocity, _RATE) * _ENERGY_FLOOR

    def trip(
        self,
        k: int,
        plant: SpaceManipulator,
        q: FloatArray,
        v: FloatArray,
        joint_error: FloatArray,
        desired_rates: FloatArray,
        wrench: FloatArray,
        latched: bool,
        saturation: Saturation,
        observers: Sequence[Observer],
        limp: NDArray[np.bool_],
    ) -> Trip | None:
        """Return the guard that trips at row k, or None.

        `wrench` (6,) is the client's wrench on the end effector; `limp` (n,) is True for limp joints.
        """
        guards, rates = self._guards, v[6:]
        if k >= self._from and wrench.any() and (trip := self._of_contact(plant, q, wrench, latched)):
            return trip  # checked first, because a strong contact also causes other guards to trip
        if reason := self._of_stops(plant, q, rates, saturation.limit, limp):
            return Trip("position_margin", reason)
        if reason := self._of_rates(rates):
            return Trip("rate_margin", reason)
        if reason := self._of_saturation(saturation):
            return Trip("saturation", reason)
        if reason := self._of_error(joint_error):
            return Trip("joint_error", reason)
        if reason := self._of_base(v[3:6]):
            return Trip("base_rate", reason)
        if k % self._every == 0 and (reason := self._of_energy(plant, q, rates, desired_rates)):
            return Trip("energy", reason)
        if reason := _of_planning(guards.limit("failed_steps"), observers):
            return Trip("failed_steps", reason)
        return None

    def handled(self, k: int) -> None:
        """Disable the contact guards for 1 s from row k on, so that a supervisor can end the contact."""
        self._from = k + self._release

    def _of_stops(
        self,
        plant: SpaceManipulator,
        q: FloatArray,
        rates: FloatArray,
        torque: FloatArray,
        limp: NDArray[np.bool_],
    ) -> str:
        if not self._stops:
            return ""
        joints, speed = self._layout.positions(q), np.abs(rates)
        displacement = np.maximum(self._reaction * speed, self._braking * speed**2)
        if not self._beyond(joints, rates, displacement)[~limp].any():
            return ""
        M = inertia_matrix(plant, q)
        strength = 0.5 * torque / np.diag(M[6:] @ floating_motion(M))  # decelerations by half of the limits
        displacement = np.maximum(self._reaction * speed, speed**2 / (2.0 * strength))
        over = np.where(limp, 0.0, self._beyond(joints, rates, displacement))
        if not over.any():
            return ""
        i = int(over.argmax())
        limits, unit, now = self._limits, self._units[i], joints[i]
        stop = limits.upper[i] if now > 0.5 * (limits.lower[i] + limits.upper[i]) else limits.lower[i]
        if limits.lower[i] <= now <= limits.upper[i]:
            message = f"joint '{self._names[i]}' is too fast to brake before its stop at {stop:.4g} {unit}"
            return f"{message} ({speed[i]:.3g} {unit}/s at {now:.4g} {unit})"
        beyond_by = f"{abs(now - stop):.3g} {unit} beyond its stop at {stop:.4g} {unit}"
        return f"joint '{self._names[i]}' is {beyond_by}"

    def _beyond(self, joints: FloatArray, rates: FloatArray, displacement: FloatArray) -> FloatArray:
        """Return the excess (n,) over stops and margin after a displacement (n,) along the rates."""
        ahead = joints + np.sign(rates) * displacement
        return np.maximum(np.maximum(ahead - self._upper, self._lower - ahead), 0.0)

    def _of_rates(self, rates: FloatArray) -> str:
        fast = np.abs(rates) > self._most_rate
        if not fast.any():
            return ""
        i = int((np.abs(rates) / self._most_rate).argmax())
        limit, unit = self._limits.velocity[i], self._units[i]
        moves = f"moves at {abs(rates[i]):.3g} {unit}/s, its limit is {limit:.3g} {unit}/s"
        return f"joint '{self._names[i]}' {moves}"

    def _of_saturation(self, saturation: Saturation) -> str:
        i, time = saturation.worst()
        most = self._guards.limit("saturation")
        if time < most or time == 0.0:
            return ""
        limit, unit = saturation.limit[i], "N m" if self._units[i] == "rad" else "N"
        return f"joint '{self._names[i]}' at its torque limit for {time:.3g} s ({limit:.3g} {unit})"

    def _of_error(self, joint_error: FloatArray) -> str:
        i, most = int(np.abs(joint_error).argmax()), self._guards.limit("joint_error")
        if abs(joint_error[i]) <= most:
            return ""
        unit = self._units[i]
        off = f"{abs(joint_error[i]):.3g} {unit}"
        return f"joint '{self._names[i]}' is {off} off its reference, {most:.3g} {unit} are allowed"

    def _of_contact(
        self, plant: SpaceManipulator, q: FloatArray, wrench: FloatArray, latched: bool
    ) -> Trip | None:
        for name, most, load, kind, unit in (
            ("contact_force", self._force, wrench[:3], "force", "N"),
            ("contact_torque", self._torque, wrench[3:], "torque", "N m"),
        ):
            size = math.sqrt(load @ load)
            if size > most:
                return Trip(name, f"the contact {kind} is {size:.3g} {unit}, {most:.3g} {unit} are allowed")
        share = self._guards.limit("contact_share")
        if latched or share == math.inf:  # the motor torques include the load of a latched client
            return None
        loads = np.abs(wrench @ plant.at(q).J_star)
        i = int((loads / self._limits.torque).argmax())
        most, unit = share * self._limits.torque[i], "N m" if self._units[i] == "rad" else "N"
        if loads[i] <= most:
            return None
        message = f"the contact loads joint '{self._names[i]}' with {loads[i]:.3g} {unit}"
        return Trip("contact_share", f"{message}, {most:.3g} {unit} are allowed")

    def _of_base(self, angular_velocity: FloatArray) -> str:
        rate, most = math.sqrt(angular_velocity @ angular_velocity), self._guards.limit("base_rate")
        return "" if rate <= most else f"the base turns at {rate:.3g} rad/s, {most:.3g} rad/s are allowed"

    def _of_energy(
        self, plant: SpaceManipulator, q: FloatArray, rates: FloatArray, desired_rates: FloatArray
    ) -> str:
        share = self._guards.limit("energy")
        if share == math.inf:
            return ""
        M = inertia_matrix(plant, q)
        H = M[6:] @ floating_motion(M)
        self._reference_energy = max(self._reference_energy, 0.5 * float(desired_rates @ H @ desired_rates))
        energy, floor = 0.5 * float(rates @ H @ rates), 0.5 * float(self._rates**2 @ np.diag(H))
        if energy <= floor + (1.0 + share) * self._reference_energy:
            return ""
        planned = f"that of the reference was at most {self._reference_energy:.3g} J"
        return f"the kinetic energy of the joint motion is {energy:.3g} J, {planned}"


def _of_planning(most: float, observers: Sequence[Observer]) -> str:
    failed = max((observer.failed_in_a_row for observer in observers), default=0)
    return "" if failed < most else f"{failed} planning steps in a row were not solved"

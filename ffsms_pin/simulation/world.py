"""The plant and client of a run, with their dynamics under all forces and events."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ffsms_pin.actuation import gyrostat
from ffsms_pin.checks import FloatArray
from ffsms_pin.client.impact import plastic
from ffsms_pin.errors import InvalidValue
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.bodies import BaseActuators, ClientBody, with_client
from ffsms_pin.simulation.devices import JointFriction
from ffsms_pin.simulation.events import (
    Capture,
    Close,
    End,
    Event,
    Force,
    Freeze,
    GeneralisedForce,
    Latch,
    Open,
    Phase,
    Wrench,
)
from ffsms_pin.simulation.integrators import (
    Integrator,
    Step,
    adaptive_step,
    extrapolated_step,
    rk4_step,
    stiff_step,
    variational_step,
)
from ffsms_pin.simulation.stops import Stops
from ffsms_pin.system.dynamics import frame_pose

_FINER = 8  # factor on the number of substeps if a load is too stiff for them
# Largest number of substeps for friction; an implicit integrator is faster than more substeps.
_MOST_PARTS = 40


class World:
    """A plant with friction, external wrenches, failed joints and a client, integrated step by step.

    The integrated model has the wheels after the joints (see `gyrostat`), and a free client after the
    wheels. A capture changes `plant` and keeps the wheels' speeds relative to the base. `impulse` (6,) is
    the impulse of thrusters and disturbances so far, about the total centre of mass, inertial axes.
    """

    def __init__(
        self,
        plant: SpaceManipulator,
        integrator: Integrator,
        friction: JointFriction | None,
        disturbances: Sequence[Wrench],
        base: BaseActuators,
        client: ClientBody | None,
        substeps: int,
    ) -> None:
        self._integrate, self._substeps = integrator, substeps
        self.client, self.impulse = client, np.zeros(6)
        self._friction = None if friction is None else friction.torque(plant.n)
        self._steep = None  # square roots of the largest friction slopes, if the integrator is not adaptive
        if friction is not None and integrator not in (adaptive_step, stiff_step):
            self._steep = np.sqrt(friction.steepest(plant.n))
            self._friction_slopes = friction.slopes(plant.n)
        self._disturbances = tuple(disturbances)
        self._contact = False  # True while the client's loads act in the present step
        self._locked: list[int] = []  # indices in v
        self._limp = np.zeros(plant.n, dtype=bool)
        self._stops: Stops | None = None  # set when a joint goes limp
        self._pushing: Stops | None = None  # the stops, if a limp joint is near its stop in the present step
        self.base = base
        self._wheels = base.wheels
        self._nq, self._nv = plant.nq, plant.nv
        self._with = plant.nv + base.wheel_torque.size  # number of velocities before the client's
        self._rubs = self._wheels is not None and self._wheels.rubs
        self._tau = np.zeros(self._with + 6)
        self._take(plant)

    @property
    def pushed(self) -> bool:
        """True if the run has disturbances or a thruster has fired, so that the total momentum may change."""
        return bool(self._disturbances) or self.base.propellant > 0.0

    @property
    def notes(self) -> list[str]:
        """A sentence for each limp joint that ran into its stop."""
        return [] if self._stops is None else self._stops.notes

    @property
    def limp(self) -> NDArray[np.bool_]:
        """The mask (n,) of limp joints, which have no motor torque."""
        return self._limp

    def _take(self, plant: SpaceManipulator) -> None:
        self.plant = plant
        self._model = plant.model if self._wheels is None else gyrostat(plant.model, self._wheels)
        if self._free is not None:
            self._model = with_client(self._model, self._free.client)
        self._tau = self._tau[: self._model.nv].copy()
        self._data = self._model.createData()
        self._own = self._model.createData()
        self._forces: list[GeneralisedForce] = [
            disturbance.force(plant) for disturbance in self._disturbances
        ]

    @property
    def _free(self) -> ClientBody | None:
        """The client while it is free; None after it is latched, or without a client."""
        return None if self.client is None or self.client.joined is not None else self.client

    def step(self, t: float, q: FloatArray, v: FloatArray, tau: FloatArray, dt: float) -> Step:
        """Return the plant's state after a step under joint torques (n,), and the work of all forces [J].

        The base's actuators follow their last `BaseActuators.command`. Wheels and client are advanced, too.
        """
        nq, nv, base, start = self._nq, self._nv, self.base, q
        force = self._tau
        force[6:nv] = tau
        if self._stops is not None:
            force[6:nv][self._limp] = 0.0
        base.fill(force[: self._with])
        free = self._free
        q, v = self._whole(q, v)
        loaded, at_stops = free is not None and bool(free.acting), 1
        if self._stops is not None:
            at_stops = self._stops.begin(self._model, self._own, q, v, self._limp, dt)
            self._pushing = self._stops if self._stops.near else None
        plain = self._friction is None and not self._forces and not self._locked and not self._rubs
        plain = plain and self._pushing is None
        self._contact, impulse = loaded and self._touches(q, v), self.impulse
        acting: Force = force if plain and not self._contact else self._force
        fine = self.client is None or self._contact
        parts, steep, integrate = self._substeps if fine else 1, self._for_friction(q, dt), self._integrate
        if steep > _MOST_PARTS:
            integrate, acting = self._steep_step()
        if self._pushing is not None and integrate is variational_step:
            integrate = rk4_step  # the backward substep of the variational step is unstable with dampers
        parts = max(parts, at_stops, 1 if steep > _MOST_PARTS else steep)
        q_end, v_end, work = self._in_parts(t, q, v, acting, dt, parts, integrate)
        if loaded and not self._contact and self._touches(q_end, v_end):  # contact began within the step
            self._contact, self.impulse, parts = True, impulse, max(self._substeps, parts)
            integrate = stiff_step if steep > _MOST_PARTS else integrate
            q_end, v_end, work = self._in_parts(t, q, v, self._force, dt, parts, integrate)
        if self._contact and not np.isfinite(v_end).all():  # a load is too stiff for this step
            self.impulse = impulse
            q_end, v_end, work = self._in_parts(t, q, v, self._force, dt, _FINER * parts, integrate)
        q, v = q_end, v_end
        base.stepped(v[nv : self._with])
        if free is not None:
            free.q, free.v = q[-7:], v[-6:]
        elif self.client is not None:
            self.client.carried(self._model, self._own, self.plant.frame_id, q, v)
        q_end, v_end = q[:nq], v[:nv]
        if self._pushing is not None:
            self._pushing.reached(t + dt, q_end, self._limp)
        for k in self._locked:  # remove the drift, because the lock's torque holds the joint only to rounding
            v_end[k] = 0.0
        if self._locked:
            positions = self.plant.layout.positions(q_end)
            failed = [k - 6 for k in self._locked]
            positions[failed] = self.plant.layout.positions(start)[failed]
            self.plant.layout.set_positions(q_end, positions)
        return q_end, v_end, work

    def _steep_step(self) -> tuple[Integrator, Force]:
        """Return the integrator and the force of a step with steep friction.

        The integrator is `stiff_step` if contact, stops or wheel friction act as well.
        """
        if self._contact or self._pushing is not None or self._rubs:
            return stiff_step, self._force
        closed = not self._forces and self.base.thrusters is None  # here no client is in contact
        locked = tuple(self._locked)
        step = partial(extrapolated_step, slopes=self._slopes, closed=closed, locked=locked)
        return step, self._applied

    def _slopes(self, v: FloatArray) -> FloatArray:
        """Return the slopes (nv,) of joint friction at velocities v (nv,); zero in all other rows."""
        slopes = np.zeros(v.size)
        slopes[6 : self._nv] = self._friction_slopes(v[6 : self._nv])
        return slopes

    def _touches(self, q: FloatArray, v: FloatArray) -> bool:
        """Return whether a load acts on the client in a full state (q, v)."""
        assert self._free is not None
        return bool(self._free.wrench(self._model, self._own, self.plant.frame_id, q, v)[0].any())

    def _for_friction(self, q: FloatArray, dt: float) -> int:
        """Return the number of substeps of dt that resolve the friction slopes D.

        It is the largest eigenvalue of dt H^-1 D, rounded up, with the reduced inertia matrix H.
        """
        if self._steep is None:
            return 1
        joints = slice(6, self._nv)
        upper = pin.computeMinverse(self._model, self._own, q)[joints, joints]
        rates = np.linalg.eigvalsh(self._steep[:, None] * upper * self._steep, UPLO="U")
        parts = np.ceil(dt * rates[-1])
        return int(parts) if np.isfinite(parts) else 1

    def _in_parts(
        self,
        t: float,
        q: FloatArray,
        v: FloatArray,
        force: Force,
        dt: float,
        parts: int,
        integrate: Integrator,
    ) -> Step:
        """Take a step in `parts` equal substeps, and return the full state and the work done.

        The impulse of external forces is added to `self.impulse`.
        """
        work, h, impulse = 0.0, dt / parts, self.impulse
        pushed = bool(self._forces) or self.base.thrusters is not None
        for k in range(parts):
            begin = q, v
            q, v, done = integrate(self._model, self._data, q, v, force, h, t + k * h)
            if pushed:
                impulse = impulse + self._from_outside(t + k * h, h, begin, (q, v))
            work += done
        if pushed and np.isfinite(v).all():
            self.impulse = impulse
        return q, v, work

    def _whole(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the full integrated state; wheel angles are zero, because nothing uses them."""
        if self._wheels is not None:
            q, v = np.concatenate([q, np.zeros(len(self._wheels))]), np.concatenate([v, self.base.speed])
        if self._free is not None:
            q, v = np.concatenate([q, self._free.q]), np.concatenate([v, self._free.v])
        return q, v

    def _applied(self, t: float, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the generalised force on plant, wheels and client, without the torques of locks."""
        force, nq, nv = self._tau.copy(), self._nq, self._nv
        if self._friction is not None:
            force[6:nv] += self._friction(v[6:nv])
        if self._pushing is not None:
            force[6:nv] += self._pushing.torque(q[:nq], v[6:nv])
        for disturbance in self._forces:
            force[:nv] += disturbance(t, q[:nq], v[:nv])
        if self._wheels is not None and self._rubs:
            force[nv : self._with] += self._wheels.friction_torque(v[nv : self._with])
        free = self._free
        if free is not None and self._contact:
            force += free.generalised(self._model, self._own, self.plant.frame_id, q, v)
        return force

    def _force(self, t: float, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the generalised force (6 + n + w [+ 6],) on plant, wheels and a free client, with locks."""
        force = self._applied(t, q, v)
        if self._locked:
            model, data = self._model, self._own
            acceleration = pin.aba(model, data, q, v, force)[self._locked]
            columns = np.zeros((v.size, len(self._locked)))
            columns[self._locked, range(len(self._locked))] = 1.0
            compliance = np.linalg.solve(pin.crba(model, data, q), columns)[self._locked]
            force[self._locked] -= np.linalg.solve(compliance, acceleration)
        return force

    def _from_outside(self, t: float, h: float, *ends: tuple[FloatArray, FloatArray]) -> FloatArray:
        """Return the impulse (6,) of thrusters and disturbances in a step of h [s], by Simpson's rule.

        The impulse is in inertial axes, about the total centre of mass. `ends` are q and v at start and end.
        """
        (q0, v0), (q1, v1) = ends
        middle = pin.interpolate(self._model, q0, q1, 0.5), 0.5 * (v0 + v1)
        whole = np.zeros(6)
        for weight, at, (q, v) in ((1.0, t, (q0, v0)), (4.0, t + 0.5 * h, middle), (1.0, t + h, (q1, v1))):
            on_base = self._tau[:6].copy()  # wrench of the thrusters about the root, root axes
            for disturbance in self._forces:
                on_base += disturbance(at, q[: self._nq], v[: self._nv])[:6]
            R = pin.Quaternion(q[3:7]).toRotationMatrix()
            arm = q[:3] - pin.centerOfMass(self._model, self._own, q)
            force = R @ on_base[:3]
            whole[:3] += weight * force
            whole[3:] += weight * (R @ on_base[3:] + np.cross(arm, force))
        return (h / 6.0) * whole

    def wrench(self, t: float, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the wrench (6,) of the client on the end effector, inertial axes.

        The moment is about the end-effector frame's origin. The wrench is the sum of the loads or, after a
        latch, the wrench due to the client's inertia under the last torques.
        """
        if self.client is None or not (self.client.joined or self.client.acting):
            return np.zeros(6)
        model, data, frame, (q, v) = self._model, self._own, self.plant.frame_id, self._whole(q, v)
        if self.client.joined is None:
            return self.client.wrench(model, data, frame, q, v)[0]
        acceleration = pin.aba(model, data, q, v, self._force(t, q, v)).copy()
        return self.client.carrying(model, data, frame, q, v, acceleration)

    def wrist(self, t: float, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the sum (6,) of `wrench` (6,) and disturbances on the end effector, in end-effector axes.

        `wrench` is the client's wrench on the end effector in inertial axes.
        """
        acting = sum(
            (disturbance.value(t) for disturbance in self._disturbances if disturbance.on != "base"), wrench
        )
        R = frame_pose(self.plant, q).rotation
        return np.concatenate([acting[:3] @ R, acting[3:] @ R])

    def apply(self, event: Event, q: FloatArray, v: FloatArray) -> FloatArray:
        """Apply an event and return the post-event velocity (6 + n,)."""
        if isinstance(event, (Phase, Freeze, End)):
            return v
        if isinstance(event, (Close, Open, Latch)):
            if self._free is None:
                kind = f"contains {type(event).__name__} at {event.time:g} s, which requires a free client"
                remedy = "add the argument client" if self.client is None else "it is latched already"
                raise InvalidValue("events", str(event), f"{kind}; {remedy}")
            if isinstance(event, Latch):
                client, joined = self._free, self._free.latch(self.plant, q, v, self._locked)
                self._take(joined.robot)
                v = joined.v.copy()
                client.carried(self._model, self._own, self.plant.frame_id, *self._whole(q, v))
                return v
            self._free.grips = (*self._free.grips, event.load) if isinstance(event, Close) else ()
            return v
        if isinstance(event, Capture):
            plant, v = event.apply(self.plant, q, v, self._locked)
            self._take(plant)
            return v
        joint = event.index(self.plant)
        if event.kind == "limp":
            self._limp[joint], self._stops = True, self._stops or Stops(self.plant)
            return v
        if 6 + joint not in self._locked:
            self._locked.append(6 + joint)
        M = pin.crba(self.plant.model, self.plant.model.createData(), q)
        return plastic(M, M @ v, self._locked)

    def totals(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, float, FloatArray]:
        """Return total momentum (6,), total kinetic energy [J] and the end effector's position (3,) [m].

        The momentum is about the total centre of mass, inertial axes.
        """
        model, data = self._model, self._own
        momentum = pin.computeCentroidalMomentum(model, data, *self._whole(q, v)).vector
        energy = float(pin.computeKineticEnergy(model, data))  # uses q and v of the call above
        return momentum, energy, pin.updateFramePlacement(model, data, self.plant.frame_id).translation

"""The plant in a run: its dynamics with everything that acts on it, and what happens to it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import gyrostat
from ffsms_pin.checks import FloatArray
from ffsms_pin.simulation.base_actuators import BaseActuators
from ffsms_pin.simulation.devices import JointFriction
from ffsms_pin.simulation.events import Capture, Event, GeneralisedForce, Wrench
from ffsms_pin.simulation.integrators import Integrator
from ffsms_pin.system import SpaceManipulator

__all__ = ["World"]


class World:
    """A plant with friction, external wrenches and failed joints, integrated step by step.

    With wheels they are the last joints of what is integrated (see `gyrostat`), and a capture leaves their
    speeds against the base as they are; without `base` they stand still. A capture changes `plant`.
    """

    def __init__(
        self,
        plant: SpaceManipulator,
        integrator: Integrator,
        friction: JointFriction | None = None,
        disturbances: Sequence[Wrench] = (),
        base: BaseActuators | None = None,
    ) -> None:
        self._integrate = integrator
        self._friction = None if friction is None else friction.torque(plant.n)
        self._disturbances = tuple(disturbances)
        self._locked: list[int] = []  # indices in v
        self._limp, self._limp_any = np.zeros(plant.n, dtype=bool), False
        self._base = base
        self._wheels = None if base is None else base.wheels
        self._nq, self._nv = plant.nq, plant.nv
        self._rubs = self._wheels is not None and self._wheels.rubs
        self._tau = np.zeros(plant.nv + (0 if self._wheels is None else len(self._wheels)))
        self._take(plant)

    @property
    def pushed(self) -> bool:
        """Whether something acts from outside, so that the total momentum changes."""
        return bool(self._disturbances) or (self._base is not None and self._base.propellant > 0.0)

    def _take(self, plant: SpaceManipulator) -> None:
        self.plant = plant
        self._model = plant.model if self._wheels is None else gyrostat(plant.model, self._wheels)
        self._data = self._model.createData()
        self._own = self._model.createData()
        self._forces: list[GeneralisedForce] = [one.force(plant) for one in self._disturbances]

    def step(
        self, t: float, q: FloatArray, v: FloatArray, tau: FloatArray, dt: float
    ) -> tuple[FloatArray, FloatArray, float]:
        """State after a step under joint torques (n,), and the work done on the plant in it [J].

        What the base's actuators do in it was decided by `BaseActuators.command`.
        """
        nq, nv, base = self._nq, self._nv, self._base
        force = self._tau
        force[6:nv] = tau
        if self._limp_any:
            force[6:nv][self._limp] = 0.0
        if base is not None:
            base.fill(force)
            q, v = self._with_wheels(q, v)
        model = self._model
        held = self._friction is None and not self._forces and not self._locked and not self._rubs
        acting = force if held else self._force
        q_end, v_end, work = self._integrate(model, self._data, q, v, acting, dt, t)
        if base is not None:
            base.stepped(v_end[nv:])
            q_end, v_end = q_end[:nq], v_end[:nv]
        for k in self._locked:  # the lock's torque holds the joint to rounding; this holds it for ever
            v_end[k] = 0.0
        if self._locked:
            positions = self.plant.layout.positions(q_end)
            failed = [k - 6 for k in self._locked]
            positions[failed] = self.plant.layout.positions(q)[failed]
            self.plant.layout.set_positions(q_end, positions)
        return q_end, v_end, work

    def _with_wheels(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """State of the model in which wheels are joints; a wheel's angle matters to nobody."""
        if self._base is None or self._wheels is None:
            return q, v
        return np.concatenate([q, np.zeros(len(self._wheels))]), np.concatenate([v, self._base.speed])

    def _force(self, t: float, q: FloatArray, v: FloatArray) -> FloatArray:
        """Everything that acts (6 + n,), with that on the wheels (6 + n + w,)."""
        force, nq, nv = self._tau.copy(), self._nq, self._nv
        if self._friction is not None:
            force[6:nv] += self._friction(v[6:nv])
        for disturbance in self._forces:
            force[:nv] += disturbance(t, q[:nq], v[:nv])
        if self._wheels is not None and self._rubs:
            force[nv:] += self._wheels.friction_torque(v[nv:])
        if self._locked:
            model, data = self._model, self._own
            acceleration = pin.aba(model, data, q, v, force)[self._locked]
            columns = np.zeros((v.size, len(self._locked)))
            columns[self._locked, range(len(self._locked))] = 1.0
            compliance = np.linalg.solve(pin.crba(model, data, q), columns)[self._locked]
            force[self._locked] -= np.linalg.solve(compliance, acceleration)
        return force

    def apply(self, event: Event, q: FloatArray, v: FloatArray) -> FloatArray:
        """Let it happen; the velocity (6 + n,) right after."""
        if isinstance(event, Capture):
            plant, v = event.apply(self.plant, q, v, self._locked)
            self._take(plant)
            return v
        joint = event.index(self.plant)
        if event.kind == "limp":
            self._limp[joint] = self._limp_any = True
            return v
        if 6 + joint not in self._locked:
            self._locked.append(6 + joint)
        M = pin.crba(self.plant.model, self.plant.model.createData(), q)
        free = np.setdiff1d(np.arange(v.size), self._locked)
        after = np.zeros(v.size)
        after[free] = np.linalg.solve(M[np.ix_(free, free)], (M @ v)[free])
        return after

    def energy(self, q: FloatArray, v: FloatArray) -> float:
        """Kinetic energy [J]."""
        return float(pin.computeKineticEnergy(self._model, self._own, *self._with_wheels(q, v)))

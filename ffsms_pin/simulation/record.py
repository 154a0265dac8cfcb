"""The rows of a `Tracking`, as they come; what can be worked out afterwards is."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.simulation.base_actuators import BaseActuators
from ffsms_pin.simulation.client_body import ClientBody
from ffsms_pin.simulation.streaming import RowStream
from ffsms_pin.simulation.tracking import Tracking
from ffsms_pin.system import SpaceManipulator

_TOLERANCE = 1e-4  # share of what moves within the plant
_ROUNDING = 1e-12  # [kg m/s; kg m^2/s] of a plant that hardly moves


class Record:
    """States and torques of a run, row by row, in memory or in `rows` on disk.

    Momentum, energy and distance follow from a row's state, and are left for the end: in the loop they would
    cost as much as the controller. Rows that go to disk are completed at once. `target` gives the target's
    position (3,) at a time [s].
    """

    def __init__(
        self,
        plant: SpaceManipulator,
        t: FloatArray,
        target: Callable[[float], FloatArray],
        rows: RowStream | None = None,
        base: BaseActuators | None = None,
        client: ClientBody | None = None,
    ) -> None:
        self._base, self._client = base, client
        self._free = client is not None  # until it is latched
        self._plant, self._data, self._rows = plant, plant.model.createData(), rows
        self._target, self._error = target, plant.layout.difference
        self._targets: list[FloatArray] = []  # of the rows that are not complete
        self._complete = 0
        self._notes: list[str] = []
        if rows is not None and rows.set_aside is not None:
            self._notes.append(
                f"rows of an earlier run that was left unfinished are kept in {rows.set_aside}"
            )
        self._since = 0  # the first row after the last event

        def made(name: str, *shape: int) -> FloatArray:
            return np.empty(shape) if rows is None else rows.empty(name, shape)

        N, n = len(t), plant.n
        self.t = t
        self.q, self.v, self.tau = made("q", N, plant.nq), made("v", N, plant.nv), made("tau", N - 1, n)
        self.joint_error, self.joint_rate_error = made("joint_error", N, n), made("joint_rate_error", N, n)
        self.position_error, self.momentum = made("position_error", N), made("momentum", N, 6)
        self.kinetic_energy, self.work = made("kinetic_energy", N), made("work", N)
        self._others: dict[str, FloatArray] = {"impulse": made("impulse", N, 6)}
        if client is not None:
            for name, columns in (("client_pose", 7), ("client_twist", 6), ("contact_wrench", 6)):
                self._others[name] = made(name, N, columns)
        if base is not None:
            w, k = base.wheel_torque.size, base.thruster_force.size
            self._others["propellant"] = made("propellant", N)
            if w:
                self._others["wheel_momentum"] = made("wheel_momentum", N, w)
                self._others["wheel_torque"] = made("wheel_torque", N - 1, w)
            if k:
                self._others["thruster_force"] = made("thruster_force", N - 1, k)

    def happened(self, t: float, event: object, plant: SpaceManipulator) -> None:
        """Note an event, and record from the plant as it is after it."""
        self._finish_rows()
        self._since = self._complete
        self._notes.append(f"t = {t:.6g} s: {event}")
        self._plant, self._data = plant, plant.model.createData()
        self._free = self._client is not None and self._client.joined is None

    def add(
        self,
        k: int,
        q: FloatArray,
        v: FloatArray,
        wanted: tuple[FloatArray, FloatArray, FloatArray],
        work: float,
        impulse: FloatArray,
        wrench: FloatArray,
    ) -> bool:
        """Record row k, with what came from outside so far and the client's wrench; False if not finite."""
        if not q.dot(q) + v.dot(v) < np.inf:
            return False
        self.q[k], self.v[k], self.work[k] = q, v, work
        self.joint_error[k] = self._error(q, wanted[0])
        self.joint_rate_error[k] = v[6:] - wanted[1]
        if self._base is not None:
            self._others["propellant"][k] = self._base.propellant
            if self._base.wheels is not None:
                self._others["wheel_momentum"][k] = self._base.wheel_momentum
        self._others["impulse"][k] = impulse
        if self._client is not None:
            self._others["client_pose"][k] = self._client.q
            self._others["client_twist"][k] = self._client.twist
            self._others["contact_wrench"][k] = wrench
        self._targets.append(self._target(float(self.t[k])))
        if self._rows is not None:
            self._finish_rows()
            self._rows.added(k)
        return True

    def add_base(self, k: int) -> None:
        """Record what wheels and thrusters do in step k."""
        assert self._base is not None
        if self._base.wheels is not None:
            self._others["wheel_torque"][k] = self._base.wheel_torque
        if self._base.thrusters is not None:
            self._others["thruster_force"][k] = self._base.thruster_force

    def _finish_rows(self) -> None:
        """Momentum, energy and distance of the rows that came since it was last done."""
        model, data, frame = self._plant.model, self._data, self._plant.frame_id
        begin, self._complete = self._complete, self._complete + len(self._targets)
        for k, target in enumerate(self._targets, start=begin):
            self.momentum[k] = pin.computeCentroidalMomentum(model, data, self.q[k], self.v[k]).vector
            self.kinetic_energy[k] = pin.computeKineticEnergy(model, data)  # of the q and v just given
            if "wheel_momentum" in self._others:
                self._add_wheels(k)
            if self._free:
                self._add_client(k)
            x, y, z = (target - pin.updateFramePlacement(model, data, frame).translation).tolist()
            self.position_error[k] = math.hypot(x, y, z)
        self._targets.clear()

    def _add_wheels(self, k: int) -> None:
        """Add to a row what spinning wheels have beyond standing ones: h = I W each, against the base.

        Momentum a h; energy I (W + a . w)^2 / 2 less I (a . w)^2 / 2.
        """
        wheels = self._plant.wheels
        assert wheels is not None
        h = self._others["wheel_momentum"][k]
        total = wheels.total(h)
        self.momentum[k, 3:] += pin.Quaternion(self.q[k, 3:7]).toRotationMatrix() @ total
        self.kinetic_energy[k] += 0.5 * float(h @ (h / wheels.inertia)) + float(total @ self.v[k, 3:6])

    def _add_client(self, k: int) -> None:
        """Add to a row what a free client has: its momentum, about the common centre of mass, and energy."""
        assert self._client is not None
        body, R = self._client.client, pin.Quaternion(self._others["client_pose"][k, 3:]).toRotationMatrix()
        place, twist = self._others["client_pose"][k, :3], self._others["client_twist"][k]
        p, spin = body.mass * twist[:3], R @ body.inertia @ R.T @ twist[3:]
        apart, ours = place - self._data.com[0], float(self._data.mass[0])
        # About the common centre of mass: apart x the reduced mass times the relative velocity.
        reduced = (ours * p - body.mass * self.momentum[k, :3]) / (ours + body.mass)
        self.momentum[k, 3:] += spin + np.cross(apart, reduced)
        self.momentum[k, :3] += p
        self.kinetic_energy[k] += 0.5 * float(p @ twist[:3] + spin @ twist[3:])

    def check_momentum(self, rows: int) -> None:
        """Note where the total momentum was not kept since the last event, up to the row before `rows`.

        For plants on which nothing acts from outside.
        """
        self._finish_rows()
        first, last = self._since, rows - 1
        if last <= first:
            return
        energies = self.kinetic_energy[first:rows]
        if "wheel_momentum" in self._others and self._plant.wheels is not None:
            # The spin's own energy, which would hide the rest.
            spin = self._others["wheel_momentum"][first:rows]
            energies = np.abs(energies - 0.5 * (spin**2 / self._plant.wheels.inertia).sum(axis=1))
        energy = float(energies.max())
        lost = _momentum_lost(self._plant, self.q[first], self.momentum[first], self.momentum[last], energy)
        if lost:
            self._notes.append(lost)

    def tracking(self, rows: int) -> Tracking:
        """The first rows, and the steps between them; on disk they become the result's file."""
        self._finish_rows()
        tracking = Tracking(
            t=self.t[:rows],
            q=self.q[:rows],
            v=self.v[:rows],
            tau=self.tau[: max(rows - 1, 0)],
            joint_error=self.joint_error[:rows],
            joint_rate_error=self.joint_rate_error[:rows],
            position_error=self.position_error[:rows],
            momentum=self.momentum[:rows],
            kinetic_energy=self.kinetic_energy[:rows],
            work=self.work[:rows],
            note="; ".join(self._notes + (self._base.notes() if self._base is not None else [])),
            **{
                name: array[: rows if len(array) == len(self.t) else max(rows - 1, 0)]
                for name, array in self._others.items()
            },
        )
        if self._rows is not None:
            self._rows.finish(tracking.save)
        return tracking


def _momentum_lost(
    plant: SpaceManipulator, q: FloatArray, before: FloatArray, after: FloatArray, energy: float
) -> str:
    """What to say of a change of total momentum, in words; empty where it was kept.

    The change is compared with what a body of the plant's mass m and largest inertia I has at the largest
    kinetic energy E of the run: sqrt(2 m E) and sqrt(2 I E). No part of the plant has more.
    The inertia is taken at q (nq,); `before` and `after` (6,) are momenta [linear; angular] [kg m/s;
    kg m^2/s] about the centre of mass, inertial axes, and `energy` the largest in between [J].
    """
    data = plant.model.createData()
    pin.ccrba(plant.model, data, q, np.zeros(plant.nv))
    whole = data.Ig  # about the centre of mass
    sizes = (
        math.sqrt(2.0 * whole.mass * energy),
        math.sqrt(2.0 * np.linalg.eigvalsh(whole.inertia)[-1] * energy),
    )
    changes = np.linalg.norm(after[:3] - before[:3]), np.linalg.norm(after[3:] - before[3:])
    kinds = ("linear", "kg m/s"), ("angular", "kg m^2/s")
    lost = [
        f"{kind} by {change:.3g} {unit}"
        for (kind, unit), change, size in zip(kinds, changes, sizes, strict=True)
        if not change <= _TOLERANCE * size + _ROUNDING
    ]
    if not lost:
        return ""
    return (
        f"the total momentum changed though nothing acts from outside ({', '.join(lost)}): "
        "use a smaller dt, or the stiff integrator where friction is steep"
    )

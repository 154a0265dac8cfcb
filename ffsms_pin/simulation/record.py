"""The rows of a `Tracking`, as they come; what can be worked out afterwards is."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.references import Sample
from ffsms_pin.simulation.tracking import JUDGED, OPTIONAL, SHAPES, Tracking
from ffsms_pin.simulation.world import World

_TOLERANCE = 1e-4  # share of what moves within the plant
_ROUNDING = 1e-12  # [kg m/s; kg m^2/s] of a plant that hardly moves


class Record:
    """The states and torques of a run, row by row; `target` is the target's position (3,) at a time [s]."""

    def __init__(self, world: World, t: FloatArray, target: Callable[[float], FloatArray]) -> None:
        self._world, self._target, self.t = world, target, t
        self._error = world.plant.layout.difference
        self._notes: list[str] = []
        self._done = self._since = 0  # rows so far, and the first one after the last event
        n, there = world.plant.n, world.client is not None
        columns: dict[str | int, int] = {"n": n, "n+6": n + 6, "nq": world.plant.nq, 3: 3, 6: 6}
        columns |= {"c": 7 * there, "d": 6 * there, "e": 6 * there}
        columns |= {"w": world.base.wheel_torque.size, "k": world.base.thruster_force.size}
        self.arrays: dict[str, FloatArray] = {}
        for name, (count, *others) in {**SHAPES, **OPTIONAL}.items():
            if name == "t" or name in JUDGED:
                continue
            shape = (len(t) - (count == "N"), *(columns[other] for other in others))
            if 0 not in shape[1:]:
                self.arrays[name] = np.empty(shape)

    def happened(self, t: float, event: object) -> None:
        """Note an event."""
        self._since = self._done
        self._notes.append(f"t = {t:.6g} s: {event}")

    def add(
        self, k: int, q: FloatArray, v: FloatArray, wanted: Sample, work: float, wrench: FloatArray
    ) -> bool:
        """Record row k, with the client's wrench; False where the state is not finite."""
        if not q.dot(q) + v.dot(v) < np.inf:
            return False
        world = self._world
        momentum, energy, tip = world.totals(q, v)
        row: dict[str, Any] = {
            "q": q,
            "v": v,
            "joint_error": self._error(q, wanted[0]),
            "joint_rate_error": v[6:] - wanted[1],
            "end_effector": tip,
            "position_error": math.hypot(*(self._target(float(self.t[k])) - tip).tolist()),
            "momentum": momentum,
            "kinetic_energy": energy,
            "work": work,
            "impulse": world.impulse,
            "propellant": world.base.propellant,
        }
        if world.base.wheels is not None:
            row["wheel_momentum"] = world.base.wheel_momentum
        if (client := world.client) is not None:
            row |= {"client_pose": client.q, "client_twist": client.twist, "contact_wrench": wrench}
        for name, value in row.items():
            self.arrays[name][k] = value
        self._done = k + 1
        return True

    def acted(self, k: int, tau: FloatArray) -> None:
        """Record what joints, wheels and thrusters do in step k."""
        self.arrays["tau"][k], base = tau, self._world.base
        if base.wheels is not None:
            self.arrays["wheel_torque"][k] = base.wheel_torque
        if base.thrusters is not None:
            self.arrays["thruster_force"][k] = base.thruster_force

    def check_momentum(self, rows: int) -> None:
        """Note where the total momentum was not kept since the last event, up to the row before `rows`.

        Where nothing acts from outside. A change is compared with what a body of the plant's
        mass m and largest inertia I has at the largest kinetic energy E meanwhile, that of the wheels' spin
        left out: sqrt(2 m E) and sqrt(2 I E). No part of the plant has more.
        """
        first, last, plant = self._since, rows - 1, self._world.plant
        if last <= first or self._world.pushed:
            return
        energies, momenta = self.arrays["kinetic_energy"][first:rows], self.arrays["momentum"]
        if "wheel_momentum" in self.arrays and plant.wheels is not None:
            spin = self.arrays["wheel_momentum"][first:rows]
            energies = np.abs(energies - 0.5 * (spin**2 / plant.wheels.inertia).sum(axis=1))
        data = plant.model.createData()
        pin.ccrba(plant.model, data, self.arrays["q"][first], np.zeros(plant.nv))
        inertias = data.Ig.mass, np.linalg.eigvalsh(data.Ig.inertia)[-1]  # about the centre of mass
        lost = []
        for half, inertia in enumerate(inertias):
            part = slice(3 * half, 3 * half + 3)
            change = np.linalg.norm(momenta[last, part] - momenta[first, part])
            if not change <= _TOLERANCE * math.sqrt(2.0 * inertia * energies.max()) + _ROUNDING:
                lost.append(("linear by {:.3g} kg m/s", "angular by {:.3g} kg m^2/s")[half].format(change))
        if lost:
            self._notes.append(
                f"the total momentum changed though nothing acts from outside ({', '.join(lost)}): "
                "use a smaller dt, or the stiff integrator where friction is steep"
            )

    def tracking(self, rows: int, notes: Sequence[str] = ()) -> Tracking:
        """Return the first `rows` rows and the steps between them, with further notes."""
        kept: dict[str, Any] = {
            name: array[: rows if len(array) == len(self.t) else max(rows - 1, 0)]
            for name, array in self.arrays.items()
        }
        notes_of_all = [*self._notes, *self._world.notes, *self._world.base.notes(), *notes]
        return Tracking(t=self.t[:rows], note="; ".join(notes_of_all), **kept)

"""Define simple references and controllers, and inspect recordings, for tests."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.opt import SearchOptions
from ffsms_pin.simulation import Observer, Tracking

__all__ = [
    "HASTY",
    "START",
    "Constant",
    "Flying",
    "ObservedSwing",
    "Swing",
    "arrays_of",
    "note_without_goal",
    "random_pose",
]

Array: TypeAlias = NDArray[np.float64]
START = np.deg2rad([1.0, 1.0, 1.0])
HASTY = SearchOptions(time_limit=1e-9)  # returns the first plan that is found


class Swing:
    """A quintic joint motion from `start` by `displacement`, with zero end rates and end accelerations."""

    def __init__(
        self,
        sms: ffsms.SpaceManipulator,
        displacement: Any = (0.3, 0.4, -0.3),
        duration: float = 2.0,
        start: Any = START,
    ) -> None:
        self.first, self.displacement, self.duration = np.array(start), np.array(displacement), duration
        self.q = sms.configuration(start)[np.newaxis]
        self.target: Any = np.array([0.5, 0.5, 0.0])

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """Return the joint motion at t."""
        x, T = t / self.duration, self.duration
        position = self.first + self.displacement * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        rate = self.displacement * 30.0 * x**2 * (1.0 - x) ** 2 / T
        return position, rate, self.displacement * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / T**2


class ObservedSwing(Swing, Observer):
    """A swing that records the observed states of the plant."""

    def __init__(self, sms: ffsms.SpaceManipulator) -> None:
        super().__init__(sms)
        self.seen: list[Array] = []

    def observe(self, t: float, q: Array, v: Array) -> None:
        """Record the state."""
        self.seen.append(np.concatenate([q, v]))


class Constant:
    """A controller with a constant torque."""

    def __init__(self, tau: Any) -> None:
        self.tau = np.array(tau, dtype=float)

    def torque(
        self,
        q: Array,
        v: Array,
        q_d: Array,
        qd_d: Array,
        qdd_d: Array,
    ) -> Array:
        """Return the constant torque."""
        return self.tau


class Flying:
    """A Pinocchio model and data, with momentum and kinetic energy."""

    model: Any
    data: Any

    def momentum(self, q: Array, v: Array) -> Array:
        """Return the total momentum about the centre of mass, inertial axes."""
        return np.array(pin.computeCentroidalMomentum(self.model, self.data, q, v).vector)

    def energy(self, q: Array, v: Array) -> float:
        """Return the kinetic energy."""
        return float(pin.computeKineticEnergy(self.model, self.data, q, v))


def arrays_of(tracking: Tracking) -> list[str]:
    """Return the names of the fields that are arrays."""
    return [field.name for field in fields(tracking) if isinstance(getattr(tracking, field.name), np.ndarray)]


def note_without_goal(tracking: Tracking) -> str:
    """Return the note of a recording without missed goals, because most test motions have no goal."""
    verdict = f"not arrived: {'; '.join(tracking.misses)}" if tracking.misses else ""
    return tracking.note.removeprefix(verdict).removeprefix("; ")


def random_pose(rng: np.random.Generator) -> Any:
    """Return a random pose (pinocchio.SE3) that is independent of Pinocchio's global random state."""
    w, x, y, z = rng.normal(size=4)
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), rng.uniform(-1.0, 1.0, 3))

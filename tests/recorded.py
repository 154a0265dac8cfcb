"""Record motions for identification, with swinging joints on a floating base and any plant."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import simulation
from ffsms_pin.control import ComputedTorque

__all__ = ["Wave", "recording_of", "with_changed_base"]


class Wave:
    """A motion from rest to rest in which each joint swings with its own frequency."""

    def __init__(self, sms: ffsms.SpaceManipulator, duration: float = 6.0, size: float = 0.5) -> None:
        self.duration, self.size, self.n = duration, size, sms.n
        lower, upper = np.maximum(sms.limits.lower, -1.0), np.minimum(sms.limits.upper, 1.0)
        self.middle = 0.5 * (lower + upper)
        self.frequencies = 0.5 + 0.23 * np.arange(sms.n)
        self.q = sms.configuration(self.middle)[np.newaxis]
        self.target: Any = np.zeros(3)

    def sample(self, t: float) -> tuple[Any, Any, Any]:
        """Return the joint motion at t, with rates and accelerations by finite differences."""
        h = 1e-4
        before, now, after = (self._positions(t + k * h) for k in (-1.0, 0.0, 1.0))
        return now, (after - before) / (2.0 * h), (after - 2.0 * now + before) / h**2

    def _positions(self, t: float) -> Any:
        swell = np.sin(np.pi * min(max(t / self.duration, 0.0), 1.0)) ** 2
        phases = 0.7 * np.arange(self.n)
        return self.middle + self.size * swell * np.sin(self.frequencies * t + phases)


def with_changed_base(sms: ffsms.SpaceManipulator) -> ffsms.SpaceManipulator:
    """Return the robot with a base of another mass, inertia and centre of mass."""
    return simulation.perturb(sms, base_mass=0.9, base_inertia=1.12, base_com=[0.02, -0.03, 0.01])


@cache
def recording_of(
    plant: ffsms.SpaceManipulator, model: ffsms.SpaceManipulator, duration: float = 6.0, **options: Any
) -> simulation.Tracking:
    """Return the recording of a plant under a control law with another model."""
    wave = Wave(model, duration)
    law = ComputedTorque(model, adaptive=False)
    conditions = simulation.Conditions(guards=None, **options)
    return simulation.simulate(model, wave, law, dt=5e-3, plant=plant, conditions=conditions)

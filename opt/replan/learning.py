"""Masses that re-planning takes from an identifier of the user's choice."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.problem import Problem
from ffsms_pin.robot import SpaceManipulator

# Modes in which the total momentum is constant; in the second one the wheels' momenta count.
_CONSERVING = ("floating", "rotation-floating")


@runtime_checkable
class Learner(Protocol):
    """An estimator of inertial parameters that re-planning learns by, such as `identification.Identifier`."""

    def update(self, t: float, q: ArrayLike, v: ArrayLike, wheel_momentum: ArrayLike | None = None) -> None:
        """Add a measured state at t [s]."""
        ...

    def pushed(self) -> None:
        """Count the total momentum as another constant from the next state on."""
        ...

    def learnt(self, last: SpaceManipulator) -> SpaceManipulator:
        """Return the robot as estimated, or `last` itself if it is as good, or the estimate too uncertain."""
        ...


class ModelledLaw(Protocol):
    """A control law that works by a model of the robot, such as `control.ComputedTorque`."""

    sms: SpaceManipulator


class LearntReaction:
    """The estimate of a `Learner`, in the place of `ReactionEstimate`."""

    def __init__(self, learner: Learner, problem: Problem) -> None:
        if not isinstance(learner, Learner):
            text = "must be an identification.Identifier, or have its methods update, pushed and learnt"
            raise InvalidValue("learn", learner, text)
        if problem.mode not in _CONSERVING:
            text = f"must be left out in mode '{problem.mode}': thrusters change the momentum, which teaches"
            raise InvalidValue("learn", learner, text)
        self.learner, self._robot = learner, problem.sms
        self._held_by_wheels = problem.wheels is not None
        self.noisy = False

    def observe(self, t: float, q: FloatArray, v: FloatArray, wheels: FloatArray | None) -> None:
        """Add a measured state at t [s] to the learner's estimate; captured bodies are not detected."""
        if wheels is not None or not self._held_by_wheels:
            self.learner.update(t, q, v, wheels)

    def begin(self, robot: SpaceManipulator) -> None:
        """Keep what the learner has estimated: it has an estimate of the whole robot."""

    def pushed(self) -> None:
        """Begin another momentum with the next state."""
        self.learner.pushed()

    def renewed(self) -> SpaceManipulator:
        """Return the robot as it is known now, the same object as before if nothing has changed much."""
        self._robot = self.learner.learnt(self._robot)
        return self._robot

    def shown(self) -> tuple[FloatArray, FloatArray]:
        """Return no information about scale factors: the learner has its own."""
        count = self._robot.n + 1
        return np.zeros((count, count)), np.zeros(count)

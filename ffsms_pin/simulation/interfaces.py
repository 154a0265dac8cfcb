"""What a closed loop asks of its reference and its controller."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray

__all__ = ["Controller", "Reference"]


class Reference(Protocol):
    """A wanted joint motion towards a target.

    A planned `Trajectory` is one. Six more attributes are used where they exist:

    - ``q``, an array of rows (nq,): its first row is where the plant starts unless `simulate` is told.
    - ``momentum``, (6,) or None: total momentum with which the plant starts unless `simulate` is told.
    - ``base_mode``, as `opt.Problem.mode`: what of the base the motion holds. The plant starts as the motion
      does then, with what is held at rest, unless `simulate` is told otherwise. Default: "floating".
    - ``observe(t, q, v)``: called with the measured state before each control step, so that a reference can
      plan again from it.
    - ``observe_wheels(momentum)``: called before `observe` with the measured momenta (w,) of the plant's
      wheels [N m s], in a run with a `base_controller`.
    - ``expect_noise(distance)``: called before the run where sensors are noisy or late, with the standard
      deviation of the place at which the end effector is seen [m].
    """

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        ...

    @property
    def target(self) -> ArrayLike | Callable[[float], Any]:
        """End-effector position to come to (3,), or a function of time [s] that gives one (or a pose)."""
        ...

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Joint positions [rad], rates [rad/s] and accelerations [rad/s^2], each (n,), at t [s]."""
        ...


class Controller(Protocol):
    """A joint torque law."""

    def torque(
        self, q: FloatArray, v: FloatArray, q_d: FloatArray, qd_d: FloatArray, qdd_d: FloatArray
    ) -> FloatArray:
        """Joint torques (n,) [N m] for the measured q (nq,), v (6 + n,) and the wanted joint motion (n,)."""
        ...

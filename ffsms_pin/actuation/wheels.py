"""Reaction wheels of a satellite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.actuation.rows import directions, one_each
from ffsms_pin.checks import FloatArray, positive
from ffsms_pin.errors import InvalidValue

__all__ = ["ReactionWheels"]


@dataclass(frozen=True, eq=False)  # arrays have no single truth value to compare by
class ReactionWheels:
    """Wheels that are fixed to the base, each balanced and symmetric about its axis.

    Mass and inertia of the wheels are part of the base's, as if they stood still: a robot with wheels has the
    same inertia matrix, and so the same H_b and C_bm, as without.

    Parameters
    ----------
    axes : array_like, shape (w, 3)
        Spin axes in the axes of the root frame; any length but zero.
    inertia : array_like
        About the spin axis [kg m^2]; this and the rest: one number, or (w,).
    torque : array_like
        Largest size of the motor torque [N m]; infinite for none.
    momentum : array_like
        Largest size of the spin momentum [N m s], inertia times speed against the base; infinite for none.
    friction : array_like
        Viscous friction in the bearing [N m s/rad].
    coulomb : array_like
        Dry friction in the bearing [N m].
    transition : float
        Speed at which three quarters of the dry friction are there [rad/s].
    names : sequence of str, optional
        For messages; default "wheel 1", "wheel 2" and so on.

    Raises
    ------
    InvalidValue
        A wrong shape, or a number out of range.
    """

    axes: Any
    inertia: Any
    torque: Any = np.inf
    momentum: Any = np.inf
    friction: Any = 0.0
    coulomb: Any = 0.0
    transition: float = 1.0
    names: Any = None

    def __post_init__(self) -> None:
        self._set("axes", directions("wheels.axes", self.axes))
        w = len(self.axes)
        self._set("inertia", one_each("wheels.inertia", self.inertia, w, "kg m^2"))
        self._set("torque", one_each("wheels.torque", self.torque, w, "N m", infinite=True))
        self._set("momentum", one_each("wheels.momentum", self.momentum, w, "N m s", infinite=True))
        self._set("friction", one_each("wheels.friction", self.friction, w, "N m s/rad", zero=True))
        self._set("coulomb", one_each("wheels.coulomb", self.coulomb, w, "N m", zero=True))
        self._set("transition", positive("wheels.transition", self.transition, "rad/s"))
        self._set("names", _names(self.names, w))

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def __len__(self) -> int:
        """Number of wheels w."""
        return len(self.axes)

    @property
    def spin_inertia(self) -> FloatArray:
        """Sum of I a a^T (3, 3) [kg m^2], root axes: what the base lacks where the wheels turn freely."""
        tensor: FloatArray = (self.axes.T * self.inertia) @ self.axes
        return tensor

    @property
    def rubs(self) -> bool:
        """Whether there is friction."""
        return bool(self.friction.any() or self.coulomb.any())

    def friction_torque(self, speed: FloatArray) -> FloatArray:
        """Torque of the friction on the wheels (w,) [N m] at speeds (w,) [rad/s] against the base."""
        dry: FloatArray = self.coulomb * np.tanh(speed / self.transition)
        torque: FloatArray = -(self.friction * speed + dry)
        return torque

    def total(self, momentum: FloatArray) -> FloatArray:
        """Sum of the wheels' momenta, (w,) or (N, w), as a vector (3,) or (N, 3) [N m s], root axes."""
        vector: FloatArray = momentum @ self.axes
        return vector

    def __repr__(self) -> str:
        return f"ReactionWheels({len(self)} of {np.array2string(self.momentum, precision=4)} N m s)"


def _names(given: Any, count: int) -> tuple[str, ...]:
    if given is None:
        return tuple(f"wheel {i}" for i in range(1, count + 1))
    names = tuple(given) if isinstance(given, Sequence) and not isinstance(given, str) else ()
    if len(names) != count or not all(isinstance(name, str) for name in names):
        raise InvalidValue("wheels.names", given, f"must be {count} texts")
    return names

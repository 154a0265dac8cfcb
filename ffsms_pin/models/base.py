"""The satellite that an arm is mounted on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray, positive, vector
from ffsms_pin.errors import InvalidValue

__all__ = ["SatelliteBase"]


@dataclass(frozen=True)
class SatelliteBase:
    """A satellite's body: a box whose centre is the origin of the base frame.

    Parameters
    ----------
    mass : float
        [kg], panels included. Default 200 kg.
    size : array_like, shape (3,)
        Length, width and height of the box along x, y and z [m]. Default a cube of 1 m.
    inertia : array_like, shape (3, 3) or (3,), optional
        About the centre of mass, base axes [kg m^2]; three numbers are the principal ones along x, y, z.
        Default: a solid box of that mass and size.
    com : array_like, shape (3,)
        Centre of mass in the base frame [m]. Default: the box's centre.
    panels : array_like, shape (2,), optional
        Span and chord [m] of two solar panels along +y and -y. They are drawn only: they are in no collision
        model, and their mass belongs into `mass` and `inertia`. Default: no panels.

    Raises
    ------
    InvalidValue
        A value that no rigid body has.
    """

    mass: float = 200.0
    size: Any = (1.0, 1.0, 1.0)
    inertia: Any = None
    com: Any = (0.0, 0.0, 0.0)
    panels: Any = None

    def __post_init__(self) -> None:
        # Kept as plain numbers, so that equal bases compare equal and nobody's array is shared.
        self._set("mass", positive("mass", self.mass, "kg"))
        self._set("size", _positives("size", self.size, 3))
        self._set("com", tuple(float(x) for x in vector("com", self.com, 3, "m")))
        if self.panels is not None:
            self._set("panels", _positives("panels", self.panels, 2))
        if self.inertia is not None:
            tensor = checks.inertia("inertia", self.inertia)
            self._set("inertia", tuple(tuple(float(x) for x in row) for row in tensor))

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    @property
    def inertia_matrix(self) -> FloatArray:
        """Inertia about the centre of mass, base axes [kg m^2], shape (3, 3)."""
        if self.inertia is not None:
            return np.array(self.inertia)
        x, y, z = (edge**2 for edge in self.size)
        return self.mass / 12.0 * np.diag([y + z, x + z, x + y])


def _positives(name: str, value: ArrayLike, count: int) -> tuple[float, ...]:
    numbers = tuple(float(x) for x in vector(name, value, count, "m"))
    if min(numbers) <= 0.0:
        raise InvalidValue(name, value, "must be above zero [m]")
    return numbers

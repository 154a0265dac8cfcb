"""The thrusters of a satellite, and the allocation of a desired force and moment to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ffsms_pin.actuation.wheels import directions, rows
from ffsms_pin.checks import FloatArray, at_least_zero, frozen, instance, one_each, positive, set_frozen
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import NotNegative, PerJointPositive, Positive, Rows, Unit

STANDARD_GRAVITY = 9.80665  # [m/s^2] ratio of exhaust velocity to specific impulse in seconds
_PULSES = 10.0  # default period as a multiple of the least on-time


@dataclass(frozen=True, eq=False)
class Thrusters:
    """A set of thrusters that are fixed to the base.

    Raises
    ------
    InvalidValue
        If an array has a wrong shape, or a number is out of range.
    """

    places: Annotated[Rows, Unit("m")]
    """The points (k, 3) at which the forces act, root frame."""
    directions: Annotated[Rows, Unit()]
    """The directions (k, 3) of the forces on the satellite (opposite to the jets), root axes; vectors of any
    length above zero."""
    force: Annotated[PerJointPositive, Unit("N")]
    """The largest force; one number, or one per thruster."""
    least_on_time: Annotated[NotNegative, Unit("s")] = 0.0
    """The shortest pulse of thrusters that are either on or off."""
    proportional: Annotated[bool, Unit()] = False
    """True if the thrusters can exert any force up to the largest. If not, pulses with the same mean force
    are used (`ffsms_pin.control.PulseWidth`), and `least_on_time` or `period` must be given."""
    specific_impulse: Annotated[Positive, Unit("s")] = 220.0
    """The specific impulse; the default is typical of hydrazine."""
    period: Annotated[Positive | None, Unit("s", "10 least_on_time")] = None
    """The period of the pulses."""

    def __post_init__(self) -> None:
        set_frozen(self, places=rows("thrusters.places", self.places))
        k = len(self.places)
        set_frozen(self, directions=directions("thrusters.directions", self.directions, k))
        set_frozen(self, force=one_each("thrusters.force", self.force, k, "N"))
        set_frozen(self, least_on_time=at_least_zero("thrusters.least_on_time", self.least_on_time, "s"))
        instance("thrusters.proportional", self.proportional, bool)
        set_frozen(self, specific_impulse=positive("thrusters.specific_impulse", self.specific_impulse, "s"))
        period, default = self.period, _PULSES * self.least_on_time
        period = default if period is None else positive("thrusters.period", period, "s")
        if not self.proportional and period <= self.least_on_time:
            message = f"must exceed least_on_time, {self.least_on_time:g} s"
            if self.period is None:  # then least_on_time is zero
                message = "must be given, or least_on_time above zero, unless proportional is true"
            raise InvalidValue("thrusters.period", self.period, message)
        set_frozen(self, period=period if self.proportional else positive("thrusters.period", period, "s"))

    def __len__(self) -> int:
        """Return the number of thrusters k."""
        return len(self.places)

    @property
    def wrenches(self) -> FloatArray:
        """The wrenches (6, k) [force; moment about the root] per unit force of each thruster, root axes."""
        moments = np.cross(self.places, self.directions)
        return frozen(np.concatenate([self.directions, moments], axis=1).T)

    def flow(self, force: FloatArray) -> float:
        """Return the propellant mass flow [kg/s] at thruster forces (k,) [N]."""
        return float(force.sum()) / (self.specific_impulse * STANDARD_GRAVITY)

    def __repr__(self) -> str:
        return f"Thrusters({len(self)} of {np.array2string(self.force, precision=4)} N)"


class ThrusterAllocation:
    """A map from a desired force and moment about a point to non-negative thruster forces.

    The point is `centre` (3,) [m], root frame. The allocation is by non-negative least squares: C. L. Lawson,
    R. J. Hanson, "Solving least squares problems", Prentice-Hall 1974, chapter 23. To make them comparable
    with moments, forces are multiplied by the mean distance of the thrusters from the centre. If a thruster
    would exceed its largest force, all forces are scaled by the same factor, which keeps the direction of the
    wrench.
    """

    def __init__(self, thrusters: Thrusters, centre: FloatArray) -> None:
        arms = thrusters.places - centre
        self._largest = thrusters.force
        self._length = float(np.linalg.norm(arms, axis=1).mean()) or 1.0
        forces = thrusters.directions.T * self._length
        self._effect = np.concatenate([forces, np.cross(arms, thrusters.directions).T])

    @property
    def shares(self) -> FloatArray:
        """The thruster forces (k, 6) per unit of [force; moment], by the pseudo-inverse.

        They may be negative. In an opposed pair of thrusters, each is half of the force that a single
        thruster must exert.
        """
        scale = np.repeat([self._length, 1.0], 3)
        shares: FloatArray = np.linalg.pinv(self._effect) * scale
        return shares

    def forces(self, force: FloatArray, moment: FloatArray) -> FloatArray:
        """Return thruster forces (k,) [N] for a force (3,) [N] and a moment (3,) [N m], root axes.

        The thruster forces are NaN if the force or the moment is not finite.
        """
        from scipy.optimize import nnls  # slow to load, and not needed for wheels

        wrench = np.concatenate([force * self._length, moment])
        if not np.isfinite(wrench).all():
            return np.full(len(self._largest), np.nan)
        shares, _ = nnls(self._effect, wrench)
        result: FloatArray = shares / max(1.0, float((shares / self._largest).max()))
        return result

    def moment(self, forces: FloatArray) -> FloatArray:
        """Return the moment (3,) [N m] of thruster forces (k,) [N] about the centre, root axes."""
        result: FloatArray = (self._effect @ forces)[3:]
        return result

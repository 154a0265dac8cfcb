"""A configuration and a velocity that do not change, and what every quantity of a state is made of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, writeable
from ffsms_pin.system.once import once

if TYPE_CHECKING:
    from ffsms_pin.system.manipulator import SpaceManipulator

__all__ = ["Snapshot"]


class Snapshot:
    """One (q, v), and the two changes of velocity that the rest is made with.

    A product of small matrices takes as long as a slice or a call, so what falls out of one product is made
    and kept together: an entry of `__dict__` is found before the method of its name. A view of a read-only
    array is read-only too. What begins with an underscore is not handed out.

    Where Pinocchio sums over positions it is given `q * sms._all_but_position`, the root at the origin: its
    sums about the origin lose digits as the square of the distance, and only positions depend on where the
    root is.
    """

    q: FloatArray
    v: FloatArray

    def __init__(self, sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> None:
        writeable(q, False)
        writeable(v, False)
        own = self.__dict__
        own["_sms"], own["q"], own["v"] = sms, q, v

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(
            f"a state cannot be changed (tried to set '{name}'); ask for a new one with at(q, v)"
        )

    def __delattr__(self, name: str) -> NoReturn:
        raise AttributeError(f"a state cannot be changed (tried to delete '{name}')")

    def __reduce__(self) -> tuple[Any, ...]:
        # q and v say it all; a copy computes again what it is asked for.
        return type(self), (self.__dict__["_sms"], np.array(self.q), np.array(self.v))

    def _beside(self, first: str, name: str) -> FloatArray:
        """What is kept when `first` is made."""
        getattr(self, first)
        value: FloatArray = self.__dict__[name]
        return value

    @once
    def _N(self) -> FloatArray:
        """[-M_b^-1 M_bm; I] (6 + n, n): Pinocchio's velocity a joint rate, at zero momentum."""
        own = self.__dict__
        sms = own["_sms"]
        work = sms._workspace
        own["_M"] = pin.crba(sms.model, work.data, own["q"])  # Pinocchio gives a copy
        N: FloatArray = sms._joints_alone.copy()
        # M_b is the inertia of the whole, seen from the root. Its inverse takes no more than that of a 3x3
        # matrix about the centre of mass. A product takes numpy less time than slices of the same columns.
        work.whole.inverse().dot(work.base_rows.dot(sms._less_joints), N[:6])
        return N

    @once
    def _M(self) -> FloatArray:
        """Pinocchio's inertia matrix (6 + n, 6 + n)."""
        return self._beside("_N", "_M")

    @once
    def _A(self) -> Any:
        """The transformation whose action makes Pinocchio's base velocity of a base twist: `kinetics`."""
        own = self.__dict__
        A = pin.XYZQUATToSE3(own["q"][:7]).inverse()
        A.translation = own["_sms"].base_com
        return A

    @once
    def _T(self) -> FloatArray:
        """The change of [base twist; joint rates] to Pinocchio's velocity (6 + n, 6 + n)."""
        T: FloatArray = self.__dict__["_sms"]._identity.copy()
        T[:6, :6] = self._A.action
        return T

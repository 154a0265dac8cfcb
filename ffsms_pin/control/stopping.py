"""A law that brings all joints to rest and takes energy out of the motion whatever the masses are."""

from __future__ import annotations

import daqp
import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray, instance, one_each, positive
from ffsms_pin.system import SpaceManipulator, dynamics
from ffsms_pin.system.base_reaction import floating_motion

_TIME = 0.5  # [s]
_RESERVE = 1e-3  # [rad or m] from a stop that is kept in hand
STEPS = 4.0  # control steps that the fastest braking takes


class StoppingLaw:
    """A joint torque law that brakes all joints within their torques.

    Without limits the torque is tau* = -k H_q qd: with the reduced inertia matrix H_q all joints slow down
    alike, as qdd = -k qd. With limits it is the torque within them that is nearest to tau* in the metric of
    H_q^-1, the kinetic energy of the change of velocity. The rate k is 1 / `time`, and more if a joint would
    run into its stop, up to a quarter of a step's.

    Proof that it takes energy out: the torques within the limits are a convex set that has zero in it, so
    the nearest one to tau* obeys tau^T H_q^-1 (tau* - tau) >= 0. With tau* = -k H_q qd this is
    qd^T tau <= -tau^T H_q^-1 tau / k <= 0. It needs no other property of H_q than that it is positive
    definite: masses that are wrong change how fast the joints slow down, and not the sign.

    Parameters
    ----------
    sms : SpaceManipulator
    dt : float
        Control step [s].
    torque_limit : array_like
        Largest size of each torque [N m], one number or (n,), infinite for none.
    time : float
        Time constant of braking [s].
    """

    def __init__(
        self, sms: SpaceManipulator, dt: float, torque_limit: object = np.inf, time: float = _TIME
    ) -> None:
        instance("sms", sms, SpaceManipulator)
        self.sms = sms
        self.torque_limit = one_each("torque_limit", torque_limit, sms.n, "N m", largest=np.inf)
        self._slowest, self._fastest = (
            1.0 / positive("time", time, "s"),
            1.0 / (STEPS * positive("dt", dt, "s")),
        )

    def torque(self, q: FloatArray, v: FloatArray, limp: NDArray[np.bool_] | None = None) -> FloatArray:
        """Return the joint torques (n,) [N m] at a measured state; those of `limp` joints (n,) are zero."""
        rates, M = v[6:], dynamics.inertia_matrix(self.sms, q)
        H = M[6:] @ floating_motion(M)
        braked = rates if limp is None else np.where(limp, 0.0, rates)
        wanted = -self._rate(q, braked) * (H @ rates)
        most = self.torque_limit if limp is None else np.where(limp, 0.0, self.torque_limit)
        if not np.isfinite(wanted).all() or (np.abs(wanted) <= most).all():
            return wanted
        return _nearest(H, wanted, most)

    def _rate(self, q: FloatArray, rates: FloatArray) -> float:
        """Return k [1/s]: 1 / `time`, or what keeps every joint from its stop if that is more."""
        limits, joints = self.sms.limits, self.sms.layout.positions(q)
        room = np.where(rates > 0.0, limits.upper - joints, joints - limits.lower)
        needed = np.abs(rates) / np.maximum(room - _RESERVE, 1e-6)
        slowest = min(self._slowest, self._fastest)
        return float(np.clip(needed.max(initial=0.0), slowest, self._fastest))


def _nearest(H: FloatArray, wanted: FloatArray, most: FloatArray) -> FloatArray:
    """Return the torques within +-most (n,) that are nearest to wanted ones in the metric of H^-1."""
    bound = np.flatnonzero(np.isfinite(most))
    scaled = wanted * np.min(most / np.maximum(np.abs(wanted), 1e-300), initial=1.0)  # within, and no more
    try:
        L = np.linalg.cholesky(H)
    except np.linalg.LinAlgError:
        return scaled
    size = float(np.linalg.norm(np.linalg.solve(L, wanted)))
    # With tau = wanted + size L z, z is to be least; every row is in shares of what its joint has.
    unit = np.maximum(most[bound], 1e-9 * np.abs(wanted).max())
    rows, at, room = size * L[bound] / unit[:, None], wanted[bound] / unit, most[bound] / unit
    sense = np.where(room > 0.0, 0, 5).astype(np.int32)  # 5: an equation
    z, _, status, _ = daqp.solve(None, np.zeros(len(L)), rows, room - at, -room - at, sense)
    if status != 1 or not np.isfinite(z).all():
        return scaled
    return np.asarray(np.clip(wanted + size * (L @ z), -most, most))

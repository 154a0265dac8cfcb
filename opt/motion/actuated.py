"""Features of what acts: torques of joints; momenta and torques of wheels, the wrench of thrusters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.thrusters import held_wrench, wrench_slopes
from ffsms_pin.opt.motion.torques import torque_slopes
from ffsms_pin.opt.motion.wheels import (
    TorqueSlopes,
    friction_slope,
    momentum_slopes_by_joints,
    wheel_momentum,
    wheel_shares,
    wheel_torque,
)

if TYPE_CHECKING:
    from ffsms_pin.opt.motion.features import Features

__all__ = ["joint_torques", "wheel_momenta", "wheel_torques", "wrench"]


def joint_torques(m: Features) -> Feature:
    """Of the joints (n, S, K) [N m, or N], the base reacting."""
    at = m.motions

    def slopes() -> dict[str, FloatArray]:
        moving = (at.joints, at.rates, at.accelerations, at.own_spin)
        by = torque_slopes(at.stack, *(x.reshape(len(x), -1) for x in moving))._asdict()
        return {name: x.reshape(*x.shape[:2], *at.rates.shape[1:]) for name, x in by.items()}

    return m.feature(at.torques, slopes)


def wheel_momenta(m: Features) -> Feature:
    """Of the wheels that hold the attitude (w, S, K) [N m s]."""
    at, wheels = m.motions, m.motions.wheels

    def slopes() -> dict[str, FloatArray]:
        if wheels is None:
            return {}
        by_joints, by_rates = momentum_slopes_by_joints(at)
        return _shared(-wheel_shares(wheels), {"by_joints": by_joints, "by_rates": by_rates})

    return m.feature(wheel_momentum(at), slopes)


def wheel_torques(m: Features) -> Feature:
    """Motor torques of these wheels (w, S, K) [N m], friction made good.

    Slopes take a call of Pinocchio an instant: `Features.weighted` and `Features.at` spare some.
    """
    at, wheels, momenta = m.motions, m.motions.wheels, m.wheels

    def slopes() -> dict[str, FloatArray]:
        if wheels is None:
            return {}
        moving = (at.joints, at.rates, at.accelerations)
        by = TorqueSlopes(at.stack.robot).at(*(x.reshape(len(x), -1) for x in moving))
        names = ("by_joints", "by_rates", "by_accelerations")
        full = {name: x.reshape(*x.shape[:2], *at.rates.shape[1:]) for name, x in zip(names, by, strict=True)}
        found = _shared(-wheel_shares(wheels), full)
        if wheels.rubs:
            rubbing = friction_slope(wheels, momenta.value)
            for name, slope in momenta.slopes.items():
                found[name] = found[name] + rubbing[:, None] * slope
        return found

    return m.feature(wheel_torque(at, momenta.value), slopes)


def wrench(m: Features) -> Feature:
    """Force and moment about the base's centre of mass that hold the base (6, S, K) [N, N m], base axes."""
    at = m.motions
    moving = (at.joints, at.rates, at.accelerations)
    value = held_wrench(at.stack, at.stack.evaluate(at.joints), *moving[1:])

    def slopes() -> dict[str, FloatArray]:
        by = wrench_slopes(at.stack, *(x.reshape(len(x), -1) for x in moving))._asdict()
        return {name: x.reshape(*x.shape[:2], *at.rates.shape[1:]) for name, x in by.items()}

    return m.feature(value, slopes)


def _shared(shares: FloatArray, slopes: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Slopes of what each wheel takes of a vector with these slopes (3, n, S, K)."""
    return {name: np.einsum("wx,xj...->wj...", shares, slope) for name, slope in slopes.items()}

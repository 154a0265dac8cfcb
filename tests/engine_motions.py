"""Simulate 10 s under the same torques in several engines, for tests and the page docs/agreement.md."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco as mj
import numpy as np
from engines import Array, Mujoco
from scripts import load_script

import ffsms_pin as ffsms
from ffsms_pin.simulation.integrators import rk4_step

__all__ = ["DURATION", "Push", "basilisk_end", "mujoco_end", "our_end", "push", "rate_difference"]

DURATION = 10.0  # [s]
State = tuple[Array, Array]


class Push(NamedTuple):
    """A start at rest, and joint torques [N m] as a function of time [s], constant within each step."""

    q: Array
    v: Array
    torque: Callable[[float], Array]


def push(sms: ffsms.SpaceManipulator) -> Push:
    """Return sinusoidal torques of different phases that accelerate each joint by about 0.02 rad/s^2."""
    rng = np.random.default_rng(8)
    q = sms.configuration(rng.uniform(-0.3, 0.3, sms.n))
    scale, phase = 0.02 * np.diag(sms.at(q).H_q), rng.uniform(0.0, 6.0, sms.n)
    return Push(q, sms.velocity(q, np.zeros(sms.n)), lambda t: np.asarray(scale * np.sin(t + phase)))


def our_end(sms: ffsms.SpaceManipulator, motion: Push, dt: float) -> State:
    """Return the final q and v, by Pinocchio's ABA and a Runge-Kutta method of order 4 on the manifold."""
    q, v, data, force = motion.q, motion.v, sms.model.createData(), np.zeros(sms.nv)
    for k in range(round(DURATION / dt)):
        force[6:] = motion.torque(k * dt)
        q, v, _ = rk4_step(sms.model, data, q, v, force, dt)
    return q, v


def mujoco_end(sms: ffsms.SpaceManipulator, motion: Push, dt: float) -> State:
    """Return the final q and v by MuJoCo's Runge-Kutta method."""
    peer = Mujoco(sms, dt)
    peer.set(motion.q, motion.v)
    for k in range(round(DURATION / dt)):
        peer.data.ctrl[:] = motion.torque(k * dt)
        mj.mj_step(peer.model, peer.data)
    return peer.state()


def basilisk_end(sms: ffsms.SpaceManipulator, motion: Push, dt: float) -> State:
    """Return the final q and v by Basilisk, with a hub, spinning bodies and its Runge-Kutta method."""
    basilisk = load_script("examples/basilisk_robot.py")
    craft, arms = basilisk.to_basilisk(sms, motion.q, motion.v)
    control = basilisk.ArmControl(sms, craft, arms, lambda t, q, v: motion.torque(t))
    basilisk.run_until(basilisk.started(dt, [*(arm for _, arm in arms), craft, control]), DURATION)
    return control.q, control.v


def rate_difference(first: State, second: State) -> float:
    """Return the norm of the difference of joint rates, relative to the norm of the first."""
    return float(np.linalg.norm(first[1][6:] - second[1][6:]) / np.linalg.norm(first[1][6:]))

"""Wheels and hinged bodies against Basilisk: another formulation, written by others, same torques."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from basilisk_robot import basilisk_run
from motions import Array, Constant

import ffsms_pin as ffsms
from ffsms_pin.control import BaseCommand, BaseView


class Motors:
    """Constant torques of the wheels."""

    def __init__(self, torques: Any) -> None:
        self.torques = np.array(torques)

    def command(self, view: BaseView) -> BaseCommand:
        """The same in every step."""
        return BaseCommand(self.torques)


class Rest:
    """A reference that nobody follows."""

    def __init__(self, q: Array, n: int, duration: float) -> None:
        self.q, self.duration, self.target = q[None], duration, np.zeros(3)
        self._sample = np.zeros(n), np.zeros(n), np.zeros(n)

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """Zeros."""
        return self._sample


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_base_joint_and_wheel_rates_agree_with_basilisk(name: str, rng: np.random.Generator) -> None:
    sms, T, dt = ffsms.load(name), 10.0, 2e-3
    axes, n = rng.normal(size=(4, 3)), sms.n
    heavy = name != "planar_3r"
    wheels = ffsms.ReactionWheels(axes, 0.02 if heavy else 1.4e-3)
    sms = sms.with_actuators(wheels=wheels)
    middle = np.zeros(n) if not heavy else 0.5 * (sms.limits.lower + sms.limits.upper)
    turned = pin.SE3(pin.Quaternion(np.array([0.1, -0.2, 0.3, 0.9])).normalized(), np.array([0.3, -1.0, 2.0]))
    q = sms.configuration(middle + 0.3 * rng.uniform(-1.0, 1.0, n), turned)
    v = np.concatenate([rng.uniform(-0.02, 0.02, 3), rng.uniform(-0.05, 0.05, 3), rng.uniform(-0.1, 0.1, n)])
    speeds = rng.uniform(-300.0, 300.0, 4)
    tau = rng.uniform(-1.0, 1.0, n) * (0.02 if heavy else 0.002)
    motor = rng.uniform(-0.1, 0.1, 4) * (1.0 if heavy else 0.1)
    ours = ffsms.simulate(
        sms,
        Rest(q, n, T),
        Constant(tau),
        dt,
        v0=v,
        base_controller=Motors(motor),
        wheel_momentum=wheels.inertia * speeds,
    )
    theirs = basilisk_run(sms, q, v, speeds, tau, motor, dt, T)
    turn = pin.Quaternion(ours.q[-1, 3:7]).toRotationMatrix()
    pairs = {
        "velocity": (turn @ ours.v[-1, :3], theirs.velocity),
        "spin": (ours.v[-1, 3:6], theirs.spin),
        "angles": (ours.q[-1, 7:], theirs.angles),
        "rates": (ours.v[-1, 6:], theirs.rates),
        "speeds": (ours.wheel_momentum[-1] / wheels.inertia, theirs.speeds),
    }
    for what, (mine, other) in pairs.items():
        assert np.linalg.norm(mine - other) < 1e-9 * np.linalg.norm(other), what
    # It was a real motion: everything changed by far more than that.
    assert np.linalg.norm(ours.v[-1, 3:6] - v[3:6]) > 1e-2
    assert np.abs(ours.v[-1, 6:] - v[6:]).min() > 1e-3

"""Wheels and hinged bodies compared with Basilisk, an independent formulation, under equal torques."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from Basilisk.architecture import messaging
from Basilisk.simulation import reactionWheelStateEffector
from Basilisk.utilities import SimulationBaseClass, macros
from motions import Array, Constant
from scripts import load_script

import ffsms_pin as ffsms
from ffsms_pin.control import BaseCommand, BaseView
from ffsms_pin.simulation import JointFriction


class Motors:
    """A base law with constant wheel torques."""

    def __init__(self, torques: Any) -> None:
        self.torques = np.array(torques)

    def command(self, view: BaseView) -> BaseCommand:
        """Return the same command in every step."""
        return BaseCommand(self.torques)


class Rest:
    """A reference that the joint law ignores."""

    def __init__(self, q: Array, n: int, duration: float) -> None:
        self.q, self.duration, self.target = q[None], duration, np.zeros(3)
        self._sample = np.zeros(n), np.zeros(n), np.zeros(n)

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """Return zeros."""
        return self._sample


class End(NamedTuple):
    """The state at the end of a run."""

    velocity: Array  # of the root's origin (3,), inertial axes [m/s]
    spin: Array  # of the base (3,), root axes [rad/s]
    angles: Array  # of the joints (n,) [rad]
    rates: Array  # of the joints (n,) [rad/s]
    speeds: Array  # of the wheels (w,) [rad/s]


def basilisk_run(
    sms: ffsms.SpaceManipulator,
    q: Array,
    v: Array,
    speeds: Array,
    tau: Array,
    motor: Array,
    dt: float,
    T: float,
) -> End:
    """Integrate in Basilisk a serial arm on a base with wheels by its own Runge-Kutta method of order 4.

    `tau` (n,) and `motor` (w,) [N m] are held for the time T [s]; `speeds` (w,) [rad/s] start the wheels.
    """
    sim = SimulationBaseClass.SimBaseClass()
    sim.CreateNewProcess("dynamics").addTask(sim.CreateNewTask("task", macros.sec2nano(dt)))
    craft, ((_, arm),) = load_script("examples/basilisk_robot.py").to_basilisk(sms, q, v)
    torques = messaging.ArrayMotorTorqueMsg().write(_torques(tau))
    arm.motorTorqueInMsg.subscribeTo(torques)

    wheels = reactionWheelStateEffector.ReactionWheelStateEffector()
    assert sms.wheels is not None
    for axis, inertia, speed in zip(sms.wheels.axes, sms.wheels.inertia, speeds, strict=True):
        wheel = reactionWheelStateEffector.RWConfigPayload()
        x = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        x /= np.linalg.norm(x)
        wheel.gsHat_B, wheel.w2Hat0_B, wheel.w3Hat0_B = _column(axis), _column(x), _column(np.cross(axis, x))
        wheel.rWB_B = _column([0.0, 0.0, 0.0])
        wheel.RWModel = reactionWheelStateEffector.BalancedWheels
        wheel.mass, wheel.Js, wheel.Jt, wheel.Jg = 1.0, float(inertia), 0.5 * inertia, 0.5 * inertia
        wheel.Omega, wheel.u_max, wheel.Omega_max, wheel.P_max = float(speed), -1.0, -1.0, -1.0
        wheels.addReactionWheel(wheel)
    motors = messaging.ArrayMotorTorqueMsg().write(_torques(motor))
    wheels.rwMotorCmdInMsg.subscribeTo(motors)

    craft.addStateEffector(wheels)
    for model in (arm, wheels, craft):
        sim.AddModelToTask("task", model)
    end = craft.scStateOutMsg.recorder(macros.sec2nano(T))
    joints = [message.recorder(macros.sec2nano(T)) for message in arm.spinningBodyOutMsgs]
    turning = wheels.rwSpeedOutMsg.recorder(macros.sec2nano(T))
    for recorder in (end, *joints, turning):
        sim.AddModelToTask("task", recorder)
    sim.InitializeSimulation()
    sim.ConfigureStopTime(macros.sec2nano(T))
    sim.ExecuteSimulation()
    return End(
        end.v_BN_N[-1],
        end.omega_BN_B[-1],
        np.array([joint.theta[-1] for joint in joints]),
        np.array([joint.thetaDot[-1] for joint in joints]),
        turning.wheelSpeeds[-1][: len(speeds)],
    )


def _column(vector: Any) -> list[list[float]]:
    return [[float(x)] for x in vector]


def _torques(values: Array) -> Any:
    payload = messaging.ArrayMotorTorqueMsgPayload()
    payload.motorTorque = [float(x) for x in values]
    return payload


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
        base_controller=Motors(motor),
        conditions=ffsms.Conditions(
            v0=v, wheel_momentum=wheels.inertia * speeds, guards=None, friction=JointFriction()
        ),
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
    for quantity, (own, peer) in pairs.items():
        assert np.linalg.norm(own - peer) < 1e-9 * np.linalg.norm(peer), quantity
    # The motion is not trivial: all quantities change by far more than the tolerance.
    assert np.linalg.norm(ours.v[-1, 3:6] - v[3:6]) > 1e-2
    assert np.abs(ours.v[-1, 6:] - v[6:]).min() > 1e-3

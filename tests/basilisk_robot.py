"""A robot with wheels in Basilisk: our robot there, and balanced wheels; constant torques."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import ffsms_pin as ffsms

__all__ = ["End", "basilisk_run"]

Array = NDArray[np.float64]


class End(NamedTuple):
    """State at the end of a run."""

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
    """Let Basilisk integrate a serial arm on a base with wheels by its own Runge-Kutta method of order 4.

    `tau` (n,) and `motor` (w,) [N m] are held for the whole time T [s]; `speeds` (w,) are the wheels'.
    """
    from Basilisk.architecture import messaging
    from Basilisk.simulation import reactionWheelStateEffector
    from Basilisk.utilities import SimulationBaseClass, macros

    from ffsms_pin.interchange.basilisk import to_basilisk

    sim = SimulationBaseClass.SimBaseClass()
    sim.CreateNewProcess("dynamics").addTask(sim.CreateNewTask("task", macros.sec2nano(dt)))
    robot = to_basilisk(sms, q, v)
    craft, (arm,) = robot.craft, robot.arms
    torques = messaging.ArrayMotorTorqueMsg().write(_torques(messaging, tau))
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
    motors = messaging.ArrayMotorTorqueMsg().write(_torques(messaging, motor))
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


def _torques(messaging: Any, values: Array) -> Any:
    payload = messaging.ArrayMotorTorqueMsgPayload()
    payload.motorTorque = [float(x) for x in values]
    return payload

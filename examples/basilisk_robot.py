"""Simulate a plan by Basilisk and by `simulate`, and compare the motions. Needs Basilisk: pip install bsk.

The base is a spacecraft's hub, each arm a chain of spinning bodies, and the control law a Basilisk module.
Copy `to_basilisk` and `ArmControl` into scripts of your own; basilisk_orbit.py uses them in an orbit round
the Earth. `to_basilisk` supports neither prismatic joints nor branching arms, and omits joint limits and
wheels; add Basilisk's own reaction wheels.
"""

import numpy as np
import pinocchio as pin
from Basilisk.architecture import messaging, sysModel
from Basilisk.simulation import spacecraft, spinningBodyNDOFStateEffector
from Basilisk.utilities import RigidBodyKinematics, SimulationBaseClass, macros

import ffsms_pin as ffsms
from ffsms_pin import opt


def column(vector):
    """Return a vector in Basilisk's form [[x], [y], [z]]."""
    return np.reshape(vector, (3, 1)).tolist()


def to_basilisk(sms, q, v, position=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)):
    """Return the spacecraft, and its arms as pairs (indices of joints, effector).

    The origin to which q and v refer has this position [m] and velocity [m/s] in Basilisk's inertial frame.
    """
    model, data, base = sms.model, sms.model.createData(), sms.model.inertias[1]
    if not sms.layout.turns.all() or any(len(model.children[j]) > 1 for j in range(2, model.njoints)):
        raise ValueError("a joint is prismatic or an arm branches; use chains of revolute joints")
    pin.computeJointJacobians(model, data, q)
    pin.centerOfMass(model, data, q, v)
    craft = spacecraft.Spacecraft()
    craft.hub.mHub, craft.hub.IHubPntBc_B = base.mass, base.inertia.tolist()
    craft.hub.r_BcB_B = column(base.lever)
    craft.hub.r_CN_NInit = column(position + data.com[0])
    craft.hub.v_CN_NInit = column(velocity + data.vcom[0])
    craft.hub.sigma_BNInit = column(RigidBodyKinematics.C2MRP(data.oMi[1].rotation.T))
    craft.hub.omega_BN_BInit = column(v[3:6])
    arms, angles = [], sms.joint_positions(q)
    for first in model.children[1]:
        arm = spinningBodyNDOFStateEffector.SpinningBodyNDOFStateEffector()
        arm.ModelTag = model.names[first]
        arm.setNameOfThetaState(f"{arm.ModelTag}_theta")  # states are registered by name
        arm.setNameOfThetaDotState(f"{arm.ModelTag}_theta_dot")
        for j in model.subtrees[first]:
            inertia, placement = model.inertias[j], model.jointPlacements[j]
            axis = pin.getJointJacobian(model, data, j, pin.LOCAL)[3:, model.joints[j].idx_v]
            body = spinningBodyNDOFStateEffector.SpinningBody()
            body.setMass(inertia.mass)
            body.setISPntSc_S(inertia.inertia.tolist())
            body.setR_ScS_S(column(inertia.lever))
            body.setDCM_S0P(placement.rotation.T.tolist())
            body.setR_SP_P(column(placement.translation))
            body.setSHat_S(column(axis))
            body.setThetaInit(float(angles[j - 2]))
            body.setThetaDotInit(float(v[4 + j]))
            body.setK(0.0)
            body.setC(0.0)
            arm.addSpinningBody(body)
        craft.addStateEffector(arm)
        arms.append(([j - 2 for j in model.subtrees[first]], arm))
    return craft, arms


class ArmControl(sysModel.SysModel):
    """A module that calls `torque(t, q, v)` in each period and sends the returned joint torques to the arms.

    The frame of q and v has inertial axes and its origin at the system's centre of mass. In orbit this frame
    is in free fall, so the robot floats in it as without gravity.
    """

    def __init__(self, sms, craft, arms, torque):
        super().__init__()
        self.sms, self.torque, self.craft = sms, torque, craft.scStateOutMsg.addSubscriber()
        self.arms = []
        for joints, arm in arms:
            message = messaging.ArrayMotorTorqueMsg()
            arm.motorTorqueInMsg.subscribeTo(message)
            states = [state.addSubscriber() for state in arm.spinningBodyOutMsgs]
            self.arms.append((joints, states, message))

    def Reset(self, now):
        """Write zero torques; Basilisk calls this once, with its time [ns]."""
        self.write(np.zeros(self.sms.n), now)

    def UpdateState(self, now):
        """Read the state and write the torques of the next period."""
        craft, angles, rates = self.craft(), np.zeros(self.sms.n), np.zeros(self.sms.n)
        for joints, states, _ in self.arms:
            angles[joints] = [state().theta for state in states]
            rates[joints] = [state().thetaDot for state in states]
        R = np.array(RigidBodyKinematics.MRP2C(craft.sigma_BN)).T
        base = pin.SE3(R, np.subtract(craft.r_BN_N, craft.r_CN_N))
        self.q = self.sms.configuration(angles, base)
        self.v = np.hstack([R.T @ np.subtract(craft.v_BN_N, craft.v_CN_N), craft.omega_BN_B, rates])
        self.write(self.torque(1e-9 * now, self.q, self.v), now)

    def write(self, tau, now):
        """Send each arm its torques (n,) [N m]."""
        for joints, _, message in self.arms:
            payload = messaging.ArrayMotorTorqueMsgPayload()
            payload.motorTorque = [float(tau[i]) for i in joints]
            message.write(payload, now, self.moduleID)


def started(dt, modules):
    """Return a simulation that updates modules every dt [s], in this order: arms, craft, control."""
    sim = SimulationBaseClass.SimBaseClass()
    sim.CreateNewProcess("process").addTask(sim.CreateNewTask("task", macros.sec2nano(dt)))
    for module in modules:
        sim.AddModelToTask("task", module)
    sim.InitializeSimulation()
    return sim


def run_until(sim, t):
    """Simulate until time t [s]."""
    sim.ConfigureStopTime(macros.sec2nano(t))
    sim.ExecuteSimulation()


if __name__ == "__main__":
    sms, dt = ffsms.load("planar_3r"), 0.01
    q0 = sms.configuration(np.radians([1, 1, 1]))
    plan = opt.plan(sms, q0, [1.0, 0.15, 0.0], duration=6.0)
    controller = ffsms.SlidingModeController(sms)
    tracking = ffsms.simulate(sms, plan, controller, dt=dt)

    craft, arms = to_basilisk(sms, q0, np.zeros(sms.nv))
    control = ArmControl(sms, craft, arms, lambda t, q, v: controller.torque(q, v, *plan.sample(t)))
    run_until(started(dt, [arm for _, arm in arms] + [craft, control]), plan.duration)
    apart = np.abs(control.q - tracking.q[-1]).max()
    tool = sms.at(control.q).end_effector_pose.translation
    print(f"after {plan.duration:g} s the tool is {1e3 * np.linalg.norm(tool - plan.target):.3f} mm off,")
    print(f"joints and base differ from those of `simulate` by at most {apart:.0e}")
    assert apart < 1e-9

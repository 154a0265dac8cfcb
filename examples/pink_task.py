"""Solve inverse kinematics of a floating arm with Pink's tasks. Needs Pink: pip install pin-pink.

No external force acts on the base, so it reacts to the joints. With the conservation of momentum as a
constraint of Pink's QP, the Jacobian of every task acts like the generalised Jacobian J*. Without this
constraint Pink would move the base freely.
"""

import numpy as np
import pink
import pinocchio as pin
from pink.tasks import FrameTask, PostureTask, Task

import ffsms_pin as ffsms

sms, dt = ffsms.load("space_arm_7"), 0.02
q = sms.configuration([0.3, 0.4, 0.5, 0.6, 0.5, 0.4, 0.3])


class MomentumTask(Task):
    """The constraint that the total momentum is zero: v_base + M_b^-1 M_bm qd = 0."""

    def compute_error(self, configuration):
        """Return zero, because the total momentum is zero."""
        return np.zeros(6)

    def compute_jacobian(self, configuration):
        """Return [I, M_b^-1 M_bm] (6, 6 + n), from the centroidal momentum matrix."""
        A = pin.computeCentroidalMap(configuration.model, configuration.data, configuration.q)
        return np.linalg.solve(A[:, :6], A)

    def __repr__(self):
        """Return the name that Pink prints."""
        return "MomentumTask()"


model = sms.model.copy()  # with limits of the arm and without limits of the base
model.velocityLimit = np.concatenate([np.full(6, np.inf), sms.limits.velocity])
model.lowerPositionLimit[:7], model.upperPositionLimit[:7] = -1e20, 1e20  # Pink's "no limit"
configuration = pink.Configuration(model, model.createData(), q)

target = sms.at(q).end_effector_pose
target.translation = target.translation + np.array([-0.1, 0.05, 0.0])
tool = FrameTask(sms.end_effector, position_cost=1.0, orientation_cost=0.0, gain=0.1)
tool.set_target(target)
posture = PostureTask(cost=1e-3)
posture.set_target(q)
momentum = MomentumTask(cost=1.0)

for k in range(151):
    state = sms.at(configuration.q)
    error = np.linalg.norm(state.end_effector_pose.translation - target.translation)
    if k % 30 == 0:
        print(f"{k * dt:.1f} s: {1e3 * error:7.3f} mm position error")
    v = pink.solve_ik(configuration, [tool, posture], dt, "proxqp", constraints=[momentum], eps_abs=1e-10)
    J = pin.getFrameJacobian(model, configuration.data, sms.frame_id, pin.LOCAL_WORLD_ALIGNED)
    assert np.allclose(J @ v, state.J_star @ v[6:], atol=1e-6)  # the frame's velocity is that of J*
    # Integrate constant joint rates and the momentum equation by the midpoint rule.
    middle = pin.integrate(model, configuration.q, 0.5 * dt * sms.velocity(configuration.q, v[6:]))
    configuration.update(pin.integrate(model, configuration.q, dt * sms.velocity(middle, v[6:])))

turn = np.degrees(np.linalg.norm(pin.log3(state.base_pose.rotation)))
drift = np.linalg.norm(state.com - sms.at(q).com)
print(f"the base turned by {turn:.2f} deg; the system's centre of mass moved by {drift:.0e} m")
assert error < 1e-3
assert drift < 1e-6

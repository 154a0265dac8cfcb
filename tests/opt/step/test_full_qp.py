"""Steps of a rollout against the full QP, written from the plain formulas and solved by DAQP.

Inactive rows that limits leave out, and warm starts, do not change the solution.
"""

from __future__ import annotations

import numpy as np
import pytest
from clearances_at import At, Points
from plain_steps import by_daqp, plain_qp

import ffsms_pin as ffsms
from ffsms_pin.geometry.bodies import BodyStack
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.limits.clearance import Clearance
from ffsms_pin.opt.limits.joint_limits import JointLimits
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.robot.base_motion import advance


@pytest.mark.parametrize("case", ["freely", "into the base", "bodies"])
def test_steps_agree_with_the_full_qp(case: str) -> None:
    sms, dt = ffsms.load("satellite_panda" if case == "bodies" else "planar_3r"), 0.01
    if case == "freely":
        joints, target, steps = np.deg2rad([1.0, 1.0, 1.0]), np.array([0.45, 0.75, 0.0]), 300
    elif case == "into the base":
        joints, steps = np.deg2rad([75.0, 60.0, 20.0]), 250
        target = sms.at(sms.configuration(joints)).base_pose.act(np.array([0.1, 0.15, 0.0]))
    else:
        joints, steps = 0.5 * (sms.limits.lower + sms.limits.upper), 200
        displacement = np.array([-0.5, 0.1, -0.3])  # towards the base
        target = sms.at(sms.configuration(joints)).end_effector_pose.translation + displacement
    clearances = At(BodyStack(sms, "hulls", 0.01)) if case == "bodies" else Points(sms)
    stepper = Stepper(sms, dt, 10.0, [JointLimits(), AlphaBox(), Clearance(0.01)])
    q, rates, active = sms.configuration(joints), np.zeros(sms.n), 0
    for k in range(steps):
        time_left = 1.0 + (steps - k) * dt
        stepper.side = np.zeros(3)  # the side of the present motion
        step = stepper.step(q, rates, target, time_left)
        assert step.solved
        value, gradient = clearances.gradients(q)
        problem = plain_qp(sms, q, rates, target, time_left, (value, gradient))
        x = by_daqp(problem)
        np.testing.assert_allclose(step.alpha, x[: sms.n], rtol=0.0, atol=1e-9)
        active += bool((problem.C @ x - problem.l)[-len(value) :].min() < 1e-9)
        q, rates = advance(sms, q, rates, (step.joint_rates - rates) / dt, dt)
    assert (active > 20) == (case != "freely")

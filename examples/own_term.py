"""Add a cost of your own: a camera on the tool points at a fixed point.

A term is one formula; `opt.check` compares its derivatives with finite differences.
"""

from dataclasses import dataclass

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt


@dataclass(frozen=True)
class Gaze(opt.Term):
    """The pointing error of a camera on the tool, times the distance to the point."""

    at: tuple[float, float, float]  # the point, inertial axes [m]
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)  # of the camera, end-effector axes
    weight: float = 1.0
    name = "gaze"

    def residual(self, m):
        """Return the residual, whose square is integrated over the motion."""
        w = self.at - m.tip
        return self.weight**0.5 * (w - w.norm() * m.frame("tip").axis(self.axis))


def angle_off(sms, plan, point):
    """Return the largest angle from the camera's axis to the point in the second half of the motion [deg]."""
    poses = [sms.at(q).end_effector_pose for q in plan.q[len(plan.q) // 2 :]]
    points = [pose.actInv(point) for pose in poses]  # in end-effector axes
    return np.degrees(max(np.arccos(p[0] / np.linalg.norm(p)) for p in points))


sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([23.0, 40.0, -29.0]))
goal, point = [0.45, 0.75, 0.0], np.array([1.0, 1.2, 0.0])
problem = opt.Problem(sms, q0, goal, duration=8.0)
gaze = Gaze(at=tuple(point), weight=1.0)
looking = opt.Problem(sms, q0, goal, duration=8.0, terms=[opt.Coupling(), opt.Smooth(), opt.Effort(), gaze])
print(f"largest relative error of the derivatives: {opt.check(gaze, looking):.0e}")
plans = [opt.solve(each) for each in (problem, looking)]
for name, plan in zip(("without", "with"), plans, strict=True):
    print(f"{name} the term: pointing error up to {angle_off(sms, plan, point):.0f} deg in the second half")
print(f"shares of the cost: { {name: round(share, 4) for name, share in plan.shares.items()} }")
assert all(plan.reached for plan in plans)
assert angle_off(sms, plans[1], point) < 0.8 * angle_off(sms, plans[0], point)

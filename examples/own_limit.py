"""Add a limit of your own: the tool stays on one side of a plane.

A limit is one formula; `opt.check` compares its derivatives with finite differences.
"""

from dataclasses import dataclass

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt


@dataclass(frozen=True)
class Above(opt.Inequality):
    """The limit normal . position >= height on the end effector's position."""

    normal: tuple[float, float, float]  # of length 1, inertial axes
    height: float = 0.0  # [m]
    name = "above"

    def slack(self, m):
        """Return the slack [m], which must not be negative."""
        return m.tip.dot(self.normal) - self.height


sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([23.0, 40.0, -29.0]))
goal = [0.45, 0.75, 0.0]
above = Above(normal=(-0.456, -0.890, 0.0), height=-0.885)
limits = [opt.JointLimits(), opt.Clearance()]
problem = opt.Problem(sms, q0, goal, duration=8.0, limits=[*limits, above])
print(f"largest relative error of the derivatives: {opt.check(above, problem):.0e}")
plans = {
    "without": opt.solve(opt.Problem(sms, q0, goal, duration=8.0, limits=limits)),
    "with": opt.solve(problem),
}
for name, plan in plans.items():
    lowest = (plan.end_effector @ above.normal - above.height).min()
    print(f"{name} the limit: at least {1e3 * lowest:.1f} mm over the plane")
    assert plan.reached
assert lowest > 0.0
assert "above" in plan.binding

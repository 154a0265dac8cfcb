"""Measure the base rotation while one arm moves to a goal, with the second arm free and locked.

Run: python benchmarks/two_arms.py
Robot, start and position goal are those of docs/goals.md. The pose goal also rotates the end effector by
0.25 rad.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from table import markdown

import ffsms_pin as ffsms
from ffsms_pin import opt

HALF = [0.3, 0.5, 0.2, -1.0, 0.2, 0.6, 0.1]  # [rad] joint positions of each arm
WAY, TURN, DURATION = np.array([-0.15, -0.1, 0.15]), np.array([0.0, 0.0, 0.25]), 15.0  # [m], [rad], [s]
SETTINGS: dict[str, dict[str, Any]] = {
    "no penalty": {},
    "`base=1`": {"base": 1.0},
    "`base=100`": {"base": 100.0},
    "`BaseLimits(attitude=np.radians(0.3))`": {"base_limits": opt.BaseLimits(attitude=np.radians(0.3))},
    "`BaseLimits(attitude=np.radians(0.1))`": {"base_limits": opt.BaseLimits(attitude=np.radians(0.1))},
}


def cell(plan: opt.Trajectory) -> str:
    """Return a cell of the table: the base's rotation and, if the target is missed, the final error."""
    turn = f"{np.degrees(plan.base_rotation.max()):.2g} deg"
    return turn if plan.reached else f"{turn}, missed by {1e3 * plan.position_error[-1]:.0f} mm"


if __name__ == "__main__":
    sms = ffsms.load("two_arms", end_effector="left_tool")
    q0 = sms.configuration(HALF + HALF)
    start = sms.at(q0).end_effector_pose
    place = start.translation + WAY
    pose = pin.SE3(start.rotation @ pin.exp3(TURN), place)
    locked = [name for name in sms.joint_names if name.startswith("right")]
    lines = [
        (
            label,
            *(
                cell(opt.plan(sms, q0, goal, DURATION, locked=names, **options))
                for goal in (place, pose)
                for names in ((), locked)
            ),
        )
        for label, options in SETTINGS.items()
    ]
    print(
        markdown(
            (
                "largest base rotation",
                "position: both arms",
                "position: second arm locked",
                "pose: both arms",
                "pose: second arm locked",
            ),
            lines,
        )
    )

"""Measure the final error of a motion that is planned for a fixed base, and draw a figure.

Run from the repository's root:
    python benchmarks/fixed_base.py --targets 100 --figure docs/images/fixed-or-free.png
A joint move that reaches its target on a fixed base is applied to the floating base, and compared with the
plan of `opt.plan`. The targets are those of `motions.py`. The figure shows Case 2.
"""

from __future__ import annotations

import argparse
from itertools import islice
from pathlib import Path

import numpy as np
from motions import DT, DURATION, tasks

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.trajectory import measure

ROBOTS = ("satellite_ur5", "satellite_panda", "satellite_xarm7")
CASE_2 = np.array([0.45, 0.65, 0.0])  # [m]


def as_if_fixed(sms: ffsms.SpaceManipulator, q0: FloatArray, target: FloatArray) -> opt.Trajectory | None:
    """Return the motion of a floating base for a joint move that reaches the target on a fixed base.

    Return None if the inverse kinematics finds no such move.
    """
    q, start = np.array(q0), sms.joint_positions(q0)
    sms.layout.set_positions(q, start + 0.05)  # away from the stretched posture, which is singular
    for _ in range(200):
        state = sms.at(q)
        off = target - state.end_effector_pose.translation
        if np.linalg.norm(off) < 1e-6:
            break
        J = state.J_m[:3]
        step = J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(3), off)
        step *= min(1.0, 0.1 / max(float(np.abs(step).max()), 1e-12))
        sms.layout.set_positions(q, sms.joint_positions(q) + step)
    else:
        return None
    s = np.linspace(0.0, 1.0, round(DURATION / DT) + 1)[:, None]
    rates = 30.0 * (s * (1.0 - s)) ** 2 / DURATION * (sms.joint_positions(q) - start)
    return measure(opt.Problem(sms, q0, target, DURATION, DT), rates)


def row(name: str, count: int) -> str:
    """Return the table row of a robot: medians and largest errors over its targets."""
    sms = ffsms.load(name)
    misses, turns, planned = [], [], []
    for q0, target, _ in islice(tasks(sms, 1), count):
        fixed = as_if_fixed(sms, q0, target)
        if fixed is not None:
            misses.append(fixed.position_error[-1])
            turns.append(fixed.base_rotation.max())
            planned.append(opt.plan(sms, q0, target, DURATION, DT).position_error[-1])
    as_fixed, ours = (f"{1e3 * np.median(one):.3g}, {1e3 * max(one):.3g}" for one in (misses, planned))
    return f"| `{name}` | {len(misses)} | {as_fixed} | {np.degrees(np.median(turns)):.1f} | {ours} |"


def draw(path: Path) -> None:
    """Draw Case 2 as planned for a fixed base and as planned for a floating base, side by side."""
    from matplotlib.figure import Figure

    from ffsms_pin.plotting import plot_motion
    from ffsms_pin.plotting.motion import fit, times_drawn
    from ffsms_pin.plotting.style import applied, share_legend, subplots

    sms = ffsms.load("planar_3r")
    q0 = sms.configuration(np.radians([1.0, 1.0, 1.0]))
    fixed, free = as_if_fixed(sms, q0, CASE_2), opt.plan(sms, q0, CASE_2, DURATION, DT)
    assert fixed is not None
    both = ((fixed, "planned for a fixed base"), (free, "planned with the coupling"))
    with applied():
        figure = Figure(layout="constrained")
        panels = subplots(figure, 1, 2)
        for ax, (plan, words) in zip(panels, both, strict=True):
            plot_motion(sms, plan, ax).set_xlabel("x [m]")
            ax.set_title(f"planar_3r, {words}: ends {1e3 * plan.position_error[-1]:.1f} mm off", fontsize=10)
        figure.supxlabel(times_drawn(free), fontsize=9.0)
        fit(figure, panels)
        share_legend(figure, panels)
        figure.savefig(path, dpi=110)


def main() -> None:
    """Print a Markdown table, and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--targets", type=int, default=100)
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    print(
        "| robot | targets | error with a fixed base, median, max [mm] | base rotation [deg] "
        "| error of `opt.plan` [mm] |"
    )
    print("|---|---|---|---|---|")
    for name in ROBOTS:
        print(row(name, arguments.targets), flush=True)
    if arguments.figure is not None:
        draw(arguments.figure)


if __name__ == "__main__":
    main()

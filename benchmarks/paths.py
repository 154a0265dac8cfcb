"""Follow 40 paths, ten with each of four robots.

Run from the repository's root: python benchmarks/paths.py
The paths are circles, lines, rounded squares and helices. They take 20 s after an approach of 2 s. Each path
begins at the end effector's position in a random posture. A path is used only if resolved-rate
control, written here with Pinocchio, follows it within the joints' ranges, half of their rate limits and the
clearance. The plans are checked by integration with Pinocchio at ten times their resolution.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from planner import apart_by
from table import markdown

import ffsms_pin as ffsms
from ffsms_pin import opt

FloatArray = NDArray[np.float64]
Curve = Callable[[float], FloatArray]
PERIOD, APPROACH, DT, TOLERANCE = 20.0, 2.0, 0.01, 1e-3
ROBOTS = ("planar_3r", "satellite_panda", "satellite_ur5", "two_arms")
KINDS = ("circle", "line", "rounded square", "helix")
EACH = 10


def robot(name: str) -> ffsms.SpaceManipulator:
    """Return a packaged robot with one end effector."""
    return ffsms.load(name, end_effector="right_tool") if name == "two_arms" else ffsms.load(name)


def curve_of(kind: str, begin: FloatArray, axes: FloatArray, size: float) -> Curve:
    """Return a curve of a size [m] from `begin` (3,), in the plane of the first two of the axes (3, 3)."""
    x, y, z = axes.T

    def circle(s: float) -> FloatArray:
        a = 2.0 * np.pi * s
        return begin + size * ((np.cos(a) - 1.0) * x + np.sin(a) * y)

    def line(s: float) -> FloatArray:  # there and back
        return begin + size * (1.0 - np.cos(2.0 * np.pi * s)) * (0.6 * x + 0.8 * y)

    def helix(s: float) -> FloatArray:  # two turns
        a = 4.0 * np.pi * s
        return begin + 0.5 * size * ((np.cos(a) - 1.0) * x + np.sin(a) * y) + size * s * z

    def square(s: float) -> FloatArray:  # side `size`, with corners of radius size / 4
        r, side = 0.25 * size, 0.5 * size
        quarter = 0.5 * np.pi * r
        left = (s % 1.0) * 4.0 * (side + quarter)
        position, ahead = begin.copy(), x
        turned = y
        for _ in range(4):
            step = min(left, side)
            position = position + step * ahead
            left -= step
            angle = min(left, quarter) / r
            position = position + r * (np.sin(angle) * ahead + (1.0 - np.cos(angle)) * turned)
            left -= angle * r
            if left <= 0.0:
                break
            ahead, turned = turned, -ahead
        return position

    return {"circle": circle, "line": line, "rounded square": square, "helix": helix}[kind]


def allowed(sms: ffsms.SpaceManipulator, q0: FloatArray, curve: Curve, apart: Any) -> bool:
    """Return whether resolved-rate control follows a curve within ranges, half of the rates and clearance."""
    limits, dt, q = sms.limits, 0.1, q0.copy()
    model = sms.model
    for k in range(round(PERIOD / dt)):
        state = sms.at(q)
        s = k * dt / PERIOD
        velocity = (curve(s + dt / PERIOD) - state.end_effector_pose.translation) / dt
        J = state.J_star[:3]
        rates = np.linalg.lstsq(J.T @ J + 1e-8 * np.eye(sms.n), J.T @ velocity, rcond=None)[0]
        joints = sms.joint_positions(q)
        room = 0.05 * np.where(np.isfinite(limits.upper - limits.lower), limits.upper - limits.lower, 0.0)
        if (np.abs(rates) > 0.5 * limits.velocity).any() or (k % 5 == 0 and not apart(joints)):
            return False
        if (joints < limits.lower + room).any() or (joints > limits.upper - room).any():
            return False
        A = pin.computeCentroidalMap(model, model.createData(), q)
        v = np.concatenate([-np.linalg.solve(A[:, :6], A[:, 6:] @ rates), rates])
        q = pin.integrate(model, q, dt * v)
    return float(np.linalg.norm(sms.at(q).end_effector_pose.translation - curve(1.0))) < 0.01


def paths(name: str, sms: ffsms.SpaceManipulator, seed: int) -> Iterator[tuple[str, FloatArray, Curve]]:
    """Draw paths of all kinds in turn; yield kind, start and curve over the share s of the time."""
    rng, limits, apart = np.random.default_rng(seed), sms.limits, apart_by(sms)
    middle = np.where(np.isfinite(limits.lower + limits.upper), 0.5 * (limits.lower + limits.upper), 0.0)
    half = np.minimum(
        np.where(np.isfinite(limits.upper - limits.lower), limits.upper - limits.lower, 6.0), 6.0
    )
    length = sms.arm_stack().length
    for i in range(EACH):
        kind = KINDS[i % len(KINDS) if name != "planar_3r" else i % 3]
        while True:
            q0 = sms.configuration(middle + 0.3 * half * rng.uniform(-1.0, 1.0, sms.n))
            axes = (
                np.eye(3)
                if name == "planar_3r"
                else pin.Quaternion(*rng.normal(size=4)).normalized().matrix()
            )
            curve = curve_of(
                kind, sms.at(q0).end_effector_pose.translation.copy(), axes, rng.uniform(0.03, 0.12) * length
            )
            if allowed(sms, q0, curve, apart):
                yield kind, q0, curve
                break


def judged(sms: ffsms.SpaceManipulator, plan: opt.Trajectory, curve: Curve) -> tuple[float, bool]:
    """Return the largest distance from a path after the approach [m], and whether joint limits are kept.

    The joints are rolled out by Pinocchio's centroidal momentum matrix and the midpoint rule.
    """
    model, data, finer, limits = sms.model, sms.model.createData(), 10, sms.limits
    h, q, off = plan.dt / finer, plan.q[0].copy(), 0.0
    kept = bool((np.abs(plan.joint_rates) <= limits.velocity + 1e-9).all())
    kept &= bool((np.abs(plan.joint_accelerations) <= limits.acceleration + 1e-9).all())
    kept &= float(limits.violation(plan.joint_positions).max()) < 1e-9
    v = np.zeros(model.nv)
    for k, acceleration in enumerate(plan.joint_accelerations):
        for i in range(finer):
            rates = plan.joint_rates[k] + (i + 0.5) * h * acceleration
            middle = q
            for last in (False, True):
                A = pin.computeCentroidalMap(model, data, middle)
                v[:6], v[6:] = -np.linalg.solve(A[:, :6], A[:, 6:] @ rates), rates
                middle = pin.integrate(model, q, (h if last else 0.5 * h) * v)
            q = middle
            t = plan.t[k] + (i + 1) * h
            if t >= APPROACH:
                pin.framesForwardKinematics(model, data, q)
                place = data.oMf[sms.frame_id].translation
                off = max(off, float(np.linalg.norm(place - curve((t - APPROACH) / PERIOD))))
    return off, kept


def main() -> None:
    """Print a table with a row for each robot."""
    rows, total = [], 0
    for seed, name in enumerate(ROBOTS):
        sms = robot(name)
        apart = apart_by(sms)
        within, largest, seconds = 0, list[float](), list[float]()
        for kind, q0, curve in paths(name, sms, seed):
            path = opt.Path(
                lambda t, curve=curve: curve(t / PERIOD), tolerance=TOLERANCE, approach_time=APPROACH
            )
            begun = time.process_time()
            plan = opt.plan(sms, q0, path, duration=PERIOD + APPROACH, dt=DT)
            seconds.append(time.process_time() - begun)
            off, kept = judged(sms, plan, curve)
            clear = all(apart(joints) for joints in plan.joint_positions[::20])
            good = plan.reached and kept and clear and off <= TOLERANCE
            within += good
            largest.append(off)
            if not good:
                print(f"{name}, {kind}: {1e3 * off:.3g} mm, {kept}, {clear}, {plan.note}", file=sys.stderr)
        total += within
        rows.append(
            (
                f"`{name}`",
                f"{within} of {EACH}",
                f"{1e3 * np.median(largest):.5f}",
                f"{1e3 * max(largest):.5f}",
                f"{np.median(seconds):.2f}",
                f"{max(seconds):.2f}",
            )
        )
    rows.append(("all", f"{total} of {EACH * len(ROBOTS)}", "", "", "", ""))
    head = ("robot", "within 1 mm", "median of the largest error [mm]", "largest error [mm]")
    print(markdown((*head, "median CPU time [s]", "longest [s]"), rows))


if __name__ == "__main__":
    main()

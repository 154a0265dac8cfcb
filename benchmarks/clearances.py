"""Check by Pinocchio and Coal alone that the exact meshes of plans reported as clear keep the clearance.

From the repository's root: python benchmarks/clearances.py [ROBOT ...] [--targets N] [--modes points auto]
Each plan uses the library's defaults. It starts at a random posture, and its target is the end effector's
position in another posture; both postures keep the clearance. Then all pairs of meshes except neighbours are
tested, at the nodes and at instants that divide each step into `PARTS` parts. The planner itself checks
convex parts of the meshes, at the nodes and in the middle of each step. `--modes` selects other collision
models: the paper's points, or the shapes themselves.
"""

from __future__ import annotations

import argparse
import time
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.geometry.bodies import BodyStack
from ffsms_pin.geometry.distances import Poses
from ffsms_pin.robot.mounting import ARMS

ROBOTS = (*(f"satellite_{arm}" for arm in ARMS), "space_arm_7")
DT, CLEARANCE = 0.01, 0.01  # [s], [m]
SPARE = 0.012  # [m] clearance of starts and goals; two links of the UR5's wrist are never 0.015 m apart
SLACK = 1.5  # durations as multiples of the joints' minimum time
PARTS = 3  # number of parts of a step; the meshes are tested at their ends
TOLERANCE = 2e-5  # [m] tolerated violation of the clearance
TARGETS = 40


class Judged(NamedTuple):
    """The result for one plan.

    `through` is true if meshes collide, `near` if they come nearer than the clearance.
    """

    reached: bool
    clear: bool
    through: bool
    near: bool
    seconds: float
    note: str


def clear_postures(sms: ffsms.SpaceManipulator, count: int, seed: int) -> FloatArray:
    """Draw joint positions (count, n) from 80 % of the joint box, within +-pi, with clearance `SPARE`."""
    rng, stack = np.random.default_rng(seed), BodyStack(sms, "hulls", CLEARANCE)
    low, high = np.maximum(sms.limits.lower, -np.pi), np.minimum(sms.limits.upper, np.pi)
    middle, half = 0.5 * (low + high), 0.4 * (high - low)
    found: list[FloatArray] = []
    while len(found) < count:
        drawn = middle + half * rng.uniform(-1.0, 1.0, (32, sms.n))
        least = stack.values(Poses.of(drawn.T), SPARE).min(axis=0)
        found += list(drawn[least >= SPARE])
    return np.array(found[:count])


class Meshes:
    """The collision shapes of a robot's URDF, and all pairs of bodies except neighbours."""

    def __init__(self, sms: ffsms.SpaceManipulator) -> None:
        self._sms, self._data = sms, sms.model.createData()
        self._geometry = sms.geometry("collision").copy()
        self._geometry.removeAllCollisionPairs()
        shapes, parents = self._geometry.geometryObjects, sms.model.parents
        for i, one in enumerate(shapes):
            for j in range(i + 1, len(shapes)):
                a, b = sorted((int(one.parentJoint), int(shapes[j].parentJoint)))
                if a != b and int(parents[b]) != a:
                    self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        self._touching, self._near = self._geometry.createData(), self._geometry.createData()
        for request in self._near.collisionRequests:
            request.security_margin = CLEARANCE - TOLERANCE

    def collide(self, joints: FloatArray, near: bool = False) -> bool:
        """Return whether meshes collide at joint positions (n,), or with `near` violate the clearance."""
        q, placed = self._sms.configuration(joints), self._near if near else self._touching
        return bool(pin.computeCollisions(self._sms.model, self._data, self._geometry, placed, q, True))


def judged(meshes: Meshes, plan: opt.Trajectory) -> tuple[bool, bool]:
    """Return whether meshes collide during a plan, and whether they come nearer than the clearance."""
    joints, rates, accelerations = plan.joint_positions, plan.joint_rates[:-1], plan.joint_accelerations
    # Between two nodes the acceleration is constant.
    after = plan.dt * np.arange(PARTS) / PARTS
    rows = [joints[:-1] + h * (rates + 0.5 * h * accelerations) for h in after.tolist()]
    near = [row for row in np.concatenate([*rows, joints[-1:]]) if meshes.collide(row, near=True)]
    return any(map(meshes.collide, near)), bool(near)


def plans(name: str, count: int, seed: int, collision: str) -> list[Judged]:
    """Plan for one robot, and check the plans."""
    sms = ffsms.load(name)
    postures, limits, meshes = clear_postures(sms, 2 * count, seed), sms.limits, Meshes(sms)
    found = []
    for start, goal in zip(postures[::2], postures[1::2], strict=True):
        need = np.max(np.abs(goal - start) / limits.velocity + limits.velocity / limits.acceleration)
        target = sms.at(sms.configuration(goal)).end_effector_pose.translation
        begin = time.process_time()
        plan = opt.plan(
            sms,
            sms.configuration(start),
            target,
            SLACK * float(need),
            DT,
            clearance=CLEARANCE,
            collision=collision,
        )
        seconds = time.process_time() - begin
        through, near = judged(meshes, plan) if plan.clear else (False, False)
        found.append(Judged(plan.reached, plan.clear, through, near, seconds, plan.note))
    return found


def run(
    count: int = TARGETS, seed: int = 1, robots: tuple[str, ...] = ROBOTS, modes: tuple[str, ...] = ("auto",)
) -> list[dict[str, Any]]:
    """Return the results of all robots and collision models."""
    return [
        {"robot": robot, "mode": mode, "plans": [one._asdict() for one in plans(robot, count, seed, mode)]}
        for robot in robots
        for mode in modes
    ]


def report(results: list[dict[str, Any]]) -> str:
    """Return a Markdown table."""
    lines = [
        "| robot | collision model | reported clear | of these colliding | of these below the clearance | "
        "reached | median CPU time [s] | longest [s] |",
        "|" + "---|" * 8,
    ]
    for r in results:
        one = r["plans"]
        seconds = [plan["seconds"] for plan in one]
        clear, *others = (sum(plan[key] for plan in one) for key in ("clear", "through", "near", "reached"))
        cells = [r["robot"], r["mode"], f"{clear} of {len(one)}", *others]
        cells += [f"{np.median(seconds):.2f}", f"{max(seconds):.1f}"]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def main() -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=ROBOTS)
    parser.add_argument("--targets", type=int, default=TARGETS)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--modes", nargs="+", default=["auto"], help="such as: points auto shapes")
    arguments = parser.parse_args()
    modes = tuple(arguments.modes)
    head = ""
    for robot in arguments.robots:
        rows = report(run(arguments.targets, arguments.seed, (robot,), modes)).splitlines()
        print("\n".join(rows[2:] if head else rows), flush=True)
        head = robot


if __name__ == "__main__":
    main()

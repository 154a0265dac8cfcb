"""Count the targets reached among obstacles, and measure the clearance and the cost of the plans.

A straight joint-space move reaches each target by construction (see `targets.py`). Three obstacles
are drawn near the volume that the arm sweeps in that move, but at a distance from it. Targets that are not
reached without obstacles are left out. Coal checks finished plans with the robot's meshes, at every fourth
node.
"""

from __future__ import annotations

import argparse
import sys
import time

import coal
import numpy as np
import pinocchio as pin
from table import markdown
from targets import Task, reachable_targets

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.rollouts import rolled_out
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import apply

DT, CLEARANCE = 0.01, 0.01  # [s], [m]
SPARE = 0.005  # [m] margin beyond the clearance in the straight move
COUNT = 3  # number of obstacles
NEAR = 0.3  # [m] largest distance of an obstacle's centre from the path of a link's shape
MOVE = 200  # number of configurations of the straight move that are checked
HEAD = (
    "robot, seed",
    "reached without obstacles",
    "reached among obstacles",
    "obstacles in the way",
    "wrongly reported clear",
    "smallest distance",
    "CPU time, median",
    "total CPU time",
)
EVERY = 4  # meshes are measured at every EVERY-th node of a plan


class Meshes:
    """The distances of the robot's collision meshes to obstacles, by Coal alone."""

    def __init__(self, sms: ffsms.SpaceManipulator) -> None:
        self._sms, self._data = sms, sms.model.createData()
        self._geometry = sms.geometry("collision")
        self._placed = self._geometry.createData()

    def places(self, q: FloatArray) -> list[pin.SE3]:
        """Return the poses of the shapes."""
        pin.updateGeometryPlacements(self._sms.model, self._data, self._geometry, self._placed, q)
        return [pose.copy() for pose in self._placed.oMg]

    def distance(self, places: list[pin.SE3], obstacle: opt.Obstacle) -> float:
        """Return the least distance [m] of any shape to an obstacle in inertial space."""
        there = coal.Transform3s(obstacle.pose.rotation, obstacle.pose.translation)
        least = np.inf
        for item, place in zip(self._geometry.geometryObjects, places, strict=True):
            here = coal.Transform3s(place.rotation, place.translation)
            result = coal.DistanceResult()
            found = coal.distance(item.geometry, here, obstacle.shape, there, coal.DistanceRequest(), result)
            least = min(least, found)
        return float(least)


def random_shape(rng: np.random.Generator) -> coal.ShapeBase:
    """Draw a box, sphere, cylinder or capsule, 0.1 to 0.3 m across."""
    a, b, c = rng.uniform(0.1, 0.3, 3)
    kinds = [
        lambda: coal.Box(a, b, c),
        lambda: coal.Sphere(0.5 * a),
        lambda: coal.Cylinder(0.4 * a, b),
        lambda: coal.Capsule(0.3 * a, b),
    ]
    return kinds[rng.integers(4)]()


def obstacles_beside(sms: ffsms.SpaceManipulator, task: Task, rng: np.random.Generator) -> list[opt.Obstacle]:
    """Draw obstacles near the straight move, with a clearance to it."""
    profile = 1.5 * (1.0 - (2.0 * np.linspace(0.0, 1.0, MOVE + 1) - 1.0) ** 2)
    rates = profile[:, None] * (task.joint_goal - sms.joint_positions(task.q0))
    motion = rolled_out(sms, ArmStack(sms), task.q0, rates, 1.0 / MOVE)
    points = motion.com[:, None] + apply(
        motion.base_attitude[:, :, :1], motion.arm.points[:, 2:, 0] - motion.arm.com
    )
    found: list[opt.Obstacle] = []
    while len(found) < COUNT:
        place = points[:, rng.integers(points.shape[1]), rng.integers(points.shape[2])]
        way = rng.normal(size=3)
        centre = place + NEAR * rng.uniform() ** (1.0 / 3.0) * way / np.linalg.norm(way)
        turn = pin.Quaternion(rng.normal(size=4)).normalized().toRotationMatrix()
        one = opt.Obstacle(random_shape(rng), pin.SE3(turn, centre))
        if one.distance(task.target, 0.0) < CLEARANCE:
            continue
        limit = opt.Clearance(CLEARANCE + SPARE, "off", obstacles=[one]).for_robot(sms)
        if limit.violation(motion).amount == 0.0:
            found.append(one)
    return found


def least_distance(sms: ffsms.SpaceManipulator, plan: opt.Trajectory, obstacles: list[opt.Obstacle]) -> float:
    """Return the least distance [m] of meshes to obstacles along a plan, at every `EVERY`-th node."""
    meshes = Meshes(sms)
    return min(
        meshes.distance(places, one)
        for q in plan.q[::EVERY]
        for places in [meshes.places(q)]
        for one in obstacles
    )


def run(name: str, count: int, seed: int) -> None:
    """Print a line for each target, and the numbers of all targets."""
    sms = ffsms.load(name)
    limits, rng = sms.limits, np.random.default_rng(seed)
    low, high = (np.clip(bound, -2.0, 2.0) for bound in (limits.lower, limits.upper))
    start = 0.5 * (low + high)
    free_time, held_time, reached, blocked, through, least = [], [], 0, 0, 0, np.inf
    asked = 0
    for i, task in enumerate(reachable_targets(sms, start, count, seed, DT)):
        begin = time.process_time()
        free = opt.plan(sms, task.q0, task.target, task.duration, DT, clearance=CLEARANCE)
        spent = time.process_time() - begin
        if not free.reached:
            continue
        obstacles = obstacles_beside(sms, task, rng)
        asked += 1
        free_time.append(spent)
        begin = time.process_time()
        plan = opt.plan(
            sms, task.q0, task.target, task.duration, DT, clearance=CLEARANCE, obstacles=obstacles
        )
        held_time.append(time.process_time() - begin)
        reached += plan.reached
        blocks = least_distance(sms, free, obstacles) < CLEARANCE
        blocked += blocks
        kept = least_distance(sms, plan, obstacles)
        least = min(least, kept) if plan.clear else least
        through += plan.clear and kept < CLEARANCE - 1e-4
        print(
            f"  {i:3d} {'in the way' if blocks else 'beside':10s} reached {plan.reached!s:5s} "
            f"{1e3 * kept:6.1f} mm {free_time[-1]:.2f} s -> {held_time[-1]:.2f} s {plan.note[:150]}",
            file=sys.stderr,
            flush=True,
        )
    row = (
        f"`{name}`, {seed}",
        f"{asked} of {count}",
        f"{reached}",
        f"{blocked}",
        f"{through}",
        f"{1e3 * least:.1f} mm",
        f"{np.median(free_time):.2f} s -> {np.median(held_time):.2f} s",
        f"{sum(held_time) / sum(free_time):.2f} times",
    )
    print("|", " | ".join(row), "|", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=["satellite_panda", "satellite_xarm7"])
    parser.add_argument("--targets", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    print(markdown(HEAD, ()))
    for robot in given.robots:
        run(robot, given.targets, given.seed)

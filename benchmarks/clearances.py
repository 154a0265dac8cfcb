"""Whether plans that are called clear keep the meshes apart, and what that costs."""

from __future__ import annotations

import argparse
import time

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.body_stack import BodyStack
from ffsms_pin.system.batch.arm import ArmStack

DT, CLEARANCE = 0.01, 0.01  # [s], [m]
SPARE = 0.015  # [m] Starts and joint goals keep so much. Some neighbours but one are always within 0.02 m.
SLACK = 1.5  # durations, over what the joints need
EVERY = 5  # of the instants, nodes and middles, at which meshes are tested


def clear_postures(sms: ffsms.SpaceManipulator, count: int, seed: int) -> FloatArray:
    """Joint positions (count, n), 80 % of the joint box, within half a turn, with bodies well apart."""
    rng, stack, arm = np.random.default_rng(seed), BodyStack(sms, "hulls", CLEARANCE), ArmStack(sms)
    low, high = np.maximum(sms.limits.lower, -np.pi), np.minimum(sms.limits.upper, np.pi)
    middle, half = 0.5 * (low + high), 0.4 * (high - low)
    found: list[FloatArray] = []
    while len(found) < count:
        drawn = middle + half * rng.uniform(-1.0, 1.0, (32, sms.n))
        least = stack.values(drawn.T, arm.evaluate(drawn.T), SPARE).min(axis=0)
        found += list(drawn[least >= SPARE])
    return np.array(found[:count])


def penetrates(sms: ffsms.SpaceManipulator, plan: opt.Trajectory) -> bool:
    """Whether meshes collide at nodes or in the middles between them, by Pinocchio alone."""
    geometry, data = sms.geometry("collision").copy(), sms.model.createData()
    geometry.removeAllCollisionPairs()
    shapes, parents = geometry.geometryObjects, sms.model.parents
    for i, one in enumerate(shapes):
        for j, other in enumerate(shapes):
            a, b = int(one.parentJoint), int(other.parentJoint)
            if a < b and int(parents[b]) != a:
                geometry.addCollisionPair(pin.CollisionPair(i, j))
    placed, h = geometry.createData(), 0.5 * plan.dt
    middles = plan.joint_positions[:-1] + h * (plan.joint_rates[:-1] + 0.5 * h * plan.joint_accelerations)
    rows = [*plan.joint_positions[::EVERY], *middles[EVERY // 2 :: EVERY]]
    return any(
        pin.computeCollisions(sms.model, data, geometry, placed, sms.configuration(row), True) for row in rows
    )


def run(name: str, count: int, seed: int, modes: list[str]) -> None:
    """One line of figures for each mode, and the others' times over that of the first."""
    sms = ffsms.load(name)
    postures = clear_postures(sms, count + 1, seed)
    start, limits = postures[0], sms.limits
    seconds = {}
    for mode in modes:
        clear = through = reached = 0
        spent = []
        for goal in postures[1:]:
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
                collision=mode,
            )
            spent.append(time.process_time() - begin)
            clear, reached = clear + plan.clear, reached + plan.reached
            through += plan.clear and penetrates(sms, plan)
        seconds[mode] = np.array(spent)
        print(
            f"{name:18s} {mode:7s} reached {reached}/{count}, clear {clear}, "
            f"through meshes {through}, {np.mean(spent):.2f} s a plan (median {np.median(spent):.2f})",
            flush=True,
        )
    first, *others = modes
    for mode in others:
        ratio = seconds[mode].sum() / seconds[first].sum()
        print(f"{name:18s} time with {mode} over that with {first}: {ratio:.2f}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=["satellite_panda", "satellite_xarm7", "satellite_ur10"])
    parser.add_argument("--targets", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--modes", nargs="+", default=["points", "auto"], help="such as: points auto shapes")
    given = parser.parse_args()
    for robot in given.robots:
        run(robot, given.targets, given.seed, given.modes)

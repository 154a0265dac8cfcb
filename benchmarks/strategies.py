"""Measure the effect of each strategy of the search by omitting it.

The kinds of targets are easy (with kappa 10 and 1), near, beside the start, hard, obstructed, short, hurried,
with momentum, and with weak wheels. A straight joint-space move with a floating base reaches the targets,
except the obstructed targets, some of the hard and short targets, and those with weak wheels. Hurried targets
are reached by `method="resolved-rate"` in little more than the minimum time. `python
benchmarks/strategies.py` prints the table, as does `make bench` with `BENCH="--only strategies"`.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from planner import bent
from table import markdown

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.problem import default_terms
from ffsms_pin.opt.rollouts import Rollouts, rolled_out
from ffsms_pin.opt.search.search import STRATEGIES, Search
from ffsms_pin.opt.step.stepwise import plan_stepwise
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.threads import one_blas_thread

# The model, and True if the targets are poses.
SETS = (("planar_3r", False), ("satellite_panda", True))
KINDS = ("easy", "kappa 1", "near", "hard", "obstructed", "short", "momentum", "beside", "hurried", "wheels")
# Strategies without which no plan is found.
NEEDED = ("first starts", "descent")
NAMES = tuple(name for name in dict.fromkeys(one.name for one in STRATEGIES) if name not in NEEDED)
DT = 0.02  # [s]
SHARE = 0.9  # share of the joint box from which goals are drawn, for hard and hurried targets also the start
SLACK = 1.5  # durations as multiples of the joints' minimum time; short durations are drawn from `SHORT`
SHORT = (0.8, 1.1)
NEAR = 0.1  # [rad] largest joint displacement to a near target; some are within the tolerance at the start
CARRIED = (0.2, 1.0)  # displacement [arm lengths] and rotation [rad] by the momentum
RADIUS = 0.03  # [arm lengths] radius of obstacles
BESIDE = 0.001  # [rad] largest joint displacement to a target beside the start, about a millimetre away
TURN = 0.015  # [rad] rotation of a pose beside the start
NOT_FAR = 0.6  # [rad] largest joint displacement to a hurried target
HURRY = 1.05  # durations as multiples of the least duration in which single steps reach the target
WEAK = 0.3  # share of the momentum that the wheels would need without limits
PYRAMID = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]]) / math.sqrt(3.0)


def problems(name: str, poses: bool, kind: str, count: int, seed: int) -> Iterator[opt.Problem]:
    """Draw problems of one kind."""
    sms = ffsms.load(name)
    rng, stack = np.random.default_rng([seed, KINDS.index(kind)]), ArmStack(sms)
    start = np.full(sms.n, np.deg2rad(1.0)) if name == "planar_3r" else bent(sms)
    limits = sms.limits
    low = np.where(np.isfinite(limits.lower), limits.lower, -math.pi)
    high = np.where(np.isfinite(limits.upper), limits.upper, math.pi)
    q0, made = sms.configuration(start), 0
    clearance = opt.Clearance().for_robot(sms)
    while made < count:
        slack = rng.uniform(*SHORT) if kind == "short" else SLACK
        if kind in ("hard", "hurried"):
            start = _drawn(low, high, rng)
            q0 = sms.configuration(start)
            if not _clear_at(sms, stack, clearance, start):
                continue
        goal = _drawn(low, high, rng)
        share = 10.0 ** rng.uniform(-1.5, 0.0)
        ways = {"near": NEAR * share, "hurried": NOT_FAR * share, "beside": BESIDE}
        if kind in ways:
            goal = start + ways[kind] * rng.uniform(-1.0, 1.0, sms.n)
        least = np.max(np.abs(goal - start) / limits.velocity + limits.velocity / limits.acceleration)
        duration = 6.0 if kind in ("near", "beside") else DT * math.ceil(slack * float(least) / DT)
        momentum = _momentum(stack, start, duration, rng) if kind == "momentum" else None
        move = _straight(sms, stack, q0, goal - start, duration, momentum)
        kept = clearance.violation(move).amount == 0.0
        if kept == (kind == "hard") or not _clear_at(sms, stack, clearance, goal):
            continue
        obstacles = _in_the_way(stack, move) if kind == "obstructed" else []
        around = opt.Clearance(obstacles=obstacles).for_robot(sms)
        if obstacles and not _stands_between(around, move):
            continue
        end = pin.SE3(move.attitude[:, :, 0, -1], move.end_effector[:, 0, -1])
        if kind == "beside" and poses:
            turn, here = rng.normal(size=3), sms.at(q0).end_effector_pose
            end = pin.SE3(pin.exp3(TURN / np.linalg.norm(turn) * turn) @ here.rotation, here.translation)
        target = end if poses else end.translation
        parts = (opt.JointLimits(), opt.Clearance(obstacles=obstacles))
        terms = default_terms(1.0 if kind == "kappa 1" else 10.0)
        problem = opt.Problem(sms, q0, target, duration, DT, terms, parts, momentum=momentum)
        found = {"hurried": _hurried, "wheels": _with_weak_wheels}.get(kind, lambda one: one)(problem)
        if found is not None:
            yield found
            made += 1


def _hurried(problem: opt.Problem) -> opt.Problem | None:
    """Return a problem with little more time than single steps to the target need; None if they fail."""

    def reaches(duration: float) -> bool:
        return plan_stepwise(replace(problem, duration=duration), "resolved-rate").reached

    enough = problem.duration
    if not reaches(enough):
        return None
    short = 0.1 * enough
    while enough > HURRY * short:
        between = math.sqrt(enough * short)
        enough, short = (between, short) if reaches(between) else (enough, between)
    return replace(problem, duration=enough)


def _with_weak_wheels(problem: opt.Problem) -> opt.Problem:
    """Return a problem whose wheels hold the attitude with a share of the momentum of an unlimited plan."""

    def with_wheels(**limits: float) -> opt.Problem:
        sms = problem.sms.with_actuators(wheels=ffsms.ReactionWheels(PYRAMID, 0.01, **limits))
        return replace(problem, sms=sms, mode="rotation-floating")

    free = Search(with_wheels()).run(STRATEGIES)
    return with_wheels(momentum=WEAK * float(np.abs(free.wheel_momentum).max()))


def _drawn(low: FloatArray, high: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw joint positions (n,) from the box."""
    return 0.5 * (low + high) + 0.5 * SHARE * (high - low) * rng.uniform(-1.0, 1.0, len(low))


def _straight(
    sms: ffsms.SpaceManipulator,
    stack: ArmStack,
    q0: FloatArray,
    way: FloatArray,
    duration: float,
    momentum: FloatArray | None,
) -> Rollouts:
    """Return the rollout of a straight joint move from rest to rest."""
    s = np.linspace(0.0, 1.0, round(duration / DT) + 1)
    rates = (6.0 * s * (1.0 - s))[:, None] * way / duration
    return rolled_out(sms, stack, q0, rates, duration / (len(s) - 1), momentum)


def _clear_at(sms: ffsms.SpaceManipulator, stack: ArmStack, clearance: opt.Limit, joints: FloatArray) -> bool:
    """Return whether the clearance is satisfied at joint positions (n,)."""
    still = rolled_out(sms, stack, sms.configuration(joints), np.zeros((2, sms.n)), DT)
    return clearance.violation(still).amount == 0.0


def _momentum(stack: ArmStack, start: FloatArray, duration: float, rng: np.random.Generator) -> FloatArray:
    """Draw a momentum (6,) that moves the robot, and turns it about z, by about `CARRIED` in `duration`."""
    shift, turn = CARRIED
    inertia = np.linalg.inv(stack.evaluate(start[:, None]).inverse[..., 0])
    linear = np.append(rng.uniform(-1.0, 1.0, 2), 0.0) * shift * stack.length * stack.mass / duration
    angular = inertia @ [0.0, 0.0, turn * rng.uniform(-1.0, 1.0) / duration]
    return np.concatenate([linear, [0.0, 0.0, angular[2]]])


def _in_the_way(stack: ArmStack, move: Rollouts) -> list[opt.Obstacle]:
    """Return spheres at the end effector after half of the time, and at the last joint after a third."""
    third = len(move.times) // 3
    middle = move.end_effector[:, 0, len(move.times) // 2]
    wrist = move.com[:, third] + move.base_attitude[:, :, 0, third] @ (
        move.arm.points[:, -2, 0, third] - move.arm.com[:, 0, third]
    )
    ball = coal.Sphere(RADIUS * stack.length)
    return [opt.Obstacle(ball, pin.SE3(np.eye(3), place)) for place in (middle, wrist)]


def _stands_between(around: opt.Limit, move: Rollouts) -> bool:
    """Return whether a move collides with the obstacle, but neither at its start nor at its end."""
    found = around.violation(move)
    binds = np.isin(move.times[[0, -1]], found.instants)
    return found.amount > 0.0 and not binds.any()


@one_blas_thread()
def run(
    counts: tuple[int, int],
    seed: int,
    models: Sequence[str] = tuple(name for name, _ in SETS),
    kinds: Sequence[str] = KINDS,
    names: Sequence[str] = NAMES,
) -> list[dict[str, Any]]:
    """Return rows of all plans: `counts` targets of each kind for the planar arm and for seven joints."""
    rows: list[dict[str, Any]] = []
    for (model, poses), count in zip(SETS, counts, strict=True):
        for kind in kinds if model in models else ():
            for i, problem in enumerate(problems(model, poses, kind, count, seed)):
                if not rows:
                    Search(problem).run(STRATEGIES)  # first use loads and fills caches
                for name in ("", *names):
                    options = opt.SearchOptions(without=(name,) if name else ())
                    begin = time.process_time()
                    plan = Search(problem, options).run(STRATEGIES)
                    rows.append(
                        {
                            "model": model,
                            "kind": kind,
                            "target": i,
                            "without": name,
                            "reached": plan.reached,
                            "within": plan.within_tolerance,
                            "farthest": float(plan.position_error.max()),
                            "broken": bool(plan.broken),
                            "cost": plan.cost_integral,
                            "travel": plan.joint_travel,
                            "seconds": time.process_time() - begin,
                        }
                    )
    return rows


def report(rows: list[dict[str, Any]]) -> str:
    """Return a table per model: reached targets, cost and travel if all strategies reach, and CPU time."""
    parts = []
    for model in dict.fromkeys(row["model"] for row in rows):
        ours = [row for row in rows if row["model"] == model]
        base = {(row["kind"], row["target"]): row for row in ours if not row["without"]}
        table = [
            [name or "(none)", *_numbers([row for row in ours if row["without"] == name], base)]
            for name in dict.fromkeys(row["without"] for row in ours)
        ]
        words = (
            "within tolerance",
            "violate a limit",
            "cost, median",
            "95 %",
            "travel [rad]",
            "largest error, beside [mm]",
        )
        head = ("strategy left out", *KINDS, *words, "CPU [s]")
        parts.append(f"{model}: reached targets; costs [s] if both plans reach\n\n{markdown(head, table)}")
    return "\n\n".join(parts)


def _numbers(rows: list[dict[str, Any]], base: dict[Any, dict[str, Any]]) -> list[str]:
    """Return one row of the table."""
    reached = []
    for kind in KINDS:
        own = [row["reached"] for row in rows if row["kind"] == kind]
        reached.append(f"{sum(own)} of {len(own)}" if own else "")
    pairs = [(row, base[row["kind"], row["target"]]) for row in rows]
    both = [(row, other) for row, other in pairs if row["reached"] and other["reached"]]
    cells = [
        str(sum(row["reached"] and row["within"] for row in rows)),
        str(sum(row["broken"] for row in rows)),
    ]
    for share in (50, 95):
        one, other = (np.percentile([pair[k]["cost"] for pair in both], share) for k in (0, 1))
        cells.append(f"{one:.5f} ({one / other:.2f})")
    travel = [float(np.sum([pair[k]["travel"] for pair in both])) for k in (0, 1)]
    seconds = [float(np.sum([pair[k]["seconds"] for pair in pairs])) for k in (0, 1)]
    cells.append(f"{travel[0] / len(both):.2f} ({travel[0] / travel[1]:.2f})")
    ways = [1e3 * row["farthest"] for row in rows if row["kind"] == "beside"]
    cells.append(f"{np.percentile(ways, 95):.3g}" if ways else "")
    cells.append(f"{seconds[0] / len(pairs):.2f} ({seconds[0] / seconds[1]:.2f})")
    return [*reached, *cells]


def main() -> None:
    """Run the command line."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--counts", type=int, nargs=2, default=(12, 4), help="targets of each kind (12 and 4)")
    p.add_argument("--seed", type=int, default=1, help="of the targets (default: 1)")
    p.add_argument("--models", nargs="+", choices=[name for name, _ in SETS], help="default: all")
    p.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS, help="of targets (default: all)")
    p.add_argument("--without", nargs="+", choices=NAMES, default=NAMES, help="strategies (default: each)")
    p.add_argument("--out", help="a JSON file for the rows")
    arguments = p.parse_args()
    models = arguments.models or [name for name, _ in SETS]
    rows = run(tuple(arguments.counts), arguments.seed, models, arguments.kinds, arguments.without)
    print(report(rows))
    if arguments.out:
        Path(arguments.out).write_text(json.dumps(rows))


if __name__ == "__main__":
    main()
